"""The commands that put objects into frames, and that say how well they are found again."""

from __future__ import annotations

from typing import TYPE_CHECKING

import click

from csstsim.command_line.options import Finite

if TYPE_CHECKING:
    from typing import Any


@click.command()
@click.argument("frames", metavar="FRAME...", nargs=-1, required=True, type=click.Path())
@click.option("--catalogue", required=True, type=click.Path(), help="Table of objects (docs: A catalogue of your own).")
@click.option("--output", required=True, type=click.Path(), help="Folder of the new frames and their truth.")
@click.option("--campaign", type=click.Path(), help="Campaign that made the frames [default: the header tells].")
@click.option("--instrument", type=click.Path(), help="Folder of the camera, without --campaign [default: shipped].")
@click.option(
    "--realisation",
    type=click.IntRange(0),
    default=1,
    show_default=True,
    help="Number of the noise of the injected light; 0: the photons of a simulation of the same ids.",
)
@click.option("--light-curves", type=click.Path(), help="Table of the curves that the column light_curve names.")
@click.option("--psf", type=click.Path(), help="Frames of others: PSFEx model, or FITS image or cube of stamps.")
@click.option(
    "--zeropoint", type=Finite(0, 50), help="Frames of others: AB magnitude of 1 electron/s [default: the header's]."
)
def inject(
    frames: tuple[str, ...], catalogue: str, output: str, campaign: str | None, instrument: str | None, **options: Any
) -> None:
    """Put objects of a table into frames that exist.

    FRAME is a Level-0 file or a calibrated image of csstsim, or any FITS image with a WCS, a gain or an electron unit,
    an exposure time and a PSF. The frame stays as it is: a copy with the objects, and their truth table, go to the
    output folder.

    \b
    Into a calibrated image and a raw frame, with the campaign that made them:
      csstsim inject calibrated/10100000004_09.fits --catalogue new.csv --output with --campaign campaign.yaml
      csstsim inject CSST_..._09_L0_V01.fits --catalogue new.csv --output with --campaign campaign.yaml
    Into a frame of another telescope, with the PSF that PSFEx found in it:
      csstsim inject image.fits --catalogue new.csv --output with --psf image.psf --zeropoint 25.1

    The light has its own Poisson noise. In a Level-0 frame it goes through the detector. docs/injection.md says more.
    """
    from csstsim.inject.inject import inject as run

    run(frames, catalogue, output, click.echo, campaign=campaign, instrument=instrument, **options)


@click.command()
@click.argument("frame", type=click.Path())
@click.argument("objects", type=click.Path())
@click.option("--output", required=True, type=click.Path(), help="The table to write: .csv, .ecsv, .fits or .parquet.")
@click.option("--grid", "spacing", type=Finite(1), metavar="PX", help="On a grid of this spacing.")
@click.option("--apart", type=Finite(0), metavar="PX", help="At random: at least so far from each other [default: 0].")
@click.option("--beside", "near", type=click.Path(), help="Next to the objects of this table.")
@click.option("--distance", nargs=2, type=Finite(0), metavar="LOW HIGH", help="With --beside: arcsec [default: 0.5 2].")
@click.option("--seed", type=click.IntRange(0), default=1, show_default=True, help="Seed of random places.")
@click.option("--campaign", type=click.Path(), help="Campaign that made the frame [default: the header tells].")
@click.option("--instrument", type=click.Path(), help="Folder of the camera, without --campaign [default: shipped].")
def place(
    frame: str,
    objects: str,
    output: str,
    spacing: float | None,
    apart: float | None,
    near: str | None,
    distance: tuple[float, float] | None,
    seed: int,
    **given: Any,
) -> None:
    """Give objects places in a frame, to be injected there.

    OBJECTS is a table of objects; its columns ra and dec are added or replaced. Without an option, places are random:
    away from pixels that DQ masks, and from bright ones.

    \b
    At random, on a grid of 200 px, and 0.5 to 2 arcsec from given objects (blends):
      csstsim place FRAME kinds.csv --output new.csv --campaign campaign.yaml --apart 30
      csstsim place FRAME kinds.csv --output new.csv --campaign campaign.yaml --grid 200
      csstsim place FRAME kinds.csv --output new.csv --beside known.csv --distance 0.5 2
    """
    from csstsim.inject.place import place as run
    from csstsim.inject.placement import Placement

    if sum(v is not None for v in (spacing, apart, near)) > 1 or (distance and near is None):
        raise click.UsageError("give one of --grid, --apart and --beside; --distance goes with --beside")
    placement = Placement(spacing, apart or 0.0, near, distance or (0.5, 2.0), seed)
    run(frame, objects, output, click.echo, placement, **given)


@click.command()
@click.argument("injected", type=click.Path())
@click.argument("original", type=click.Path())
@click.option("--output", type=click.Path(), help="Folder of tables and figure [default: beside INJECTED].")
@click.option("--campaign", type=click.Path(), help="Campaign that made the frames [default: the header tells].")
@click.option("--instrument", type=click.Path(), help="Folder of the camera, without --campaign [default: shipped].")
@click.option("--truth", type=click.Path(), help="Truth of the injected objects [default: beside INJECTED].")
def recover(
    injected: str, original: str, output: str | None, campaign: str | None, instrument: str | None, truth: str | None
) -> None:
    """Say how well injected objects are found and measured.

    INJECTED and ORIGINAL are measured by the same code. Injected objects are matched with sources that ORIGINAL lacks.
    Completeness, bias and scatter of magnitude, place and shape are printed and drawn, against magnitude, size and
    local density, with errors.

    \b
    For example:
      csstsim recover with/10100000004_09.fits calibrated/10100000004_09.fits --campaign campaign.yaml
    """
    from csstsim.inject.recovery.recover import recover as run

    run(injected, original, click.echo, output=output, campaign=campaign, instrument=instrument, truth=truth)
