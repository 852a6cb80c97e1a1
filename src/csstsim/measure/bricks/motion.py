"""Sources that move: groups of detections that are one object at constant speed are joined into one source.

`bricks.associate` joins what lies together, so an object that moves leaves a group at each place. Two groups may be one
object if no frame has both, frames of each cover the place of the other, one of their detections has S/N >= SNR_LEAST,
and their magnitudes agree where they share a band. They are joined if one constant speed explains all detections.

* A star moves up to STAR_MOST arcsec a year, and its groups are joined at any distance in time. One group may be
  followed by several: a star whose motion is hidden by the error of a place leaves few groups, a faster one many.
* Anything else that moves is an object of the solar system, up to SOLAR_MOST arcsec an hour. Its groups are single
  detections. They are linked within SOLAR_PAIR days, if their light is trailed as their speed says: over hours it moves
  by arcminutes, and too many unrelated detections lie on a line. A chain of links on a line within SOLAR_SPAN days is
  one object, and so is one link of which neither end has another. Detection may cut a bright trail into pieces: within
  PIECES arcsec in a frame the one of most Kron flux stands for all of them; the others are members without flux and
  weight.

Left out: parallax (it counts as an error of PARALLAX arcsec), and objects that cross into another brick.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from scipy.spatial import ConvexHull, QhullError, cKDTree

from csstsim.base.sphere import frames as tangent
from csstsim.base.sphere import normalised, ra_dec
from csstsim.base.types import BoolArray, FloatArray, IntArray
from csstsim.base.units import JULIAN_YEAR_DAYS

if TYPE_CHECKING:
    from csstsim.catalog.table import ObjectTable

ARCSEC = np.pi / 180.0 / 3600.0
# column `motion`; 0: at rest
STAR = 1
SOLAR = 2
SNR_FAINT = 6.0  # fainter detections may be noise
SNR_LEAST = 10.0  # fainter sources are seen in one frame and not in another by chance
STAR_MOST = 5.0  # arcsec / yr; about ten stars of the sky are faster
# arcsec / hour; a main-belt asteroid at opposition: 30
SOLAR_MOST = 120.0
SOLAR_LEAST = 0.5
# day
SOLAR_SPAN = 0.5
SOLAR_PAIR = 0.03
# of a detection's place; arcsec
N_SIGMA = 5.0
FLOOR = 0.010
PARALLAX = 0.03
# Kron over PSF flux of a trail longer than so many arcsec
TRAILED = 1.15
TRAIL_PX = 0.4
MAG_OFF = 0.5  # mag, between groups in a band: more than most variable stars
PIECES = 1.5  # arcsec, half a trail of 60 arcsec / hour in 150 s, and some
# arcsec, error of a place without weight
_MOST_PAIRS = 2_000_000
_UNKNOWN = 10.0


class Joined(NamedTuple):
    """Detections (n,) as sources.

    source (n,): number, 0 to sources - 1; motion (sources,): STAR, SOLAR or 0; speed (sources, 2): arcsec / yr to the
    east and north; at (n, 3): unit vector to the source at each detection, NaN for one at rest; epoch (sources,): MJD
    of the weighted mean position; piece (n,): whether a detection is a piece of a trail for which another one of the
    frame stands.
    """

    source: IntArray
    motion: IntArray
    speed: FloatArray
    at: FloatArray
    epoch: FloatArray
    piece: BoolArray


class Line(NamedTuple):
    """Motion at constant speed: mean unit vector, speed (2,) [arcsec / yr], residuals (n, 2) [arcsec], mean MJD.

    Speed and residuals are to the east and north.
    """

    mean: FloatArray
    speed: FloatArray
    residual: FloatArray
    epoch: float


def joined(found: ObjectTable, vectors: FloatArray, source: IntArray) -> Joined:
    """Return the detections with groups of one moving object joined; sources are numbered anew.

    found: ObjectTable of bricks.merge.DETECTION_COLUMNS with frame, mjd [day, NaN: not known] and exptime [s]; vectors
    (n, 3): unit vectors; source (n,): groups of bricks.associate.
    """
    source, host = _alone(found, source)
    count = int(source.max(initial=-1)) + 1
    groups = _Groups(found, vectors, source, count)
    owner = np.arange(count)
    kind = np.zeros(count, int)
    if np.isfinite(groups.time).sum() > 1:
        for which, pairs in ((STAR, _star_pairs(groups)), (SOLAR, None)):
            pairs = _solar_pairs(groups, kind[owner] == 0) if pairs is None else pairs
            _join(groups, owner, kind, pairs, which)
    piece = np.zeros(count, bool)
    for whole, part in groups.pieces:
        if kind[owner[whole]] == SOLAR and kind[owner[part]] == 0:
            owner[part] = owner[whole]
            piece[part] = True
    piece = piece[source]
    passengers = np.arange(count - len(host), count)
    back = kind[owner[host]] == 0
    owner[passengers[back]] = owner[host[back]]
    names, source = np.unique(owner[source], return_inverse=True)
    motion = kind[names]
    speed, at, epoch = _places(found, vectors, source, motion, piece)
    return Joined(source, motion, speed, at, epoch, piece)


def _alone(found: ObjectTable, source: IntArray) -> tuple[IntArray, IntArray]:
    """Return (source, host): groups of one bright detection without the faint ones that lie there by chance.

    Those are groups of their own, behind the others, which go back to their hosts if these do not move.
    """
    count = int(source.max(initial=-1)) + 1
    bright = found["snr"] >= SNR_FAINT
    top = np.zeros(count)
    np.maximum.at(top, source, found["snr"])
    lonely = (np.bincount(source, bright, count) == 1) & (top >= SNR_LEAST)
    rows = np.flatnonzero(lonely[source] & ~bright)
    host = source[rows]
    source = source.copy()
    source[rows] = count + np.arange(len(rows))
    return source, host


class _Groups:
    """Groups of detections: places, times, frames, fluxes."""

    def __init__(self, found: ObjectTable, vectors: FloatArray, source: IntArray, count: int) -> None:
        self.found = found
        self.vectors = vectors
        self.source = source
        self.order = np.argsort(source, kind="stable")
        self.starts = np.searchsorted(source[self.order], np.arange(count + 1))
        weight = np.hypot(found["pos_err"], FLOOR) ** -2.0
        total = np.bincount(source, weight, count)
        mean = np.stack([np.bincount(source, weight * vectors[:, k], count) for k in range(3)], axis=1)
        self.place = normalised(mean / np.maximum(total, 1e-300)[:, None]) if count else mean
        self.time = np.bincount(source, weight * found["mjd"], count) / np.maximum(total, 1e-300)
        self.snr = np.zeros(count)
        np.maximum.at(self.snr, source, found["snr"])
        self.size = np.bincount(source, minlength=count)
        number = np.unique(found["frame"], return_inverse=True)[1]
        self.bits = np.zeros((count, int(number.max(initial=0)) // 64 + 1), np.uint64)
        np.bitwise_or.at(self.bits, (source, number // 64), np.uint64(1) << (number % 64).astype(np.uint64))
        self.number = number
        self._hulls: dict[int, tuple[FloatArray, FloatArray] | None] = {}
        self.pieces: list[tuple[int, int]] = []
        self.band = np.unique(found["filter"], return_inverse=True)[1]
        with np.errstate(divide="ignore", invalid="ignore"):
            self.mag = found["zeropoint"] - 2.5 * np.log10(found["flux_kron"])

    def rows(self, group: int | Sequence[int]) -> IntArray:
        """Return the detections of a group, or of several."""
        return np.concatenate([self.order[self.starts[g] : self.starts[g + 1]] for g in np.atleast_1d(group)])

    def pairs(self, some: IntArray, distance: float) -> tuple[IntArray, IntArray]:
        """Return (a, b) of groups `some` within a distance [arcsec] and without a common frame."""
        tree = cKDTree(self.place[some])
        near = tree.query_pairs(distance * ARCSEC, output_type="ndarray")
        if len(near) > _MOST_PAIRS:  # a crowded field: the closest ones
            apart = np.linalg.norm(self.place[some][near[:, 0]] - self.place[some][near[:, 1]], axis=1)
            near = near[np.argsort(apart, kind="stable")[:_MOST_PAIRS]]
        a = some[near[:, 0]]
        b = some[near[:, 1]]
        apart = ((self.bits[a] & self.bits[b]) == 0).all(axis=1)
        return a[apart], b[apart]

    def alike(self, a: int, b: int) -> bool:
        """Whether two groups have magnitudes that agree in every band that both have."""
        one = self.rows(a)
        other = self.rows(b)
        for band in np.intersect1d(self.band[one], self.band[other]):
            mags = [_median(self.mag[rows[self.band[rows] == band]]) for rows in (one, other)]
            if not abs(mags[0] - mags[1]) < MAG_OFF:
                return False
        return True

    def seen(self, a: int, b: int) -> bool:
        """Whether a frame of group a covers the place of group b."""
        return any(self._covers(number, self.place[b]) for number in np.unique(self.number[self.rows(a)]))

    def _covers(self, number: int, place: FloatArray) -> bool:
        if number not in self._hulls:
            self._hulls[number] = _hull(self.vectors[self.number == number])
        hull = self._hulls[number]
        if hull is None:
            return False
        equations, axes = hull
        return bool((equations[:, :2] @ (axes @ place) + equations[:, 2] <= 1.0 * ARCSEC).all())


def _median(mags: FloatArray) -> float:
    """Return the median of what is not NaN; NaN if all are (no flux above zero)."""
    known = mags[~np.isnan(mags)]
    return float(np.median(known)) if known.size else np.nan


def _hull(vectors: FloatArray) -> tuple[FloatArray, FloatArray] | None:
    """Return (equations, axes) of the convex hull of a frame's detections on a plane; None of fewer than three."""
    centre = normalised(vectors.mean(axis=0))
    axes = _axes(centre)
    try:
        return ConvexHull(vectors @ axes.T).equations, axes
    except (QhullError, ValueError):
        return None


def _axes(centre: FloatArray) -> FloatArray:
    """Return the unit vectors (2, 3) towards east and north at a unit vector."""
    _, east, north = tangent(*np.radians(ra_dec(centre)))
    return np.stack([east, north])


def _star_pairs(groups: _Groups) -> IntArray:
    """Return the pairs of groups that may be a star, nearest in place first."""
    some = np.flatnonzero((groups.snr >= SNR_LEAST) & np.isfinite(groups.time))
    if len(some) < 2:
        return np.zeros((0, 2), int)
    years = np.ptp(groups.time[some]) / JULIAN_YEAR_DAYS
    a, b = groups.pairs(some, STAR_MOST * years + 2 * PARALLAX)
    apart = np.linalg.norm(groups.place[a] - groups.place[b], axis=1) / ARCSEC
    good = apart <= STAR_MOST * np.abs(groups.time[a] - groups.time[b]) / JULIAN_YEAR_DAYS + 2 * PARALLAX
    order = np.lexsort((b[good], a[good], apart[good]))
    return np.stack([a[good][order], b[good][order]], axis=1)


def _solar_pairs(groups: _Groups, free: BoolArray) -> IntArray:
    """Return the pairs of single detections that may be an object of the solar system, nearest in time first."""
    some: IntArray = np.flatnonzero(free & (groups.size == 1) & (groups.snr >= SNR_LEAST) & np.isfinite(groups.time))
    some = _whole(groups, some)
    if len(some) < 2:
        return np.zeros((0, 2), int)
    a, b = groups.pairs(some, SOLAR_MOST * 24 * SOLAR_PAIR)
    hours = 24 * np.abs(groups.time[a] - groups.time[b])
    apart = np.linalg.norm(groups.place[a] - groups.place[b], axis=1) / ARCSEC
    with np.errstate(divide="ignore", invalid="ignore"):
        speed = apart / hours
    good = (hours > 0) & (hours <= 24 * SOLAR_PAIR) & (speed <= SOLAR_MOST) & (speed >= SOLAR_LEAST)
    good &= _trailed(groups, a, speed) & _trailed(groups, b, speed)
    order = np.lexsort((b[good], a[good], apart[good], hours[good]))
    return np.stack([a[good][order], b[good][order]], axis=1)


def _whole(groups: _Groups, some: IntArray) -> IntArray:
    """Return the single detections `some` without those that another one of the frame stands for; notes both."""
    if len(some) < 2:
        return some
    rows = groups.order[groups.starts[some]]
    flux = np.nan_to_num(groups.found["flux_kron"][rows])
    number = groups.number[rows]
    near = cKDTree(groups.place[some]).query_pairs(PIECES * ARCSEC, output_type="ndarray")
    near = near[number[near[:, 0]] == number[near[:, 1]]]
    first = np.where(flux[near[:, 0]] >= flux[near[:, 1]], near[:, 0], near[:, 1])
    order = np.lexsort((near.sum(axis=1) - first, -flux[first]))
    taken = np.zeros(len(some), bool)
    for whole, part in zip(first[order].tolist(), (near.sum(axis=1) - first)[order].tolist(), strict=True):
        if not taken[whole] and not taken[part]:
            taken[part] = True
            groups.pieces.append((some[whole], some[part]))
    return some[~taken]


def _trailed(groups: _Groups, group: IntArray, speed: FloatArray) -> BoolArray:
    """Whether the light of single detections is wide enough for a speed [arcsec / hour]."""
    rows = groups.order[groups.starts[group]]
    found = groups.found
    with np.errstate(divide="ignore", invalid="ignore"):
        wide = found["flux_kron"][rows] / found["flux_psf"][rows] >= TRAILED
    return wide | ~(speed * found["exptime"][rows] / 3600.0 > TRAIL_PX)


def _join(groups: _Groups, owner: IntArray, kind: IntArray, pairs: IntArray, which: int) -> None:
    """Join pairs of groups (m, 2) one after the other where one speed explains all; changes owner and kind."""
    good = [(a, b) for a, b in pairs.tolist() if groups.alike(a, b) and groups.seen(a, b) and groups.seen(b, a)]
    partners = np.bincount(np.array(good, int).ravel(), minlength=len(owner)) if good else np.zeros(len(owner), int)
    members: dict[int, list[int]] = {}
    for a, b in good:
        one = owner[a]
        other = owner[b]
        if one == other:
            continue
        whole = members.get(one, [one]) + members.get(other, [other])
        bits = [np.bitwise_or.reduce(groups.bits[members.get(g, [g])], axis=0) for g in (one, other)]
        if (bits[0] & bits[1]).any() or not _straight(groups, whole, which):
            continue
        keep = min(one, other)
        gone = max(one, other)
        members[keep] = sorted(whole)
        members.pop(gone, None)
        owner[np.isin(owner, (one, other))] = keep
        kind[keep] = which
        kind[gone] = 0
    if which != SOLAR:
        return
    for name, whole in members.items():  # two detections alone make a line of any two
        if kind[name] == SOLAR and len(whole) == 2 and partners[whole].max() > 1:
            owner[whole] = whole
            kind[name] = 0


def _straight(groups: _Groups, members: Sequence[int], which: int) -> bool:
    """Whether all detections of groups lie on one line at constant speed, within their errors, and not too fast."""
    rows = groups.rows(members)
    found = groups.found
    time = found["mjd"][rows]
    error = np.hypot(found["pos_err"][rows], FLOOR)
    if which == SOLAR and np.ptp(time) > SOLAR_SPAN:
        return False
    line = fitted(groups.vectors[rows], error, time)
    most = STAR_MOST if which == STAR else SOLAR_MOST * 24 * JULIAN_YEAR_DAYS
    # A piece that stands for a trail is off its middle
    trail = np.hypot(*line.speed) / (24 * JULIAN_YEAR_DAYS) * np.nanmax(found["exptime"][rows]) / 3600.0
    tolerance = N_SIGMA * error + (PARALLAX if which == STAR else 0.05 + 0.3 * trail)
    return bool(np.hypot(*line.speed) <= most and (np.hypot(*line.residual.T) <= tolerance).all())


def fitted(vectors: FloatArray, error: FloatArray, time: FloatArray) -> Line:
    """Return the Line through positions (n, 3), unit vectors; error (n,): arcsec on an axis; time (n,): MJD."""
    weight = error**-2.0
    weight = weight / weight.sum()
    mean = normalised(weight @ vectors)
    epoch = float(weight @ time)
    plane = (vectors @ _axes(mean).T) / ARCSEC
    years = (time - epoch) / JULIAN_YEAR_DAYS
    spread = float(weight @ years**2)
    speed = (weight * years) @ plane / spread if spread > 0 else np.zeros(2)
    return Line(mean, speed, plane - weight @ plane - years[:, None] * speed, epoch)


def _places(
    found: ObjectTable, vectors: FloatArray, source: IntArray, kind: IntArray, piece: BoolArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return (speed, at, epoch) as of `joined`; sources at rest have no speed."""
    count = len(kind)
    sigma = np.where(piece, _UNKNOWN, np.hypot(found["pos_err"], FLOOR))
    weight = sigma**-2.0
    total = np.maximum(np.bincount(source, weight, count), 1e-300)
    epoch = np.bincount(source, weight * found["mjd"], count) / total
    speed = np.zeros((count, 2))
    at = np.full((len(source), 3), np.nan)
    order = np.argsort(source, kind="stable")
    starts = np.searchsorted(source[order], np.arange(count + 1))
    for name in np.flatnonzero(kind).tolist():
        rows = order[starts[name] : starts[name + 1]]
        error = sigma[rows]
        line = fitted(vectors[rows], error, found["mjd"][rows])
        speed[name] = line.speed
        years = (found["mjd"][rows] - line.epoch) / JULIAN_YEAR_DAYS
        at[rows] = normalised(line.mean + ARCSEC * (years[:, None] * line.speed) @ _axes(line.mean))
    return speed, at, epoch
