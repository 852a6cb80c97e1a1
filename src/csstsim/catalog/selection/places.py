"""Where on a chip objects are in an exposure, and whether their light lands on its window."""

from __future__ import annotations

from typing import TYPE_CHECKING

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
SAMPLES = 129  # of a trail, to see where its dispersed light lands


def near(
    table: ObjectTable,
    wcs: ChipWCS,
    observer: Observer,
    window: Window,
    dispersed: float = 0.0,
    interval: Interval | None = None,
) -> tuple[IntArray, dict[str, FloatArray]]:
    """Return the rows that could reach the window, or whose place is unknown, and {name: values} of their places.

    dispersed: how far a grating may send light [pixel]. Places: ra, dec, ra_epoch, dec_epoch [deg], x, y [pixel], as
    select.select_objects describes them, and with an interval those of catalog.changing.motion.trails, if the table has
    rates.
    """
    located = np.flatnonzero(np.isfinite(table["ra"]) & np.isfinite(table["dec"]))
    star = table["obj_type"][located] == STAR  # nothing else moves, whatever the catalogue says
    motion = {name: np.where(star, table[name][located], 0.0) for name in ("pmra", "pmdec", "parallax", "rv")}
    epoch = at_epoch(table["ra"][located], table["dec"][located], observer, **motion)
    seen = apparent(*epoch, observer)
    found_at = np.full((6, len(table)), np.nan)
    found_at[:, located] = *seen, *epoch, *wcs.world_to_pixel(*seen)
    nowhere = np.isnan(found_at[0])
    places = dict(zip(("ra", "dec", "ra_epoch", "dec_epoch", "x", "y"), found_at, strict=True))
    reach = REACH_MAX + dispersed
    seen = _touches(places["x"], places["y"], reach, window) | nowhere
    if interval is not None and "rate_ra" in table:
        moving = np.flatnonzero(moves(table) & ~nowhere)
        found = trails(table.take(moving), wcs, observer, window, interval, reach + DISTORTION_PX)
        for name, values in found.items():
            places.setdefault(name, np.full(len(table), 0.0 if name == "trail_length" else np.nan))[moving] = values
        seen[moving] = np.isfinite(found["x"])
    rows = np.flatnonzero(seen)
    return rows, {name: values[rows] for name, values in places.items()}


def seconds_seen(places: Mapping[str, FloatArray], exptime: float, pixel_scale: float) -> FloatArray:
    """Return (n,) the time [s] whose light decides how far objects are visible: of a fast one, that near one place."""
    if "trail_length" not in places:
        return np.full(len(places["x"]), float(exptime))
    time = places["trail_end"] - places["trail_start"]
    length = places["trail_length"] / pixel_scale
    with np.errstate(invalid="ignore"):
        return np.where(length > 0, time * np.minimum(1.0, TRAIL_PX / np.where(length > 0, length, 1.0)), exptime)


def _touches(x: FloatArray, y: FloatArray, reach: Floats, window: Window) -> BoolArray:
    """Whether the square [x +- reach] meets a pixel of the window; False for NaN."""
    in_x = (x + reach >= window.x0 - 0.5) & (x - reach < window.x1 - 0.5)
    return in_x & (y + reach >= window.y0 - 0.5) & (y - reach < window.y1 - 0.5)


def lands(places: Mapping[str, FloatArray], far: FloatArray, window: Window, disperser: Disperser | None) -> BoolArray:
    """Whether light within `far` (n,) px of where it lands meets the window; False for NaN."""
    x = places["x"]
    y = places["y"]
    if "trail_length" in places and (trailed := places["trail_length"] > 0).any():
        still = {name: places[name] for name in ("x", "y")}
        if disperser is None:
            return np.where(trailed, crosses(places, far, window), lands(still, far, window, None))
        ends = [[places[f"trail_{axis}{k}"] for axis in "xy"] for k in (0, 1)]
        along = [{a: p + s * (q - p) for a, p, q in zip("xy", *ends, strict=True)} for s in np.linspace(0, 1, SAMPLES)]
        return np.where(
            trailed,
            np.any([lands(at, far, window, disperser) for at in along], axis=0),
            lands(still, far, window, disperser),
        )
    if disperser is None:
        return _touches(x, y, far, window)
    visits = disperser.visits(x, y, far)
    x0, x1, y0, y1 = np.moveaxis(disperser.boxes(visits, x, y), -1, 0)
    grown = far[visits[:, :1]]
    meets = (x1 + grown >= window.x0 - 0.5) & (x0 - grown < window.x1 - 0.5)
    meets &= (y1 + grown >= window.y0 - 0.5) & (y0 - grown < window.y1 - 0.5)
    found = np.zeros(len(x), bool)
    found[visits[meets.any(axis=1), 0]] = True
    return found
