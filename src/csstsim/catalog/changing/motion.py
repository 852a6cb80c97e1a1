"""Motion on the sky: the position of an object with a rate, when it is near a chip, and its trail.

An object at ra, dec at the time rate_mjd moves on a great circle at constant speed, as seen from the telescope. It is
visible up to a quarter of a turn from that position, and not beyond. So one row is an asteroid for weeks, and a
satellite for one passage. Omitted: the curvature of a trail by the telescope's own orbit (for a main-belt asteroid in
150 s up to 0.02 arcsec).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from csstsim.base.sphere import frames, ra_dec, unit_vectors, wrap_360
from csstsim.base.units import ARCSEC_PER_RAD, DAY_S
from csstsim.catalog.astrometry.reduction import apparent, icrs

if TYPE_CHECKING:
    from csstsim.base.types import BoolArray, FloatArray
    from csstsim.catalog.astrometry.ephemeris import Observer
    from csstsim.catalog.table import ObjectTable
    from csstsim.instrument.chip import Window
    from csstsim.optics.geometry.wcs import ChipWCS

MAX_ANGLE = np.pi / 2  # rad from ra, dec
HOUR_S = 3600.0


class Interval(NamedTuple):
    """The time during which an exposure's shutter is open."""

    start: float  # MJD, UTC
    exptime: float  # s
    # columns [px] -> s for which the leaves cover them, half of it at either end
    lost: Callable[[FloatArray], FloatArray] | None = None

    @property
    def middle(self) -> float:
        """MJD of the middle of the exposure, the same for all columns of a chip."""
        return self.start + 0.5 * self.exptime / DAY_S

    def exposed(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return (first, last) [s after the start]: when columns x [px] of the chip are exposed."""
        wait = np.zeros(np.shape(x)) if self.lost is None else 0.5 * self.lost(x)
        return wait, self.exptime - wait


class Motion:
    """The motion of the rows of a table that has rates (catalog.changing.columns)."""

    def __init__(self, table: ObjectTable, interval: Interval) -> None:
        self.interval = interval
        self._start, east, north = frames(np.radians(table["ra"]), np.radians(table["dec"]))
        along = table["rate_ra"]
        up = table["rate_dec"]
        speed = np.hypot(along, up)
        safe = np.where(speed > 0, speed, 1.0)[:, None]
        self._towards = (along[:, None] * east + up[:, None] * north) / safe
        self.speed = speed / HOUR_S  # arcsec / s
        self._before = (interval.start - table["rate_mjd"]) * DAY_S  # s from rate_mjd to the start of the exposure

    def angle(self, t: FloatArray) -> FloatArray:
        """Return the angle [rad] from ra, dec at t (n, ...) [s after the start]."""
        t = np.asarray(t, float)
        shape = (-1,) + (1,) * (t.ndim - 1)
        return self.speed.reshape(shape) / ARCSEC_PER_RAD * (self._before.reshape(shape) + t)

    def position(self, t: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return ra, dec [deg], ICRS, at t (n, ...) [s after the start of the exposure]."""
        phi = self.angle(t)[..., None]
        shape = (len(self.speed),) + (1,) * (phi.ndim - 2) + (3,)
        return ra_dec(np.cos(phi) * self._start.reshape(shape) + np.sin(phi) * self._towards.reshape(shape))

    def position_angle(self, t: FloatArray) -> FloatArray:
        """Return the position angle of the motion [deg, north through east] at t (n,) [s after the start]."""
        phi = self.angle(t)[:, None]
        velocity = np.cos(phi) * self._towards - np.sin(phi) * self._start
        _, east, north = frames(*np.radians(self.position(t)))
        e, n = (np.einsum("ni,ni->n", velocity, axis) for axis in (east, north))
        return wrap_360(np.degrees(np.arctan2(e, n)))

    def times_near(self, centre: tuple[FloatArray, FloatArray], radius: float) -> tuple[FloatArray, FloatArray]:
        """Return (first, last) (n,) [s after the start]: when within `radius` [rad] of a position (ra, dec) [deg].

        Only times of the exposure count; NaN: at none of them.
        """
        c = unit_vectors(*centre)
        a = self._start @ c
        b = self._towards @ c
        cosine = np.hypot(a, b)  # of the smallest distance
        with np.errstate(invalid="ignore", divide="ignore"):
            half = np.arccos(np.clip(np.cos(radius) / cosine, -1.0, 1.0))
            half = np.where(np.cos(radius) > cosine, np.nan, half)
            best = np.arctan2(b, a)
            ends = np.clip(best - half, -MAX_ANGLE, MAX_ANGLE), np.clip(best + half, -MAX_ANGLE, MAX_ANGLE)
            first, last = (end * ARCSEC_PER_RAD / self.speed - self._before for end in ends)
            first, last = (np.clip(t, 0.0, self.interval.exptime) for t in (first, last))
        never = ~(last > first)
        return np.where(never, np.nan, first), np.where(never, np.nan, last)


def trails(
    table: ObjectTable, wcs: ChipWCS, observer: Observer, window: Window, interval: Interval, margin: float
) -> dict[str, FloatArray]:
    """Return {name: (n,)} of the trails of a table's rows that move; NaN where they do not come near the window.

    margin [px]: maximum distance from the window. trail_start, trail_end [s after the start]: while the object is near
    the window and its column is exposed; trail_length [arcsec], trail_angle [deg, north through east] of the motion
    between them; trail_x0, trail_y0, trail_x1, trail_y1 [px]: its pixels then; ra, dec, ra_epoch, dec_epoch, x, y: the
    position in the middle of that time, as catalog.selection.select describes them.
    """
    motion = Motion(table, interval)
    middle = wcs.pixel_to_world(0.5 * (window.x0 + window.x1 - 1), 0.5 * (window.y0 + window.y1 - 1))
    half = 0.5 * np.hypot(window.nx, window.ny) + margin
    first, last = motion.times_near(icrs(*middle, observer), half * wcs.chip.telescope.pixel_scale / ARCSEC_PER_RAD)
    x = positions_at(motion, wcs, observer, 0.5 * (first + last)).x
    opened, closed = interval.exposed(np.clip(np.nan_to_num(x), 0, wcs.chip.detector.nx - 1))
    first = np.fmax(first, opened)
    last = np.fmin(last, closed)
    first, last = (np.where(np.isfinite(x) & (last > first), t, np.nan) for t in (first, last))
    mean = 0.5 * (first + last)
    begin, end = (positions_at(motion, wcs, observer, t) for t in (first, last))
    return positions_at(motion, wcs, observer, mean)._asdict() | {
        "trail_start": first,
        "trail_end": last,
        "trail_length": motion.speed * (last - first),
        "trail_angle": motion.position_angle(mean),
        "trail_x0": begin.x,
        "trail_y0": begin.y,
        "trail_x1": end.x,
        "trail_y1": end.y,
    }


def crosses(trail: Mapping[str, FloatArray], distance: FloatArray, window: Window) -> BoolArray:
    """Return (n,) bool: the trail of `trails` comes within `distance` (n,) px of the window, along either axis."""
    x = trail["trail_x0"]
    y = trail["trail_y0"]
    dx = trail["trail_x1"] - x
    dy = trail["trail_y1"] - y
    enter = np.zeros(len(x))
    leave = np.ones(len(x))
    with np.errstate(divide="ignore", invalid="ignore"):
        for at, step, low, high in ((x, dx, window.x0, window.x1), (y, dy, window.y0, window.y1)):
            lower = low - 0.5 - distance
            upper = high - 0.5 + distance
            ends = np.sort([(lower - at) / step, (upper - at) / step], axis=0)
            still = step == 0
            within = (at >= lower) & (at < upper)
            enter = np.maximum(enter, np.where(still, np.where(within, 0.0, np.inf), ends[0]))
            leave = np.minimum(leave, np.where(still, 1.0, ends[1]))
        return enter <= leave


class Positions(NamedTuple):
    """Positions of moving objects: apparent, in the ICRS at the epoch [deg], and on the chip [0-based pixel]."""

    ra: FloatArray
    dec: FloatArray
    ra_epoch: FloatArray
    dec_epoch: FloatArray
    x: FloatArray
    y: FloatArray


def positions_at(motion: Motion, wcs: ChipWCS, observer: Observer, t: FloatArray) -> Positions:
    """Return the Positions of objects at t (n, ...) [s after the start], arrays of that shape."""
    epoch = motion.position(t)
    seen = apparent(*epoch, observer)
    return Positions(*seen, *epoch, *wcs.world_to_pixel(*seen))
