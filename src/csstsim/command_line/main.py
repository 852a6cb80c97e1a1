"""The command line. Each rule of the workflow is a sub-command (command_line.rules); others are here and in tools.

Exit codes: 0 success; 1 a gate fails (`report --strict`, `shear --strict`), `verify` finds a fault or `compare` a
difference; 2 the input cannot be used (one line says what is wrong, where, and what is allowed); 141 the reader of a
pipe has gone; 143 SIGTERM.
"""

from __future__ import annotations

import functools
from typing import TYPE_CHECKING

import click

from csstsim.base.plural import number_of
from csstsim.command_line import begin, rules, tools
from csstsim.command_line.budget import budget
from csstsim.command_line.group import SWITCHES, Group, print_result
from csstsim.command_line.options import of_campaign, of_jobs

if TYPE_CHECKING:
    from csstsim.campaign.job import Job
    from csstsim.campaign.opened import OpenCampaign


def _print_version(context: click.Context, _: click.Parameter, wanted: bool) -> None:
    """Print version and commit, and end."""
    if wanted and not context.resilient_parsing:
        from csstsim.base.commit import version_with_commit

        click.echo(f"csstsim {version_with_commit()}")
        context.exit()


@click.group(
    cls=Group, params=SWITCHES, context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 110}
)
@click.option(
    "--version", is_flag=True, is_eager=True, expose_value=False, callback=_print_version,
    help="Print the version and the commit, if it is known.",
)  # fmt: skip
def main() -> None:
    """Simulate the CSST Survey Camera: from a pointing table to Level-0 files, truth and catalogues.

    \b
    First steps:
      csstsim init mysky                       a folder with a campaign that runs
      cd mysky
      csstsim plan campaign.yaml               its products and its cost
      csstsim chip campaign.yaml --obsid 10100000004 --chip 9 --output one
      csstsim show FILE --truth                a picture of the new Level-0 file
    The complete campaign, from the pointing table to the report:
      snakemake --cores 2

    `csstsim COMMAND --help` explains a command and gives an example. -v and -q work before and after its name.
    """


@main.command()
@of_jobs
@click.option("--output", type=click.Path(), help="Folder of the products [default: the campaign's].")
@click.option("--profile", is_flag=True, help="Print the time of each layer, rendering method and function.")
def chip(run: OpenCampaign, jobs: list[Job], resume: bool, profile: bool) -> None:
    """Simulate chips in memory, from catalogue to Level-0 file.

    Chips are simulated one after the other. Missing truth bricks and PSF sets are made first, in the output folder.

    \b
    For example:
      csstsim chip campaign.yaml --obsid 10100000004 --chip 9 --output results/one
    Two chips, with the time of each layer and function:
      csstsim chip campaign.yaml --obsid 10100000004 --chip 8 --chip 9 --profile
    """
    from csstsim.campaign.checks import check_maps
    from csstsim.campaign.running.one_by_one import one_by_one
    from csstsim.stages.chip import chip as run_chip
    from csstsim.stages.chip import missing

    def make(job: Job) -> None:
        if profile:
            from csstsim.command_line.profile import profiled

            missing(run, job, print)
            profiled(functools.partial(run_chip, run, job, log=print), log=print_result)
        else:
            run_chip(run, job, log=print)

    check_maps({job.chip.id: job.chip for job in jobs}.values(), read=True)
    one_by_one(run, "level0", jobs, make, resume)


@main.command()
@of_campaign
@click.option(
    "--sky",
    type=click.Path(),
    metavar="FILE",
    help="With the stray-light model: write the sky of each exposure to a CSV file.",
)
@click.option("--exposures", is_flag=True, help="Print each exposure with its obsid, time, filters and chips instead.")
def plan(run: OpenCampaign, sky: str | None, exposures: bool) -> None:
    """Print a campaign's products and cost, without running it.

    Printed are the numbers of exposures, chips, bricks and jobs, and the disk, CPU time and memory they need. With the
    stray-light model, the sky background is printed, too. --sky writes its components (zodiacal light, earthshine and
    others) by exposure and band.

    \b
    For example:
      csstsim plan campaign.yaml
      csstsim plan config/c9_w1.yaml --sky sky.csv
    Which exposures and chips does it select?
      csstsim plan campaign.yaml --exposures
    """
    from csstsim.campaign.plan import print_exposures, print_plan

    if exposures:
        print_exposures(run)
        return
    for one in (run, *run.variants):
        one.open_truth()
    print_plan(run, sky)


@main.command()
@of_campaign
def check(run: OpenCampaign) -> None:
    """Check a campaign's files and count its chips.

    A catalogue of your own is tested with the first exposure. Notes name exposures that point too near the Sun or at
    the Earth, and listed chips and exposures that the region misses. The exit code is 0 with notes, too.

    \b
    For example:
      csstsim check campaign.yaml
      csstsim -v check campaign.yaml
    """
    from csstsim.campaign.checks import check_maps
    from csstsim.campaign.notes import notes
    from csstsim.stages.parts.contamination import check_contamination
    from csstsim.stages.psf import check_psf
    from csstsim.stages.select import check_catalog

    for one in (run, *run.variants):
        check_psf(one)
        check_maps({job.chip.id: job.chip for job in one.jobs}.values(), read=True)
        check_catalog(one, log=print)
        check_contamination(one)
        exposures = len({job.obsid for job in one.jobs})
        click.echo(f"{one.file}: good; {number_of(len(one.jobs), 'chip')} of {number_of(exposures, 'exposure')}")
        for line in notes(one):
            click.echo(f"{one.file}: note: {line}")


for command in (*rules.RULES, *begin.TOOLS, *tools.TOOLS, budget):
    main.add_command(command)
