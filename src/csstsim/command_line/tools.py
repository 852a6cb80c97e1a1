"""Commands that are not stages: benchmarks, pictures, shear, verification, comparison, layers, status."""

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
@click.option("--output", type=click.Path(), default="results/bench", show_default=True, help="Folder of the results.")
@click.option("--quick", is_flag=True, help="Few and small objects: two minutes of CPU time.")
@click.option("--filter", "band", default="r", show_default=True, help="Filter, or a grating for spectra.")
@click.option("--methods", help="Names or beginnings of names, separated by commas [default: all].")
@click.option(
    "--objects",
    type=click.IntRange(2, 100_000),
    help="Number of objects, half are stars [default: 320; spectra 24; shapes 48].",
)
@click.option("--seed", type=click.IntRange(0), default=1, show_default=True, help="Random seed of the objects.")
@click.option("--shapes", is_flag=True, help="Draw galaxies of any Sersic index, with knots, and of images instead.")
@click.option("--readout", is_flag=True, help="Measure the cost of the detector's layers instead; only with --output.")
@click.option(
    "--mcti", type=click.Path(), help="With --readout: a checkout of github.com/ZunLuo/MCTI, to compare with."
)
@click.option(
    "--chart", multiple=True, type=click.Path(), help="Draw the chart from a table of an earlier run; repeat."
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
    """Measure speed and accuracy of every way to draw an object.

    GalSim and direct optics are the references.

    \b
    No campaign is needed. A table and the speed-accuracy chart are written:
      csstsim bench --quick
      csstsim bench --methods "photons,stamps,GalSim" --filter i --output results/bench_i
      csstsim bench --filter GV --output results/bench_GV
    Galaxies of any Sersic index, with knots, of images:
      csstsim bench --shapes --output results/bench_shapes
    Tables of several runs in one chart:
      csstsim bench --chart docs/speed_accuracy.csv --chart docs/speed_accuracy_GV.csv
    The readout of a whole chip, layer by layer, compared with numpy, GalSim, arcticpy and the paper's code:
      csstsim bench --readout --mcti MCTI
    """
    if (readout or chart) and (quick or methods or objects or shapes or (readout and chart)):
        raise click.UsageError("--readout and --chart go with --output only")
    if mcti and not readout:
        raise click.UsageError("--mcti goes with --readout")
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
@click.option("--output", type=click.Path(), help="The PNG to write [default: beside FILE, its name with .png].")
@click.option(
    "--stretch", type=click.Choice(["asinh", "log", "linear"]), help="Of the greys [default: asinh, of a mask log]."
)
@click.option(
    "--limits",
    nargs=2,
    type=float,
    metavar="LOW HIGH",
    help="Black, white [default: by the background; of a mask: all].",
)
@click.option("--region", nargs=4, type=int, metavar="X0 X1 Y0 Y1", help="Show this part only; X1 and Y1 are excluded.")
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
@click.option("--subtract-overscan", is_flag=True, help="Subtract each channel's overscan level (Level-0).")
def show(file: str, output: str | None, **options: Any) -> None:
    """Make a picture of a FITS file.

    FILE is a Level-0 file, a frame of the render or readout stage, a calibrated image, a laboratory map, or any FITS
    file with a 2-d image: the first one is shown.

    Pixels count from 0 on the whole chip (xImage of the truth counts from 1). Large frames are averaged to the
    picture's pixels. Of a mask (8-bit integers, or an extension DQ or MASK) the largest value of each block is shown,
    so that single bad pixels are seen. If the file has a WCS, right ascension and declination are drawn.

    \b
    A raw chip without its overscan levels, with the 40 brightest objects marked and an inset:
      csstsim show CSST_..._09_L0_V01.fits --subtract-overscan --truth --limit 40 --inset 4500 4700 150
    A part of the rendered light, before the detector, on a logarithmic scale:
      csstsim show results/demo/chips/10100000004_09/render.fits --stretch log --region 3968 4368 3968 4368
    A map of bad pixels from the laboratory:
      csstsim show instrument/maps/bad_02.fits --output bad_02.png
    """
    from csstsim.report.quicklook.show import ShowOptions
    from csstsim.report.quicklook.show import show as run

    click.echo(run(file, output, ShowOptions(**options)))


@click.command()
@click.argument("names", metavar="[LAYER]...", nargs=-1, shell_complete=layers_of)
def layers(names: tuple[str, ...]) -> None:
    """List the layers an observation file may name.

    Their parameters are listed, too. NAMES limits the list; a layer of your own is named by its dotted path.

    \b
    For example:
      csstsim layers
      csstsim layers bias cosmic_rays
    """
    from csstsim.simulation.sim_steps import known_layers, load_layer

    if not names:
        click.echo("Keywords are those of the paper; in a file, upper and lower case are the same.\n")
    for name in names or known_layers():
        module = load_layer(name)
        name = name if "." in name else name.lower()
        about = module.__doc__ or "(no docstring)"
        click.echo(f"{name}  [{module.STAGE}, {' -> '.join(module.UNITS)}]\n    {about.splitlines()[0]}")
        for key, field in module.Param.model_fields.items():
            click.echo(f"      {key} = {field.default}: {field.description}")


@click.command()
@click.argument("campaigns", nargs=-1, required=True, type=click.Path())
@click.option("--output", type=click.Path(), help="JSON file for the numbers and gates.")
@click.option("--strict", is_flag=True, help="End with exit code 1 if a gate fails.")
def shear(campaigns: tuple[str, ...], output: str | None, strict: bool) -> None:
    """Measure shear, and its m and c, from twin campaigns.

    The campaigns are finished and have constant shear. Twins differ only in `catalog.shapes`: normal and rotated90. One
    pair gives c; two or more pairs of different `catalog.lensing` give m. `validation.shear_m_max` and `shear_c_max` of
    the first campaign are the limits.

    \b
    For example:
      csstsim shear plus.yaml plus_rotated.yaml minus.yaml minus_rotated.yaml
    """
    from csstsim.stages import shear as shear_stage

    if not shear_stage.shear(campaigns, output, log=print) and strict:
        sys.exit(1)


@click.command()
@click.argument("campaign", type=click.Path())
@click.option("--output", type=click.Path(), help="The folder to verify [default: the campaign's].")
@click.option("--manifest", is_flag=True, help="If there is no fault, write MANIFEST.sha256 and MANIFEST.tsv there.")
def verify(campaign: str, output: str | None, manifest: bool) -> None:
    """Check that a campaign's output is complete and undamaged.

    Every product must be there, undamaged, and made for this campaign; no other file may be there. Prints one line for
    each fault.

    \b
    CAMPAIGN is a campaign file. If you lack it, give the output folder: its products say what they were made for:
      csstsim verify campaign.yaml
      csstsim verify campaign.yaml --output /delivered/demo
      csstsim verify /delivered/demo
    What a receiver can check without csstsim:
      csstsim verify campaign.yaml --manifest
      cd results/demo && sha256sum -c MANIFEST.sha256

    Exit codes: 0 no fault, 1 faults, 2 nothing to verify. docs/delivery.md says what is checked.
    """
    from csstsim.delivery.verify import verify as check

    folder = Path(campaign)
    if folder.is_dir() and output:
        raise click.UsageError("--output goes with a campaign file")
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
        print(f"{path}: the same in two runs of one campaign")


@click.command()
@click.argument("a", type=click.Path())
@click.argument("b", type=click.Path())
@click.option("--provenance", is_flag=True, help="Count differences in versions, commits and digests of recipes, too.")
@click.option(
    "--truth", type=click.Path(), help="Compare two frames at this catalogue's objects instead: light, places."
)
@click.option("--instrument", type=click.Path(), help="Folder of the camera, with --truth [default: the shipped one].")
def compare(a: str, b: str, provenance: bool, truth: str | None, instrument: str | None) -> None:
    """Print what differs between two runs, by how much, and where.

    A and B are two output folders, or two files. Dates, run times, folders, logs and manifests always differ between
    two runs: they are left out. Versions, commits, digests of recipes and the layers' parameters say how a product was
    made. They are listed in one line and do not count, unless --provenance is given.

    \b
    Two runs of one campaign, before and after a change of the code:
      csstsim compare results/before results/after
    Two files; layout and compression of Level-0 make no difference:
      csstsim compare before/CSST_..._09_L0_V01.fits after/CSST_..._09_L0_V01.fits

    With --truth, two frames whose bits cannot agree, as an official one and `csstsim recreate`'s: background and noise
    within 1%, light within 0.5%, places within 0.02 px. TRUTH is a `.cat` or a truth table:
      csstsim compare OFFICIAL.fits RECREATED.fits --truth OFFICIAL.cat

    Exit codes: 0 nothing differs, 1 something differs, 2 nothing to compare. docs/compare.md says more.
    """
    from csstsim.studies.compare.compare import compare as run
    from csstsim.studies.recreate.side_by_side import side_by_side

    if (truth and provenance) or (instrument and not truth):
        raise click.UsageError("--instrument goes with --truth, and --provenance does not")
    if side_by_side(a, b, truth, print, instrument) if truth else run(a, b, print, provenance):
        sys.exit(1)


@click.command()
@click.argument("frame", type=click.Path())
@click.argument("truth", type=click.Path())
@click.option("--output", required=True, type=click.Path(), help="Folder of the new campaign.")
@click.option("--instrument", type=click.Path(), help="Folder of the camera's data [default: the shipped one].")
@click.option("--seed", type=click.IntRange(0), help="Seed [default: the header's; 1 if it has none].")
def recreate(frame: str, truth: str, output: str, instrument: str | None, seed: int | None) -> None:
    """Write a campaign that draws again what a frame shows.

    FRAME is a raw frame, of csstsim or of the mission's simulations; TRUTH is its `.cat`, or its truth table. The
    header gives exposure, chip, window, layers and seed, the catalogue place, light and shape of each object. What
    neither says is assumed, and printed.

    \b
    For example:
      csstsim recreate CSST_..._09_L0_V01.fits CSST_..._09_L0_V01.cat --output again
      csstsim chip again/campaign.yaml --obsid 10100000001 --chip 9
      csstsim compare CSST_..._09_L0_V01.fits again/results/level0/... --truth CSST_..._09_L0_V01.cat

    docs/recreate.md says what is taken from where.
    """
    from csstsim.studies.recreate.recreate import recreate as run

    run(frame, truth, output, click.echo, instrument, seed)


@click.command()
@click.argument("campaign", type=click.Path())
@click.option("--output", type=click.Path(), help="The folder to look into [default: the campaign's].")
@click.option(
    "--watch", type=click.IntRange(1, 86400), metavar="SECONDS", help="Repeat every SECONDS until all is made."
)
def status(campaign: str, output: str | None, watch: int | None) -> None:
    """Print how far a campaign is, and what failed.

    Printed are products made and wanted, their rate, the time left, disk used, and failed jobs. Only the output folder
    is read, so the command works while Snakemake runs, here or on a cluster.

    \b
    For example:
      csstsim status campaign.yaml
      csstsim status campaign.yaml --watch 60
    """
    from csstsim.campaign.opened import OpenCampaign
    from csstsim.campaign.running.status import show as run

    try:
        run(OpenCampaign(campaign, output), watch, say=print)
    except KeyboardInterrupt:  # the way to end --watch
        sys.exit(128 + signal.SIGINT)


TOOLS = (
    bench, show, status, shear, verify, compare, release, recreate, place, inject, recover, fit_grating, export_grating,
    layers,
)  # fmt: skip
