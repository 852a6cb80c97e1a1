"""The command line: parse, call, exit. One sub-command a rule of the workflow, plus plan, chip and check.

Exit codes: 0 done; 2 the input cannot be used (one line says what, where and what is allowed);
1 a gate fails (`report --strict`, `shear --strict`), or `verify` finds a fault; 141 nobody reads the output any more,
143 told to stop, as shells count.
"""

import functools
import importlib
import os
import signal
import sys
import traceback

import click

from csstsim import __version__, cli_tools
from csstsim.errors import CsstsimError
from csstsim.job_log import ERROR, job_log

campaign_arg = click.argument("campaign", type=click.Path())
obsid_opt = click.option("--obsid", required=True, help="Exposure, as in the survey table.")
chip_opt = click.option("--chip", "chip_id", required=True, type=click.IntRange(1, 30), help="Chip number, 1 to 30.")
brick_opt = click.option(
    "--brick", "pix", required=True, type=click.IntRange(0, 786431), help="HEALPix NSIDE-256 pixel, nested."
)
scratch_opt = click.option(
    "--scratch", type=click.Path(), envvar="CSSTSIM_SCRATCH",
    help="Folder of what the chip's stages hand on [default: the campaign's output; or $CSSTSIM_SCRATCH].",
)  # fmt: skip


class Group(click.Group):
    """A click group whose input errors are one line and exit code 2, and which ends without a word when told to."""

    def main(self, *args, **options):
        """Run the command; from here on SIGTERM ends it without a word."""
        signal.signal(signal.SIGTERM, _stop)
        return super().main(*args, **options)

    def invoke(self, ctx):
        """Run the sub-command and end with its exit code."""
        try:
            result = super().invoke(ctx)
            if sys.stdout:  # None if closed before the start
                sys.stdout.flush()  # at exit its errors could not be caught
            return result
        except BrokenPipeError:
            _forget_output()
            sys.exit(128 + signal.SIGPIPE)
        except CsstsimError as error:
            if ctx.params.get("verbose"):
                traceback.print_exception(error)
            message = str(error)
        except OSError as error:  # an output folder that is a file or read-only, a full disk
            if error.filename is None and error.errno is None:
                raise
            message = ": ".join(str(part) for part in (error.filename, error.strerror) if part)
        click.echo(f"{ERROR} {message}", err=True)
        sys.exit(2)


def _stop(number, frame):
    """End as an exception does, so that files half-written are removed (csstsim.atomic)."""
    sys.exit(128 + number)


def _forget_output():
    """Let what is still to be printed, at exit too, go nowhere."""
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, sys.stdout.fileno())
    os.close(nowhere)


@click.group(cls=Group, context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 110})
@click.version_option(__version__, prog_name="csstsim")
@click.option("-v", "--verbose", is_flag=True, help="Show the traceback behind an error (of a catalogue of your own).")
def main(verbose):
    """Simulate the CSST Survey Camera: a pointing table in; Level-0 files, truth and catalogues out.

    \b
    A first look:
      csstsim plan config/campaign.yaml        what a campaign would do and cost
      csstsim chip config/campaign.yaml --obsid 10100000004 --chip 9 --output results/one
      snakemake --profile profiles/default --config campaign=config/campaign.yaml

    The other commands are the stages of the workflow; each reads and writes the campaign's output folder.
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
        with job_log(click.get_current_context().info_name, run.config.name, run.config.digest(), what):
            return function(run, **options)

    return of_campaign(logged)


def job_command(module, name, text, *more):
    """Add the command of a per-chip stage: csstsim NAME CAMPAIGN --obsid X --chip N, and more options."""

    def command(run, obsid, chip_id):
        getattr(importlib.import_module(module), name)(run, run.job(obsid, chip_id))

    command.__doc__ = text
    for option in (chip_opt, obsid_opt, *more):
        command = option(command)
    main.command(name)(stage(command))


def brick_command(module, name, text):
    """Add the command of a per-brick step: csstsim NAME CAMPAIGN --brick P."""

    def command(run, pix):
        getattr(importlib.import_module(module), name)(run, pix)

    command.__doc__ = text
    main.command(name)(stage(brick_opt(command)))


brick_command("csstsim.prepare", "truth", "Make one brick of the embedded True Universe.")
for name, text in {
    "select": "Find the objects that reach a chip, with positions and electrons per second.",
    "render": "Draw the objects and the sky: expected electrons.",
    "readout": "Turn electrons into DN: noise, overscan, bias, gain.",
    "level0": "Digitise and write the Level-0 file and its truth table.",
}.items():
    job_command("csstsim.stages", name, text, scratch_opt)
job_command("csstsim.calibration", "calibrate", "Write the calibrated image of a Level-0 file: SCI, ERR, DQ in e-/s.")
job_command("csstsim.analysis", "measure", "Detect and measure the sources of a Level-0 file.")
job_command("csstsim.analysis", "extract", "Extract the spectra of a spectroscopic chip's Level-0 file.")
brick_command("csstsim.analysis", "merge", "Merge the measurements of a brick: one row per source, all bands.")
brick_command("csstsim.analysis", "validate", "Compare a merged brick with the truth.")


@main.command()
@stage
@chip_opt
def psf(run, chip_id):
    """Make the PSF set of one chip."""
    from csstsim import prepare

    prepare.psf(run, chip_id)


@main.command()
@stage
@chip_opt
def masters(run, chip_id):
    """Make the master frames of one chip from bias, dark and lamp exposures."""
    from csstsim import calibration

    calibration.masters(run, chip_id)


@main.command()
@stage
@click.option("--strict", is_flag=True, help="End with exit code 1 if a gate fails.")
def report(run, strict):
    """Write the report: one web page with the validation of every brick, and the verdict on its gates as JSON."""
    from csstsim import campaign_report

    if campaign_report.report(run)["passed"] is False and strict:
        sys.exit(1)


@main.command()
@stage
@obsid_opt
@click.option(
    "--chip", "chip_ids", required=True, multiple=True, type=click.IntRange(1, 30),
    callback=lambda ctx, option, numbers: tuple(dict.fromkeys(numbers)), help="Chip number, 1 to 30; repeat.",
)  # fmt: skip
@click.option("--output", type=click.Path(), help="Folder for the products [default: the campaign's].")
@click.option("--profile", is_flag=True, help="Say where the CPU time went: layers, methods, functions.")
def chip(run, obsid, chip_ids, profile):
    """Run chips in memory, from catalogue to Level-0 file, one after the other.

    Truth bricks and PSF sets that are missing are made first, in the output folder.
    """
    from csstsim import stages

    for job in [run.job(obsid, chip_id) for chip_id in chip_ids]:
        if profile:
            from csstsim import prepare
            from csstsim.profile import profiled

            if run.embedded:
                prepare.missing_bricks(run, job, click.echo)
            prepare.missing_psf(run, job.chip, click.echo)
            profiled(functools.partial(stages.chip, run, job, say=click.echo), say=click.echo)
        else:
            stages.chip(run, job, say=click.echo)


@main.command()
@of_campaign
def plan(run):
    """Print what a campaign would do: exposures, chips, bricks, jobs, disk and CPU. Nothing is run."""
    from csstsim.plan import print_plan

    run.open_truth()
    print_plan(run)


@main.command()
@of_campaign
def check(run):
    """Check a campaign's files and say what it would run; try a catalogue of your own on its first exposure."""
    from csstsim import stages

    stages.check_catalog(run, say=click.echo)
    click.echo(f"{run.file}: good; {len(run.jobs)} chips of {len({j.pointing.obsid for j in run.jobs})} exposures")


for tool in cli_tools.TOOLS:
    main.add_command(tool)
