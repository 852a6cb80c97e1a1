"""Positions of objects on a chip in an exposure, and whether their light reaches its window."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from csstsim.catalog.astrometry.reduction import apparent, at_epoch
from csstsim.catalog.changing.columns import moves
from csstsim.catalog.changing.motion import Interval, crosses, trails
from csstsim.catalog.selection.bricks import DISTORTION_PX
from csstsim.catalog.selection.reach import REACH_MAX
from csstsim.catalog.table import STAR, ObjectTable

if TYPE_CHECKING:
    from collections.abc import Mapping

    from csstsim.base.types import BoolArray, FloatArray, Floats, IntArray
    from csstsim.catalog.astrometry.ephemeris import Observer
    from csstsim.instrument.chip import Window
    from csstsim.optics.geometry.wcs import ChipWCS
    from csstsim.optics.gratings.dispersion import Disperser

TRAIL_PX = 64.0  # of a trail: light from further along it does not add up
SAMPLES = 129  # positions on a trail at which its dispersed light is compared with the window


class NearWindow(NamedTuple):
    """Objects that could reach a window: rows (n,) of their table and {name: (n,) values} of their positions.

    Positions are ra, dec, ra_epoch, dec_epoch [deg], x, y [pixel], as select.select_objects describes them. If the
    table has rates, those of catalog.changing.motion.trails are added in an interval.
    """

    rows: IntArray
    positions: dict[str, FloatArray]


def objects_near(
    table: ObjectTable,
    wcs: ChipWCS,
    observer: Observer,
    window: Window,
    dispersed: float = 0.0,
    interval: Interval | None = None,
) -> NearWindow:
    """Return the objects that could reach the window, or whose position is unknown.

    dispersed: maximum distance between an object and its dispersed light [pixel].
    """
    located = np.flatnonzero(np.isfinite(table["ra"]) & np.isfinite(table["dec"]))
    star = table["obj_type"][located] == STAR  # nothing else moves, whatever the catalogue says
    motion = {name: np.where(star, table[name][located], 0.0) for name in ("pmra", "pmdec", "parallax", "rv")}
    ra_epoch, dec_epoch = at_epoch(table["ra"][located], table["dec"][located], observer, **motion)
    ra, dec = apparent(ra_epoch, dec_epoch, observer)
    x, y = wcs.world_to_pixel(ra, dec)
    known = {"ra": ra, "dec": dec, "ra_epoch": ra_epoch, "dec_epoch": dec_epoch, "x": x, "y": y}
    positions = {name: np.full(len(table), np.nan) for name in known}
    for name, values in known.items():
        positions[name][located] = values
    nowhere = np.isnan(positions["ra"])
    reach = REACH_MAX + dispersed
    could_reach = _touches(positions["x"], positions["y"], reach, window) | nowhere
    if interval is not None and "rate_ra" in table:
        moving = np.flatnonzero(moves(table) & ~nowhere)
        trailed = trails(table.take(moving), wcs, observer, window, interval, reach + DISTORTION_PX)
        for name, values in trailed.items():
            missing = 0.0 if name == "trail_length" else np.nan
            positions.setdefault(name, np.full(len(table), missing))[moving] = values
        could_reach[moving] = np.isfinite(trailed["x"])
    rows = np.flatnonzero(could_reach)
    return NearWindow(rows, {name: values[rows] for name, values in positions.items()})


def visible_time(positions: Mapping[str, FloatArray], exptime: float, pixel_scale: float) -> FloatArray:
    """Return (n,) the time [s] that sets an object's visible radius: the exposure, or for a trail that near a point."""
    if "trail_length" not in positions:
        return np.full(len(positions["x"]), float(exptime))
    time = positions["trail_end"] - positions["trail_start"]
    length = positions["trail_length"] / pixel_scale
    with np.errstate(invalid="ignore"):
        return np.where(length > 0, time * np.minimum(1.0, TRAIL_PX / np.where(length > 0, length, 1.0)), exptime)


def _touches(x: FloatArray, y: FloatArray, reach: Floats, window: Window) -> BoolArray:
    """Return whether the square [x +- reach] meets a pixel of the window; False for NaN."""
    in_x = (x + reach >= window.x0 - 0.5) & (x - reach < window.x1 - 0.5)
    return in_x & (y + reach >= window.y0 - 0.5) & (y - reach < window.y1 - 0.5)


def reaches_window(
    positions: Mapping[str, FloatArray], radius: FloatArray, window: Window, disperser: Disperser | None
) -> BoolArray:
    """Return (n,) whether the window is within `radius` (n,) px of an object's light; False for NaN."""
    x = positions["x"]
    y = positions["y"]
    if "trail_length" in positions and (trailed := positions["trail_length"] > 0).any():
        still = {name: positions[name] for name in ("x", "y")}
        if disperser is None:
            crossing = crosses(positions, radius, window)
            return np.where(trailed, crossing, reaches_window(still, radius, window, None))
        ends = [[positions[f"trail_{axis}{k}"] for axis in "xy"] for k in (0, 1)]
        along = [{a: p + s * (q - p) for a, p, q in zip("xy", *ends, strict=True)} for s in np.linspace(0, 1, SAMPLES)]
        return np.where(
            trailed,
            np.any([reaches_window(at, radius, window, disperser) for at in along], axis=0),
            reaches_window(still, radius, window, disperser),
        )
    if disperser is None:
        return _touches(x, y, radius, window)
    visits = disperser.visits(x, y, radius)
    x0, x1, y0, y1 = np.moveaxis(disperser.boxes(visits, x, y), -1, 0)
    grown = radius[visits[:, :1]]
    meets = (x1 + grown >= window.x0 - 0.5) & (x0 - grown < window.x1 - 0.5)
    meets &= (y1 + grown >= window.y0 - 0.5) & (y0 - grown < window.y1 - 0.5)
    reached = np.zeros(len(x), bool)
    reached[visits[meets.any(axis=1), 0]] = True
    return reached
