"""`csstsim place`: positions in a frame for a table of objects, which are then injected there."""

from __future__ import annotations

from dataclasses import fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from csstsim.base.errors import InputError
from csstsim.base.files.atomic import atomic_path
from csstsim.base.old_names import warn_old_name
from csstsim.base.plural import number_of
from csstsim.catalog.astrometry.reduction import icrs
from csstsim.catalog.object_table import FORMATS, read_table
from csstsim.inject.frames import LEVEL0, OTHER, job_of, kind_of
from csstsim.inject.level0 import charge_in
from csstsim.inject.placement import Placement, free_pixels, grid, near_objects, random_positions
from csstsim.inject.request import log_or_say

if TYPE_CHECKING:
    from collections.abc import Callable

    from csstsim.base.types import AnyArray, BoolArray, FloatArray, PathLike

_RANDOM = Placement()


def place(
    frame: PathLike,
    objects: PathLike,
    target: PathLike,
    log: Callable[[str], object] = print,
    placement: Placement = _RANDOM,
    **options: Any,
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
    log : callable
        Function that gets each message.
    placement : Placement
        How the positions are chosen. Default: at random on free pixels.
    **options : object
        campaign, instrument and cache, as csstsim.inject.frames.job_of takes them. The fields of Placement (`apart` for
        `min_separation`) as they were given before; deprecated.

    Raises
    ------
    InputError
        For a frame or table that cannot be used, or a target that exists.
    """
    from astropy.table import Table

    log = log_or_say(log, options)
    placement = _with_keywords(placement, options)
    target = Path(target)
    if target.suffix not in FORMATS or target.exists():
        allowed = f"a new file, {', '.join(FORMATS)}"
        raise InputError("cannot be the table", file=target, key="--output", allowed=allowed)
    columns = read_table(objects)
    parts = np.nan_to_num(np.asarray(columns.get("part_of", [-1]), float), nan=-1.0) >= 0
    if parts.any():  # the position of a part is its offset from its object
        message = "cannot place parts of objects"
        allowed = "a table without part_of"
        raise InputError(message, file=objects, key="part_of", allowed=allowed)
    count = len(next(iter(columns.values()), ()))
    if placement.near is not None:
        others = _objects_of(placement.near)
        ra, dec = near_objects(others["ra"], others["dec"], count, *placement.distance, placement.seed)
    else:
        image, bad, near_bad, to_sky = opened(frame, log, **options)
        if placement.spacing is not None:
            x, y = grid(image.shape, placement.spacing)
            has_value = np.isfinite(image[np.rint(y).astype(int), np.rint(x).astype(int)])
            x = x[has_value]
            y = y[has_value]
            if len(x) < count:
                message = f"a grid of {len(x)} positions is too small for {count} objects"
                allowed = "a smaller spacing"
                raise InputError(message, file=objects, key="--grid", value=placement.spacing, allowed=allowed)
            x = x[:count]
            y = y[:count]
        else:
            free = free_pixels(image, None if near_bad else bad)
            if bad is not None:
                free &= ~bad
            x, y = random_positions(free, count, placement.seed, placement.min_separation)
        ra, dec = to_sky(x, y)
    columns |= {"ra": ra, "dec": dec}
    columns.setdefault("id", np.arange(1, count + 1))
    with atomic_path(target) as temporary:
        Table(columns).write(temporary, format=FORMATS[target.suffix], overwrite=True)
    log(f"{target}: {number_of(count, 'object')}")


def _with_keywords(placement: Placement, options: dict[str, Any]) -> Placement:
    """Return a Placement with the deprecated keywords of `place`, which are removed from the options."""
    if "apart" in options:
        options["min_separation"] = options.pop("apart")
    given = {field.name: options.pop(field.name) for field in fields(Placement) if field.name in options}
    if given:
        warn_old_name("give placement=Placement(...)", goes="0.3.0", stacklevel=2)
    return replace(placement, **given)


def _objects_of(path: PathLike) -> dict[str, Any]:
    """Return {name: values} of a table with valid ra, dec [deg]. Raises InputError."""
    columns = read_table(path)
    if not {"ra", "dec"} <= set(columns):
        raise InputError("lacks a column", file=path, key="ra, dec")
    for name, low, high in (("ra", -180, 360), ("dec", -90, 90)):
        values = columns[name] if columns[name].dtype.kind in "fiu" else np.full(len(columns[name]), np.nan)
        invalid = np.flatnonzero(~((values >= low) & (values <= high)))
        if len(invalid):
            raise InputError(
                "not a position on the sky",
                file=path,
                key=f"{name}, row {invalid[0] + 1}",
                value=columns[name][invalid[0]].item(),
                allowed=f"{low} to {high} deg",
            )
    return columns


class OpenedFrame(NamedTuple):
    """A frame: `image` (ny, nx), `bad` pixels (ny, nx) bool or None, `to_sky`: from x, y [px] to ra, dec [deg].

    Pixels without a value are NaN. `bad`: flagged in DQ. near_bad: whether objects may lie next to them.
    """

    image: AnyArray
    bad: BoolArray | None
    near_bad: bool
    to_sky: Callable[[FloatArray, FloatArray], tuple[FloatArray, FloatArray]]


def opened(frame: PathLike, log: Callable[[str], object], **options: Any) -> OpenedFrame:
    """Return the OpenedFrame of a frame's file; options: as for `place`."""
    kind = kind_of(frame)
    if kind == OTHER:
        from csstsim.inject.others.frame import read_foreign

        image = read_foreign(frame)
        values = np.where(image.has_value(), image.image, np.nan)
        return OpenedFrame(values, image.flagged, True, image.wcs.sky)  # others flag too many pixels to stay 8 px away
    run, job = job_of(frame, log=log, **options)

    def to_sky(x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
        return icrs(*job.wcs.pixel_to_world(x + job.window.x0, y + job.window.y0), job.observer)

    if kind == LEVEL0:
        from csstsim.io.level0 import read_level0

        return OpenedFrame(charge_in(run, read_level0(frame)), None, False, to_sky)
    from csstsim.io.fits import open_fits, read_pixels

    with open_fits(frame) as file:
        return OpenedFrame(read_pixels(file["SCI"], frame), read_pixels(file["DQ"], frame) > 0, False, to_sky)
