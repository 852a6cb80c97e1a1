"""`csstsim budget`: the contribution of each effect to the error of a measurement of shear, or of redshifts."""

from __future__ import annotations

import functools
from typing import TYPE_CHECKING

import click

from csstsim.command_line.group import Commands
from csstsim.command_line.options import of_campaign

if TYPE_CHECKING:
    from csstsim.campaign.opened import OpenCampaign


@click.group(cls=Commands)
def budget() -> None:
    """Measure the error that each effect adds: shear, redshifts.

    \b
    For example:
      csstsim budget shear --plan
      csstsim budget redshift campaign.yaml
    """


def _names(ctx: click.Context, option: click.Parameter, value: str | None) -> list[str] | str | None:
    return value and [name.strip() for name in value.split(",")]


@budget.command()
@click.argument("file", metavar="[PLAN]", required=False, type=click.Path())
@click.option("--output", type=click.Path(), default="results/budget_shear", show_default=True, help="Output folder.")
@click.option(
    "--plan",
    "only_plan",
    is_flag=True,
    help="Only print the plan and its CPU-hours, measured with one window per sample (minutes).",
)
@click.option("--fields", "count", type=click.IntRange(1), help="Number of windows per sample [default: the plan's].")
@click.option("--samples", callback=_names, help="Names of samples, separated by commas [default: all in the plan].")
@click.option("--effects", callback=_names, help="Names of effects, separated by commas [default: all in the plan].")
@click.option("--estimators", callback=_names, help="hsm, own, fpfs, metacal [default: the plan's].")
@click.option(
    "--blind", type=click.Path(), metavar="KEY", help="Write frames with hidden shear; the true shear goes to file KEY."
)
@click.option("--whole", is_flag=True, help="With --blind: all effects of the sum in each frame.")
@click.option(
    "--reveal", nargs=2, type=click.Path(), metavar="KEY ANSWER", help="Score ANSWER, a CSV table of measured shear."
)
def shear(
    file: str | None,
    output: str,
    only_plan: bool,
    count: int | None,
    samples: list[str] | None,
    effects: list[str] | None,
    estimators: list[str] | None,
    blind: str | None,
    whole: bool,
    reveal: tuple[str, str] | None,
) -> None:
    """Measure the shear bias of each effect.

    PLAN lists samples of galaxies, effects and estimators [default: config/budget/shear.yaml]. Each effect is
    simulated twice, with opposite shear and the same noise. Table, figures and page are written to the output folder.
    A run that was stopped continues where it stopped.

    \b
    The cost, the complete budget, and two effects of it:
      csstsim budget shear --plan
      csstsim budget shear --output results/budget
      csstsim budget shear --effects nonlinearity,brighter_fatter --fields 2
    A blind test; ANSWER has the columns field, g1, g2, g1_err, g2_err:
      csstsim budget shear --blind key.json --output blind
      csstsim budget shear --reveal key.json answer.csv --output blind

    docs/budget_shear.md explains the plan and the figures.
    """
    if (
        (blind and reveal)
        or ((blind or reveal) and (only_plan or samples or effects or estimators))
        or (whole and not blind)
    ):
        raise click.UsageError(
            "--blind takes only PLAN, --fields, --whole and --output; --reveal only --output; --whole needs --blind"
        )
    if reveal:
        from csstsim.studies.budget.shear.blind import reveal as score

        score(*reveal, print, output)
    elif blind:
        from csstsim.studies.budget.shear.blind import blind as hide

        hide(file, blind, output, print, count=count, whole=whole)
    else:
        from csstsim.studies.budget.shear.command import budget as run

        log = functools.partial(print, flush=True)  # at once, into a file or pipe, too
        chosen = {"fields": count, "samples": samples, "effects": effects, "estimators": estimators}
        run(file, output, log, only_plan=only_plan, **chosen)


@budget.command()
@of_campaign
@click.option(
    "--also", type=click.Path(), multiple=True, help="Campaign of another field, same camera; may be repeated."
)
@click.option("--spectra", type=click.Path(), help="Folder of spectra, relative to CAMPAIGN [default: CAMPAIGN's own].")
@click.option("--answer", type=click.Path(), help="Redshifts to score: CSV of id, z and good (1: secure, 0: not).")
@click.option("--band", default="i", show_default=True, help="Band of the magnitudes; must be in the catalogue.")
@click.option(
    "--output",
    "folder",
    type=click.Path(),
    default="results/budget_redshift",
    show_default=True,
    help="Output folder.",
)
def redshift(
    run: OpenCampaign, also: tuple[str, ...], spectra: str | None, answer: str | None, band: str, folder: str
) -> None:
    """Stack slitless spectra; score redshifts fitted to them.

    The spectra of each galaxy are stacked over all frames of a campaign. stack.parquet and objects.parquet are the
    input of a redshift code. Its redshifts are scored by magnitude, redshift, size and contamination. Fluxes and
    wavelengths of emission lines are compared with the truth.

    \b
    For example:
      csstsim budget redshift campaign.yaml
      csstsim budget redshift campaign.yaml --answer redshifts.csv
    """
    from csstsim.campaign.opened import OpenCampaign
    from csstsim.studies.budget.redshift.report import budget as run_budget

    run_budget([run, *map(OpenCampaign, also)], folder, spectra, answer, band, click.echo)
