"""The command line: parse, call, exit. One sub-command a rule of the workflow, plus plan, chip and check.

Exit codes: 0 done; 2 the input cannot be used (one line says what, where and what is allowed);
1 a gate fails (`report --strict`, `shear --strict`), or `verify` finds a fault; 141 nobody reads the output any more,
143 told to stop, as shells count.
"""

import functools
import importlib
import sys

import click

from csstsim import __version__, cli_begin, cli_tools
from csstsim.cli_group import SWITCHES, Group, hushed, result
from csstsim.completion import chips_of, obsids_of
from csstsim.job_log import job_log
from csstsim.progress import progress

campaign_arg = click.argument("campaign", type=click.Path())
obsid_opt = click.option("--obsid", required=True, shell_complete=obsids_of, help="Exposure, as in the survey table.")
chip_opt = click.option(
    "--chip", "chip_id", required=True, type=click.IntRange(1, 30), shell_complete=chips_of,
    help="Chip number, 1 to 30.",
)  # fmt: skip
brick_opt = click.option(
    "--brick", "pix", required=True, type=click.IntRange(0, 786431), help="HEALPix NSIDE-256 pixel, nested."
)
scratch_opt = click.option(
    "--scratch", type=click.Path(), envvar="CSSTSIM_SCRATCH",
    help="Folder of what the chip's stages hand on [default: the campaign's output; or $CSSTSIM_SCRATCH].",
)  # fmt: skip


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


def of_campaign(function):
    """Open the campaign and pass it on, with this process's imports kept to what the command needs."""

    @functools.wraps(function)
    def command(campaign, **options):
        from csstsim.campaign import OpenCampaign

        folders = options.pop("output", None), options.pop("scratch", None)
        return function(OpenCampaign(campaign, *folders), **options)

    return campaign_arg(command)


def stage(function):
    """The same for what makes products: where standard output is a log, it says whose and what the job took."""

    @functools.wraps(function)
    def logged(run, **options):
        names = {"obsid": "exposure", "chip_id": "chip", "chip_ids": "chip", "pix": "brick"}
        told = [(word, options[key]) for key, word in names.items() if key in options]
        parts = [(word, *(value if isinstance(value, tuple) else (value,))) for word, value in told]
        what = " ".join(str(part) for group in parts for part in group)
        verb = click.get_current_context().info_name
        with hushed(), job_log(verb, run.config.name, run.config.digest(), what):
            return function(run, **options)

    return of_campaign(logged)


def job_command(module, name, text, *more, example="campaign.yaml --obsid 10100000004 --chip 9"):
    """Add the command of a per-chip stage: csstsim NAME CAMPAIGN --obsid X --chip N, and more options."""

    def command(run, obsid, chip_id):
        getattr(importlib.import_module(module), name)(run, run.job(obsid, chip_id))

    command.__doc__ = _with_example(text, name, example)
    for option in (chip_opt, obsid_opt, *more):
        command = option(command)
    main.command(name)(stage(command))


def brick_command(module, name, text):
    """Add the command of a per-brick step: csstsim NAME CAMPAIGN --brick P."""

    def command(run, pix):
        getattr(importlib.import_module(module), name)(run, pix)

    command.__doc__ = _with_example(text, name, "campaign.yaml --brick 550613")
    main.command(name)(stage(brick_opt(command)))


def _with_example(text, name, arguments):
    return f"{text}\n\n\b\nFor example:\n  csstsim {name} {arguments}"


brick_command("csstsim.prepare", "truth", "Make one brick of the embedded True Universe.")
for name, text in {
    "select": "Find the objects that reach a chip, and their electrons/s.",
    "render": "Draw the objects and the sky: expected electrons.",
    "readout": "Turn electrons into DN: noise, overscan, bias, gain.",
    "level0": "Digitise; write the Level-0 file and its truth table.",
}.items():
    job_command("csstsim.stages", name, text, scratch_opt)
job_command("csstsim.calibration", "calibrate", "Write the calibrated image of a Level-0 file, in e-/s.")
job_command("csstsim.analysis", "measure", "Detect and measure the sources of a Level-0 file.")
job_command(
    "csstsim.analysis", "extract", "Extract the spectra of a spectroscopic chip's Level-0 file.",
    example="campaign.yaml --obsid 10100000015 --chip 29",
)  # fmt: skip
brick_command("csstsim.analysis", "merge", "Merge the measurements of a brick: a row a source.")
brick_command("csstsim.analysis", "validate", "Compare a merged brick with the truth.")


@main.command()
@stage
@chip_opt
def psf(run, chip_id):
    """Make the PSF set of one chip.

    \b
    For example:
      csstsim psf campaign.yaml --chip 9
    """
    from csstsim import prepare

    prepare.psf(run, chip_id)


@main.command()
@stage
@chip_opt
def masters(run, chip_id):
    """Make a chip's master frames from bias, dark and lamp exposures.

    \b
    For example:
      csstsim masters calibration.yaml --chip 9
    """
    from csstsim import calibration

    calibration.masters(run, chip_id)


@main.command()
@stage
@click.option("--strict", is_flag=True, help="End with exit code 1 if a gate fails.")
def report(run, strict):
    """Write the report of a campaign: one web page.

    It has the validation of every brick; the verdict on its gates stands beside it as JSON.

    \b
    For example:
      csstsim report campaign.yaml --strict
    """
    from csstsim import campaign_report

    if campaign_report.report(run)["passed"] is False and strict:
        sys.exit(1)


@main.command()
@stage
@obsid_opt
@click.option(
    "--chip", "chip_ids", required=True, multiple=True, type=click.IntRange(1, 30),
    callback=lambda ctx, option, numbers: tuple(dict.fromkeys(numbers)), shell_complete=chips_of,
    help="Chip number, 1 to 30; repeat.",
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
    from csstsim import stages

    jobs = [run.job(obsid, chip_id) for chip_id in chip_ids]
    for job in progress(jobs, "chips"):
        if profile:
            from csstsim import prepare
            from csstsim.profile import profiled

            prepare.missing(run, job, print)
            profiled(functools.partial(stages.chip, run, job, say=print), say=result)
        else:
            stages.chip(run, job, say=print)


@main.command()
@of_campaign
def plan(run):
    """Print what a campaign would do and cost; nothing is run.

    Exposures, chips, bricks, jobs, disk, CPU and memory.

    \b
    For example:
      csstsim plan campaign.yaml
    """
    from csstsim.plan import print_plan

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
    from csstsim import stages

    stages.check_catalog(run, say=print)
    click.echo(f"{run.file}: good; {len(run.jobs)} chips of {len({j.pointing.obsid for j in run.jobs})} exposures")


for tool in cli_begin.TOOLS + cli_tools.TOOLS:
    main.add_command(tool)
