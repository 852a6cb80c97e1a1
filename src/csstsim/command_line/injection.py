"""The commands that inject objects into existing frames and measure how well they are recovered."""

from __future__ import annotations

from typing import TYPE_CHECKING

import click

from csstsim.command_line.options import Finite, Renamed

if TYPE_CHECKING:
    from typing import Any


@click.command()
@click.argument("frames", metavar="FRAME...", nargs=-1, required=True, type=click.Path())
@click.option("--catalogue", required=True, type=click.Path(), help="Table of the objects (docs/my_catalogue.md).")
@click.option("--output", required=True, type=click.Path(), help="Folder of the new frames and their truth.")
@click.option("--campaign", type=click.Path(), help="Campaign that made the frames [default: from the header].")
@click.option("--instrument", type=click.Path(), help="Folder of the camera, without --campaign [default: shipped].")
@click.option(
    "--realisation",
    type=click.IntRange(0),
    default=1,
    show_default=True,
    help="Noise realisation of the injected flux; 0: the photons of a simulation with the same ids.",
)
@click.option("--light-curves", type=click.Path(), help="Table of the light curves named in column light_curve.")
@click.option("--psf", type=click.Path(), help="Other telescopes: PSFEx model, or FITS image or cube of stamps.")
@click.option(
    "--zeropoint",
    type=Finite(0, 50),
    help="Other telescopes: AB magnitude of 1 electron/s [default: from the header].",
)
def inject(
    frames: tuple[str, ...], catalogue: str, output: str, campaign: str | None, instrument: str | None, **options: Any
) -> None:
    """Inject the objects of a table into existing frames.

    FRAME is a Level-0 file or a calibrated image of csstsim, or any FITS image with a WCS, a gain or the unit electron,
    an exposure time and a PSF. FRAME is not changed. The output folder receives a copy with the objects, and their
    truth table.

    \b
    Into a calibrated image and a raw frame, with the campaign that made them:
      csstsim inject calibrated/10100000004_09.fits --catalogue new.csv --output with --campaign campaign.yaml
      csstsim inject CSST_..._09_L0_V01.fits --catalogue new.csv --output with --campaign campaign.yaml
    Into a frame of another telescope, with the PSFEx model of its PSF:
      csstsim inject image.fits --catalogue new.csv --output with --psf image.psf --zeropoint 25.1

    The injected flux has its own Poisson noise. In a Level-0 frame it passes through the simulated detector.
    docs/injection.md explains the method.
    """
    from csstsim.inject.inject import inject as run

    run(frames, catalogue, output, click.echo, campaign=campaign, instrument=instrument, **options)


@click.command(cls=Renamed, old={"--apart": "--min-separation", "--beside": "--near"}, goes="0.3.0")
@click.argument("frame", type=click.Path())
@click.argument("objects", type=click.Path())
@click.option("--output", required=True, type=click.Path(), help="The table to write: .csv, .ecsv, .fits or .parquet.")
@click.option("--grid", "spacing", type=Finite(1), metavar="PX", help="Grid of positions with this spacing.")
@click.option(
    "--min-separation",
    type=Finite(0),
    metavar="PX",
    help="Minimum separation of random positions [default: 0].",
)
@click.option("--near", type=click.Path(), help="Positions near the objects of this table.")
@click.option(
    "--distance",
    nargs=2,
    type=Finite(0),
    metavar="LOW HIGH",
    help="With --near: range of distances, arcsec [default: 0.5 2].",
)
@click.option("--seed", type=click.IntRange(0), default=1, show_default=True, help="Seed of the random positions.")
@click.option("--campaign", type=click.Path(), help="Campaign that made the frame [default: from the header].")
@click.option("--instrument", type=click.Path(), help="Folder of the camera, without --campaign [default: shipped].")
def place(
    frame: str,
    objects: str,
    output: str,
    spacing: float | None,
    min_separation: float | None,
    near: str | None,
    distance: tuple[float, float] | None,
    seed: int,
    **given: Any,
) -> None:
    """Choose positions in a frame for objects to be injected.

    OBJECTS is a table of objects. Its columns ra and dec (deg, ICRS) are added or replaced. By default positions are
    random. They avoid bright pixels, pixels masked in DQ, and pixels without a value.

    \b
    At random, on a grid of 200 px, and 0.5 to 2 arcsec from given objects (blends):
      csstsim place FRAME kinds.csv --output new.csv --campaign campaign.yaml --min-separation 30
      csstsim place FRAME kinds.csv --output new.csv --campaign campaign.yaml --grid 200
      csstsim place FRAME kinds.csv --output new.csv --near known.csv --distance 0.5 2
    """
    from csstsim.inject.place import place as run
    from csstsim.inject.placement import Placement

    if sum(v is not None for v in (spacing, min_separation, near)) > 1 or (distance and near is None):
        raise click.UsageError("give one of --grid, --min-separation and --near; --distance goes with --near")
    placement = Placement(spacing, min_separation or 0.0, near, distance or (0.5, 2.0), seed)
    run(frame, objects, output, click.echo, placement, **given)


@click.command()
@click.argument("injected", type=click.Path())
@click.argument("original", type=click.Path())
@click.option("--output", type=click.Path(), help="Folder of tables and figure [default: the folder of INJECTED].")
@click.option("--campaign", type=click.Path(), help="Campaign that made the frames [default: from the header].")
@click.option("--instrument", type=click.Path(), help="Folder of the camera, without --campaign [default: shipped].")
@click.option("--truth", type=click.Path(), help="Truth of the injected objects [default: next to INJECTED].")
def recover(
    injected: str, original: str, output: str | None, campaign: str | None, instrument: str | None, truth: str | None
) -> None:
    """Measure how well injected objects are recovered.

    INJECTED and ORIGINAL are measured by the same code. Injected objects are matched with sources that are not in
    ORIGINAL. Completeness, and bias and scatter of magnitude, position and shape, are printed and plotted with errors
    against magnitude, size and local density.

    \b
    For example:
      csstsim recover with/10100000004_09.fits calibrated/10100000004_09.fits --campaign campaign.yaml
    """
    from csstsim.inject.recovery.recover import recover as run

    run(injected, original, click.echo, output=output, campaign=campaign, instrument=instrument, truth=truth)
