"""`csstsim budget`: what each effect costs a measurement of shear, or of redshifts."""

import click

from csstsim.command_line.group import GivenPath
from csstsim.command_line.options import of_campaign


class Budgets(click.Group):
    """The group of budgets, which refuse empty names of files as all commands do."""

    def add_command(self, cmd, name=None):
        """Add a budget."""
        for param in cmd.params:
            if type(param.type) is click.Path:
                param.type = GivenPath()
        super().add_command(cmd, name)


@click.group(cls=Budgets)
def budget():
    """Say what each effect costs a measurement: shear, redshifts.

    \b
    For example:
      csstsim budget shear --plan
    """


@budget.command()
@click.argument("plan", required=False, type=click.Path())
@click.option(
    "--output", type=click.Path(), default="results/budget_shear", show_default=True, help="Folder of results."
)
@click.option("--plan", "only_plan", is_flag=True, help="Print volume and CPU-hours for sigma(m) = 1e-4; then stop.")
def shear(plan, output, only_plan):
    """Measure what each effect adds to the bias of shear."""
    raise click.UsageError("not yet")


@budget.command()
@of_campaign
@click.option("--also", type=click.Path(), multiple=True, help="A campaign of another place, same camera; repeat.")
@click.option("--spectra", type=click.Path(), help="Folder of spectra, beside the campaign's file [default: its own].")
@click.option("--answer", type=click.Path(), help="Redshifts to score: CSV of id, z and good (1: sure, 0: not).")
@click.option("--band", default="i", show_default=True, help="Band of the magnitudes.")
@click.option(
    "--output", "folder", type=click.Path(), default="results/budget_redshift", show_default=True,
    help="Folder of results.",
)  # fmt: skip
def redshift(run, also, spectra, answer, band, folder):
    """Stack slitless spectra; score redshifts fitted to them.

    Spectra of one galaxy from all frames of a campaign are added: stack.parquet and objects.parquet are for the program
    that fits redshifts. Its answer is scored by magnitude, redshift, size and contamination. Fluxes and wavelengths of
    emission lines are compared with the truth.

    \b
    For example:
      csstsim budget redshift campaign.yaml
      csstsim budget redshift campaign.yaml --answer redshifts.csv
    """
    from csstsim.budget.redshift.report import budget as run_budget
    from csstsim.campaign.opened import OpenCampaign

    run_budget([run, *map(OpenCampaign, also)], folder, spectra, answer, band, click.echo)
