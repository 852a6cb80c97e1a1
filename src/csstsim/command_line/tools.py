"""Commands that are not stages: bench, show, layers, shear, verify, compare, recreate, status."""

from __future__ import annotations

import signal
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import click

from csstsim.command_line.completion import layers_of
from csstsim.command_line.gratings import export_grating, fit_grating
from csstsim.command_line.injection import inject, place, recover
from csstsim.command_line.release import release

if TYPE_CHECKING:
    from typing import Any


@click.command()
@click.option("--output", type=click.Path(), default="results/bench", show_default=True, help="Output folder.")
@click.option("--quick", is_flag=True, help="Few and small objects: two minutes of CPU time.")
@click.option("--filter", "band", default="r", show_default=True, help="Filter, or grating (for spectra).")
@click.option("--methods", help="Names of methods, or beginnings of names, separated by commas [default: all].")
@click.option(
    "--objects",
    type=click.IntRange(2, 100_000),
    help="Number of objects; half of them are stars [default: 320; spectra 24; shapes 48].",
)
@click.option("--seed", type=click.IntRange(0), default=1, show_default=True, help="Random seed of the objects.")
@click.option(
    "--shapes", is_flag=True, help="Render galaxies of any Sersic index, with knots, and from images instead."
)
@click.option("--readout", is_flag=True, help="Measure the cost of the detector's layers instead; only with --output.")
@click.option("--mcti", type=click.Path(), help="With --readout: a clone of github.com/ZunLuo/MCTI for comparison.")
@click.option(
    "--chart", multiple=True, type=click.Path(), help="Plot the table of an earlier run instead; may be repeated."
)
def bench(
    output: str,
    quick: bool,
    band: str,
    methods: str | None,
    objects: int | None,
    seed: int,
    shapes: bool,
    readout: bool,
    mcti: str | None,
    chart: tuple[str, ...],
) -> None:
    """Measure speed and accuracy of all rendering methods.

    The references are GalSim and direct computation of the optics. A table and a speed-accuracy chart are written. No
    campaign is needed.

    \b
    A quick run, some methods in the i band, and spectra:
      csstsim bench --quick
      csstsim bench --methods "photons,stamps,GalSim" --filter i --output results/bench_i
      csstsim bench --filter GV --output results/bench_GV
    Galaxies of any Sersic index, with knots, and from images:
      csstsim bench --shapes --output results/bench_shapes
    Tables of several runs in one chart:
      csstsim bench --chart docs/speed_accuracy.csv --chart docs/speed_accuracy_GV.csv
    The readout of a full chip, layer by layer, compared with numpy, GalSim, arcticpy and the paper's code:
      csstsim bench --readout --mcti MCTI
    """
    if (readout or chart) and (quick or methods or objects or shapes or (readout and chart)):
        raise click.UsageError("--readout and --chart allow only --output (and --mcti with --readout)")
    if mcti and not readout:
        raise click.UsageError("--mcti needs --readout")
    if chart:
        from csstsim.studies.bench.command import chart as draw

        draw(output, chart, log=print)
    elif readout:
        from csstsim.studies.bench.readout.layers import readout as time_layers

        time_layers(Path(output), log=print, mcti=mcti)
    else:
        from csstsim.studies.bench.command import bench as run

        run(output, band, methods, quick, objects, seed, log=print, shapes=shapes)


@click.command()
@click.argument("file", type=click.Path())
@click.option("--output", type=click.Path(), help="PNG file to write [default: FILE with the suffix .png].")
@click.option(
    "--stretch",
    type=click.Choice(["asinh", "log", "linear"]),
    help="Intensity scale [default: asinh; log for a mask].",
)
@click.option(
    "--limits",
    nargs=2,
    type=float,
    metavar="LOW HIGH",
    help="Values shown black and white [default: from the background; for a mask the full range].",
)
@click.option("--region", nargs=4, type=int, metavar="X0 X1 Y0 Y1", help="Show only these pixels; X1, Y1 are excluded.")
@click.option("--inset", nargs=3, type=int, metavar="X Y SIZE", help="Inset: SIZE px around X, Y, magnified.")
@click.option("--truth", is_flag=True, help="Mark the brightest true objects, from FILE with suffix .truth.parquet.")
@click.option("--truth-table", type=click.Path(), help="Mark the brightest true objects of this table.")
@click.option("--limit", type=click.IntRange(1), default=100, show_default=True, help="Maximum number of marks.")
@click.option(
    "--size",
    type=click.IntRange(200, 4000),
    default=900,
    show_default=True,
    help="Longer side of the image in the PNG, px.",
)
@click.option("--subtract-overscan", is_flag=True, help="Subtract each channel's overscan level (Level-0).")
def show(file: str, output: str | None, **options: Any) -> None:
    """Plot the image in a FITS file as PNG.

    FILE is a Level-0 file, a frame of the render or readout stage, a calibrated image, a laboratory map, or any FITS
    file with a 2-d image. The first image is shown.

    Pixels count from 0 on the full chip (xImage of the truth counts from 1). Large frames are block-averaged. Masks
    (8-bit integers, or an extension DQ or MASK) are max-reduced, so that single bad pixels stay visible. If the file
    has a WCS, a grid of right ascension and declination is drawn.

    \b
    A raw chip with the overscan subtracted, the 40 brightest objects marked, and an inset:
      csstsim show CSST_..._09_L0_V01.fits --subtract-overscan --truth --limit 40 --inset 4500 4700 150
    A part of the rendered image, before the detector, on a logarithmic scale:
      csstsim show results/demo/chips/10100000004_09/render.fits --stretch log --region 3968 4368 3968 4368
    A laboratory map of bad pixels:
      csstsim show instrument/maps/bad_02.fits --output bad_02.png
    """
    from csstsim.report.quicklook.show import ShowOptions
    from csstsim.report.quicklook.show import show as run

    click.echo(run(file, output, ShowOptions(**options)))


@click.command()
@click.argument("names", metavar="[LAYER]...", nargs=-1, shell_complete=layers_of)
def layers(names: tuple[str, ...]) -> None:
    """List the layers of observation files and their parameters.

    Without LAYER all layers of csstsim are listed. LAYER is a keyword, or the dotted path of a layer of your own.

    \b
    For example:
      csstsim layers
      csstsim layers bias cosmic_rays
    """
    from csstsim.catalog.open import importable
    from csstsim.simulation.sim_steps import known_layers, load_layer

    importable(Path.cwd())
    if not names:
        click.echo("Keywords are those of the paper. They are not case-sensitive.\n")
    for name in names or known_layers():
        module = load_layer(name)
        name = name if "." in name else name.lower()
        about = module.__doc__ or "(no docstring)"
        click.echo(f"{name}  [{module.STAGE}, {' -> '.join(module.UNITS)}]\n    {about.splitlines()[0]}")
        for key, field in module.Param.model_fields.items():
            click.echo(f"      {key} = {field.default}: {field.description}")


@click.command()
@click.argument("campaigns", nargs=-1, required=True, type=click.Path())
@click.option("--output", type=click.Path(), help="JSON file for the results and gates.")
@click.option("--strict", is_flag=True, help="End with exit code 1 if a gate fails.")
def shear(campaigns: tuple[str, ...], output: str | None, strict: bool) -> None:
    """Measure shear, and its biases m and c, from twin campaigns.

    CAMPAIGNS are finished campaigns of constant shear. Twins differ only in `catalog.shapes`: normal and rotated90. One
    pair of twins gives the additive bias c. Two or more pairs with different `catalog.lensing` also give the
    multiplicative bias m. The limits are `validation.shear_m_max` and `shear_c_max` of the first campaign.

    \b
    For example:
      csstsim shear plus.yaml plus_rotated.yaml minus.yaml minus_rotated.yaml
    """
    from csstsim.stages import shear as shear_stage

    if not shear_stage.shear(campaigns, output, log=print) and strict:
        sys.exit(1)


@click.command()
@click.argument("campaign", type=click.Path())
@click.option("--output", type=click.Path(), help="Output folder to verify [default: the campaign's].")
@click.option("--manifest", is_flag=True, help="Without faults, write MANIFEST.sha256 and MANIFEST.tsv to the folder.")
def verify(campaign: str, output: str | None, manifest: bool) -> None:
    """Check that a campaign's output is complete and undamaged.

    Every product must exist, be undamaged, and belong to this campaign. There must be no other files. One line is
    printed for each fault. CAMPAIGN is the campaign file. Without that file, give the output folder: its products
    record what they were made for.

    \b
    For example:
      csstsim verify campaign.yaml
      csstsim verify campaign.yaml --output /delivered/demo
      csstsim verify /delivered/demo
    Checksums for a recipient without csstsim:
      csstsim verify campaign.yaml --manifest
      cd results/demo && sha256sum -c MANIFEST.sha256

    Exit codes: 0 no fault, 1 faults, 2 nothing to verify. docs/delivery.md lists the checks.
    """
    from csstsim.delivery.verify import verify as check

    folder = Path(campaign)
    if folder.is_dir() and output:
        raise click.UsageError("--output needs a campaign file, not a folder")
    if folder.is_dir():
        run = None
    else:
        from csstsim.campaign.opened import OpenCampaign

        run = OpenCampaign(campaign, output, copied=output is not None)
    runs = (run,) if run is None else (run, *run.variants)
    if sum(check(one, folder, print, manifest) for one in runs):
        sys.exit(1)
    for one in runs if manifest else ():
        from csstsim.studies.compare.content import write_contents

        path = write_contents(folder if one is None else one.paths.output)
        print(f"{path}: equal for two runs of one campaign")


@click.command()
@click.argument("a", type=click.Path())
@click.argument("b", type=click.Path())
@click.option("--provenance", is_flag=True, help="Also count differences in versions, commits and recipes.")
@click.option(
    "--truth",
    type=click.Path(),
    help="Compare fluxes and positions of this catalogue's objects in two frames instead.",
)
@click.option("--instrument", type=click.Path(), help="Folder of the camera, with --truth [default: the shipped one].")
def compare(a: str, b: str, provenance: bool, truth: str | None, instrument: str | None) -> None:
    """Print the differences between two runs.

    A and B are two output folders or two files. For each difference the size and the location are printed. Dates, run
    times, folders, logs and manifests are ignored. Differences in provenance (versions, commits, recipes, parameters of
    layers) are listed in one line; they count only with --provenance.

    \b
    Two runs of one campaign, before and after a change of the code:
      csstsim compare results/before results/after
    Two files; the layout and compression of Level-0 files are ignored:
      csstsim compare before/CSST_..._09_L0_V01.fits after/CSST_..._09_L0_V01.fits

    With --truth, two frames with different noise are compared, such as an official one and that of `csstsim recreate`.
    Background and noise must agree to 1%, fluxes to 0.5%, positions to 0.02 px. TRUTH is a `.cat` or a truth table:
      csstsim compare OFFICIAL.fits RECREATED.fits --truth OFFICIAL.cat

    Exit codes: 0 no difference, 1 differences, 2 nothing to compare. docs/compare.md explains the comparison.
    """
    from csstsim.studies.compare.compare import compare as run
    from csstsim.studies.recreate.side_by_side import side_by_side

    if (truth and provenance) or (instrument and not truth):
        raise click.UsageError("--instrument needs --truth; --provenance excludes --truth")
    if side_by_side(a, b, truth, print, instrument) if truth else run(a, b, print, provenance):
        sys.exit(1)


@click.command()
@click.argument("frame", type=click.Path())
@click.argument("truth", type=click.Path())
@click.option("--output", required=True, type=click.Path(), help="Folder of the new campaign.")
@click.option("--instrument", type=click.Path(), help="Folder of the camera [default: the shipped one].")
@click.option("--seed", type=click.IntRange(0), help="Random seed [default: from the header, else 1].")
def recreate(frame: str, truth: str, output: str, instrument: str | None, seed: int | None) -> None:
    """Write a campaign that simulates a frame again.

    FRAME is a raw frame of csstsim or of the mission's simulations. TRUTH is its `.cat` or its truth table. Exposure,
    chip, window, layers and seed are taken from the header; position, flux and shape of each object from TRUTH.
    Assumptions about anything else are printed.

    \b
    For example:
      csstsim recreate CSST_..._09_L0_V01.fits CSST_..._09_L0_V01.cat --output again
      csstsim chip again/campaign.yaml --obsid 10100000001 --chip 9
      csstsim compare CSST_..._09_L0_V01.fits again/results/level0/... --truth CSST_..._09_L0_V01.cat

    docs/recreate.md lists the source of each quantity.
    """
    from csstsim.studies.recreate.recreate import recreate as run

    run(frame, truth, output, click.echo, instrument, seed)


@click.command()
@click.argument("campaign", type=click.Path())
@click.option("--output", type=click.Path(), help="Output folder [default: the campaign's].")
@click.option(
    "--watch", type=click.IntRange(1, 86400), metavar="SECONDS", help="Repeat every SECONDS until all products exist."
)
def status(campaign: str, output: str | None, watch: int | None) -> None:
    """Print the progress of a campaign and its failed jobs.

    Printed are the numbers of finished and of all products, the rate, the remaining time, the disk used, and failed
    jobs. Only names of files are read, so the command works while Snakemake runs, locally or on a cluster. A product
    that a changed key has made outdated counts as finished; `snakemake --dry-run` lists what is made again.

    \b
    For example:
      csstsim status campaign.yaml
      csstsim status campaign.yaml --watch 60
    """
    from csstsim.campaign.opened import OpenCampaign
    from csstsim.campaign.running.status import show as run

    try:
        run(OpenCampaign(campaign, output), watch, log=print)
    except KeyboardInterrupt:  # the way to end --watch
        sys.exit(128 + signal.SIGINT)


TOOLS = (
    bench, show, status, shear, verify, compare, release, recreate, place, inject, recover, fit_grating, export_grating,
    layers,
)  # fmt: skip
