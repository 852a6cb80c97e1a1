"""The command line: parse, call, exit. One sub-command a rule of the workflow, plus plan, chip and check.

Exit codes: 0 done; 2 the input cannot be used (one line says what, where and what is allowed);
1 a gate fails, of `report --strict` only.
"""

import functools
import importlib
import sys
import traceback
from pathlib import Path

import click

from csstsim import __version__
from csstsim.errors import CsstsimError

campaign_arg = click.argument("campaign", type=click.Path())
obsid_opt = click.option("--obsid", required=True, help="Exposure, as in the survey table.")
chip_opt = click.option("--chip", "chip_id", required=True, type=click.IntRange(1, 30), help="Chip number, 1 to 30.")
brick_opt = click.option(
    "--brick", "pix", required=True, type=click.IntRange(0, 786431), help="HEALPix NSIDE-256 pixel, nested."
)


class Group(click.Group):
    """A click group whose input errors are one line and exit code 2."""

    def invoke(self, ctx):
        try:
            return super().invoke(ctx)
        except CsstsimError as error:
            if ctx.params.get("verbose"):
                traceback.print_exception(error)
            message = str(error)
        except OSError as error:  # an output folder that is a file or read-only, a full disk
            if error.filename is None and error.errno is None:
                raise
            message = ": ".join(str(part) for part in (error.filename, error.strerror) if part)
        click.echo(f"csstsim: error: {message}", err=True)
        sys.exit(2)


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


def stage(function):
    """Open the campaign and pass it on, with this process's imports kept to what the command needs."""

    @functools.wraps(function)
    def command(campaign, **options):
        from csstsim.campaign import OpenCampaign

        return function(OpenCampaign(campaign, options.pop("output", None)), **options)

    return campaign_arg(command)


def job_command(module, name, text):
    """Add the command of a per-chip stage: csstsim NAME CAMPAIGN --obsid X --chip N."""

    def command(run, obsid, chip_id):
        getattr(importlib.import_module(module), name)(run, run.job(obsid, chip_id))

    command.__doc__ = text
    main.command(name)(stage(obsid_opt(chip_opt(command))))


def brick_command(module, name, text):
    """Add the command of a per-brick step: csstsim NAME CAMPAIGN --brick P."""

    def command(run, pix):
        getattr(importlib.import_module(module), name)(run, pix)

    command.__doc__ = text
    main.command(name)(stage(brick_opt(command)))


brick_command("csstsim.prepare", "truth", "Make one brick of the embedded True Universe.")
job_command("csstsim.stages", "select", "Find the objects that reach a chip, with positions and electrons per second.")
job_command("csstsim.stages", "render", "Draw the objects and the sky: expected electrons.")
job_command("csstsim.stages", "readout", "Turn electrons into DN: noise, overscan, bias, gain.")
job_command("csstsim.stages", "level0", "Digitise and write the Level-0 file and its truth table.")
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
@chip_opt
@click.option("--output", type=click.Path(), help="Folder for the products [default: the campaign's].")
@click.option("--profile", is_flag=True, help="Say where the CPU time went: layers, methods, functions.")
def chip(run, obsid, chip_id, profile):
    """Run one chip in memory, from catalogue to Level-0 file.

    Truth bricks and the PSF set that are missing are made first, in the output folder.
    """
    from csstsim import stages

    job = run.job(obsid, chip_id)
    if profile:
        from csstsim import prepare
        from csstsim.profile import profiled

        if run.embedded:
            prepare.missing_bricks(run, job, click.echo)
        prepare.missing_psf(run, job.chip, click.echo)
        profiled(lambda: stages.chip(run, job, say=click.echo), say=click.echo)
    else:
        stages.chip(run, job, say=click.echo)


@main.command()
@stage
def plan(run):
    """Print what a campaign would do: exposures, chips, bricks, jobs, disk and CPU. Nothing is run."""
    from csstsim.plan import print_plan

    run.open_truth()
    print_plan(run)


@main.command()
@stage
def check(run):
    """Check a campaign's files and say what it would run; try a catalogue of your own on its first exposure."""
    from csstsim import stages

    stages.check_catalog(run, say=click.echo)
    click.echo(f"{run.file}: good; {len(run.jobs)} chips of {len({j.pointing.obsid for j in run.jobs})} exposures")


@main.command()
@click.option("--output", type=click.Path(), default="results/bench", show_default=True, help="Folder of the results.")
@click.option("--quick", is_flag=True, help="Few and small objects: two minutes of CPU time.")
@click.option("--filter", "band", default="r", show_default=True, help="Filter; with a grating spectra are drawn.")
@click.option("--methods", help="Names, or beginnings of names, with commas between [default: all].")
@click.option(
    "--objects", type=click.IntRange(2, 100_000), help="How many, half of them stars [default: 320; spectra 24]."
)
@click.option("--seed", type=click.IntRange(0), default=1, show_default=True, help="Of the sample of objects.")
@click.option(
    "--readout",
    is_flag=True,
    help="Cost of the layers after the objects instead; with --output only.",
)
@click.option("--chart", multiple=True, type=click.Path(), help="A table of an earlier run, to draw instead; repeat.")
def bench(output, quick, band, methods, objects, seed, readout, chart):
    """Measure speed and accuracy of every way to draw an object, against GalSim and against direct optics.

    \b
    Needs no campaign. Writes a table and the speed-accuracy chart:
      csstsim bench --quick
      csstsim bench --methods "photons,stamps,GalSim" --filter i --output results/bench_i
      csstsim bench --filter GV --output results/bench_GV
    Tables of several runs in one chart:
      csstsim bench --chart docs/speed_accuracy.csv --chart docs/speed_accuracy_GV.csv
    A whole chip's readout, layer by layer, beside numpy, GalSim and arcticpy:
      csstsim bench --readout
    """
    if (readout or chart) and (quick or methods or objects or (readout and chart)):
        raise click.UsageError("--readout and --chart go with --output only")
    if chart:
        from csstsim.bench.command import chart as draw

        draw(output, chart, say=click.echo)
    elif readout:
        from csstsim.bench.readout import readout as run

        run(Path(output), say=click.echo)
    else:
        from csstsim.bench.command import bench as run

        run(output, band, methods, quick, objects, seed, say=click.echo)


@main.command()
@click.argument("file", type=click.Path())
@click.option("--output", type=click.Path(), help="The PNG to write [default: beside FILE, its name with .png].")
@click.option("--stretch", type=click.Choice(["asinh", "log", "linear"]), default="asinh", show_default=True)
@click.option("--limits", nargs=2, type=float, metavar="LOW HIGH", help="Black and white [default: by the background].")
@click.option("--region", nargs=4, type=int, metavar="X0 X1 Y0 Y1", help="Show this part only; X1, Y1 are beyond it.")
@click.option("--inset", nargs=3, type=int, metavar="X Y SIZE", help="Show SIZE px about X, Y larger; cut at the edge.")
@click.option("--truth", is_flag=True, help="Mark the brightest true objects, from the .truth.parquet beside FILE.")
@click.option("--truth-table", type=click.Path(), help="... from this table instead.")
@click.option("--limit", type=click.IntRange(1), default=100, show_default=True, help="How many objects to mark.")
@click.option(
    "--size",
    type=click.IntRange(200, 4000),
    default=900,
    show_default=True,
    help="Longer side of the image in the PNG, px.",
)
@click.option("--subtract-overscan", is_flag=True, help="Take the overscan's level off each channel of a Level-0 file.")
def show(file, output, **options):
    """Make a picture of a FITS file: Level-0, a frame of the render or readout stage, or calibrated.

    Pixels are the chip's and count from 0 (xImage of the truth from 1); large frames are averaged to the picture's
    pixels. Right ascension and declination are drawn where the file says what they are.

    \b
    A raw chip, its sixteen channels levelled, with the 40 brightest objects and a closer look at one place:
      csstsim show CSST_..._09_L0_V01.fits --subtract-overscan --truth --limit 40 --inset 4500 4700 150
    A part of what was drawn, before the detector, faint light first:
      csstsim show results/demo/chips/10100000004_09/render.fits --stretch log --region 3968 4368 3968 4368
    """
    from csstsim.quicklook.show import show as run

    click.echo(run(file, output, **options))


@main.command("fit-grating")
@click.argument("samples", type=click.Path())
@click.option("--output", required=True, type=click.Path(), help="The aXe configuration to write, NAME.conf.")
@click.option("--sensitivity", "stem", help="STEM of the sensitivities it names: STEM_p1.fits, ... [default: NAME].")
def fit_grating(samples, output, stem):
    """Fit a grating's traces and dispersion to trajectories of ray tracing: equations 1 to 4 of the paper.

    \b
    SAMPLES is a CSV table, one row a ray, with a heading:
      order,m,n,wavelength,x,y
    order       -2, -1, 0, 1 or 2; the first is needed
    m, n        0-based pixel of the direct image, which is where light would land without the grating
    wavelength  angstrom
    x, y        0-based pixel on which that light lands

    The paper samples 10 x 10 positions over the grating's piece of the chip and 8 wavelengths; 3 x 3 positions and
    2 wavelengths are the least. Dispersion runs along x. Printed: residuals in px of the file written.

    \b
    To try it, with the trajectories behind a shipped grating:
      python tests/instrument/build_gratings.py --samples GI1 > samples.csv
      csstsim fit-grating samples.csv --output results/GI1.conf --sensitivity GI
    """
    from csstsim.optics.trace_fit import fit_file, fit_report

    click.echo("\n".join(fit_report(fit_file(samples, output, stem))))


@main.command()
def layers():
    """List the layers an observation file may name, with their parameters."""
    from csstsim.sim_steps import known_layers

    click.echo("Keywords of the paper, as known here; in a file, capitals make no difference.\n")
    for name in known_layers():
        module = importlib.import_module(f"csstsim.layers.{name}")
        click.echo(f"{name}  [{module.STAGE}, {' -> '.join(module.UNITS)}]\n    {module.__doc__.splitlines()[0]}")
        for key, field in module.Param.model_fields.items():
            click.echo(f"      {key} = {field.default}: {field.description}")
