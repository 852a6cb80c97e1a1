"""The command line: parse, call, exit. One sub-command a rule of the workflow (command_line.rules), and more.

Exit codes: 0 done; 2 the input cannot be used (one line says what, where and what is allowed);
1 a gate fails (`report --strict`, `shear --strict`), or `verify` finds a fault; 141 nobody reads the output any more,
143 told to stop, as shells count.
"""

import functools

import click

from csstsim import __version__
from csstsim.base.progress import progress
from csstsim.command_line import begin, rules, tools
from csstsim.command_line.completion import chips_of
from csstsim.command_line.group import SWITCHES, Group, result
from csstsim.command_line.options import obsid_opt, of_campaign, stage


@click.group(
    cls=Group, params=SWITCHES, context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 110}
)
@click.version_option(__version__, prog_name="csstsim")
def main():
    """Simulate the CSST Survey Camera: a pointing table in; Level-0 files, truth and catalogues out.

    \b
    A first look:
      csstsim init mysky                       a folder with a campaign that runs
      cd mysky
      csstsim plan campaign.yaml               what it would do and cost
      csstsim chip campaign.yaml --obsid 10100000004 --chip 9 --output one
      csstsim show FILE --truth                a picture of the file that was made
    All of the campaign, from the pointing table to the report:
      snakemake --cores 2

    `csstsim COMMAND --help` explains a command, with an example. -v and -q stand before or after its name.
    """


@main.command()
@stage
@obsid_opt
@click.option(
    "--chip", "chip_ids", required=True, multiple=True, type=click.IntRange(1),
    callback=lambda ctx, option, numbers: tuple(dict.fromkeys(numbers)), shell_complete=chips_of,
    help="Chip number; repeat.",
)  # fmt: skip
@click.option("--output", type=click.Path(), help="Folder for the products [default: the campaign's].")
@click.option("--profile", is_flag=True, help="Say where the CPU time went: layers, methods, functions.")
def chip(run, obsid, chip_ids, profile):
    """Run chips in memory, from catalogue to Level-0 file.

    One after the other. Truth bricks and PSF sets that are missing are made first, in the output folder.

    \b
    For example:
      csstsim chip campaign.yaml --obsid 10100000004 --chip 9 --output results/one
    Two chips, and where the CPU time went:
      csstsim chip campaign.yaml --obsid 10100000004 --chip 8 --chip 9 --profile
    """
    from csstsim.stages.chip import chip as run_chip
    from csstsim.stages.chip import missing

    jobs = [run.job(obsid, chip_id) for chip_id in chip_ids]
    for job in progress(jobs, "chips"):
        if profile:
            from csstsim.command_line.profile import profiled

            missing(run, job, print)
            profiled(functools.partial(run_chip, run, job, say=print), say=result)
        else:
            run_chip(run, job, say=print)


@main.command()
@of_campaign
def plan(run):
    """Print what a campaign would do and cost; nothing is run.

    Exposures, chips, bricks, jobs, disk, CPU and memory.

    \b
    For example:
      csstsim plan campaign.yaml
    """
    from csstsim.campaign.plan import print_plan

    run.open_truth()
    print_plan(run)


@main.command()
@of_campaign
def check(run):
    """Check a campaign's files and say what it would run.

    A catalogue of your own is tried on the first exposure.

    \b
    For example:
      csstsim check campaign.yaml
      csstsim -v check campaign.yaml
    """
    from csstsim.stages.select import check_catalog

    check_catalog(run, say=print)
    click.echo(f"{run.file}: good; {len(run.jobs)} chips of {len({j.pointing.obsid for j in run.jobs})} exposures")


for command in rules.RULES + begin.TOOLS + tools.TOOLS:
    main.add_command(command)
