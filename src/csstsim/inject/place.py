"""`csstsim place`: a table of objects gets positions in a frame, to be injected there."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from csstsim.base.errors import InputError
from csstsim.base.files.atomic import atomic_path
from csstsim.base.plural import number_of
from csstsim.catalog.astrometry.reduction import icrs
from csstsim.catalog.object_table import FORMATS, read_table
from csstsim.inject.frames import LEVEL0, OTHER, job_of, kind_of
from csstsim.inject.level0 import charge_in
from csstsim.inject.placement import beside, free_pixels, grid, random

if TYPE_CHECKING:
    from collections.abc import Callable

    from csstsim.base.types import AnyArray, BoolArray, FloatArray, PathLike


def place(
    frame: PathLike,
    objects: PathLike,
    target: PathLike,
    say: Callable[[str], object] = print,
    *,
    spacing: float | None = None,
    apart: float = 0.0,
    near: PathLike | None = None,
    distance: tuple[float, float] = (0.5, 2.0),
    seed: int = 1,
    **given: Any,
) -> None:
    """Write a table of objects with positions in a frame: the columns ra and dec are added or replaced.

    Parameters
    ----------
    frame : str or Path
        FITS file of a frame.
    objects : str or Path
        Table's file with a row per object, with the columns of catalog.own_table.
    target : str or Path
        The new table: .csv, .ecsv or .fits.
    say : callable
        Function that gets each message.
    spacing : float, optional
        Distance of the points of a grid on which objects are placed [pixel]. Without it and `near`, positions are
        random on free pixels.
    apart : float
        Minimum distance between random positions [pixel].
    near : str or Path, optional
        Table's file of objects next to which objects are placed.
    distance : (float, float)
        Minimum and maximum distance from the objects of `near` [arcsec].
    seed : int
        Of the random positions.
    **given : object
        campaign, instrument and cache, as csstsim.inject.frames.job_of takes them.

    Raises
    ------
    InputError
        For a frame or table that cannot be used, or a target that exists.
    """
    from astropy.table import Table

    target = Path(target)
    if target.suffix not in FORMATS or target.exists():
        allowed = f"a new file, {', '.join(FORMATS)}"
        raise InputError("cannot be the table", file=target, key="--output", allowed=allowed)
    columns = read_table(objects)
    parts = np.nan_to_num(np.asarray(columns.get("part_of", [-1]), float), nan=-1.0) >= 0
    if parts.any():  # a part lies where its offset from its object puts it
        message = "cannot place parts of objects"
        allowed = "a table without part_of"
        raise InputError(message, file=objects, key="part_of", allowed=allowed)
    count = len(next(iter(columns.values()), ()))
    if near is not None:
        others = read_table(near)
        if not {"ra", "dec"} <= set(others):
            raise InputError("lacks a column", file=near, key="ra, dec")
        for name, low, high in (("ra", -180, 360), ("dec", -90, 90)):
            values = others[name] if others[name].dtype.kind in "fiu" else np.full(len(others[name]), np.nan)
            wrong = np.flatnonzero(~((values >= low) & (values <= high)))
            if len(wrong):
                raise InputError(
                    "not a position on the sky",
                    file=near,
                    key=f"{name}, row {wrong[0] + 1}",
                    value=others[name][wrong[0]].item(),
                    allowed=f"{low} to {high} deg",
                )
        ra, dec = beside(others["ra"], others["dec"], count, *distance, seed)
    else:
        image, bad, to_sky = opened(frame, say, **given)
        if spacing is not None:
            x, y = grid(image.shape, spacing)
            if len(x) < count:
                message = f"a grid of {len(x)} positions is too small for {count} objects"
                raise InputError(message, file=objects, key="--grid", value=spacing, allowed="a smaller spacing")
            x = x[:count]
            y = y[:count]
        else:
            x, y = random(free_pixels(image, bad), count, seed, apart)
        ra, dec = to_sky(x, y)
    columns |= {"ra": ra, "dec": dec}
    columns.setdefault("id", np.arange(1, count + 1))
    with atomic_path(target) as temporary:
        Table(columns).write(temporary, format=FORMATS[target.suffix], overwrite=True)
    say(f"{target}: {number_of(count, 'object')}")


class OpenedFrame(NamedTuple):
    """Of a frame: `image` (ny, nx), `bad` pixels (ny, nx) bool or None, `to_sky`: of x, y to ra, dec as a table has."""

    image: AnyArray
    bad: BoolArray | None
    to_sky: Callable[[FloatArray, FloatArray], tuple[FloatArray, FloatArray]]


def opened(frame: PathLike, say: Callable[[str], object], **given: Any) -> OpenedFrame:
    """Return the OpenedFrame of a frame's file; given: as for `place`."""
    kind = kind_of(frame)
    if kind == OTHER:
        from csstsim.inject.others.frame import read_foreign

        image = read_foreign(frame)
        return OpenedFrame(image.image, None, image.wcs.sky)
    run, job = job_of(frame, say=say, **given)

    def to_sky(x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
        return icrs(*job.wcs.pixel_to_world(x + job.window.x0, y + job.window.y0), job.observer)

    if kind == LEVEL0:
        from csstsim.io.level0 import read_level0

        return OpenedFrame(charge_in(run, read_level0(frame)), None, to_sky)
    from csstsim.io.fits import open_fits, read_pixels

    with open_fits(frame) as file:
        return OpenedFrame(read_pixels(file["SCI"], frame), read_pixels(file["DQ"], frame) > 0, to_sky)
