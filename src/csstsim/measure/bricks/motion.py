"""Sources that move: groups of detections that are one object at constant speed are joined into one source.

`bricks.associate` joins detections at one position, so an object that moves leaves a group at each of its positions.
Two groups may be one object if no frame has detections of both, frames of each cover the position of the other, a
detection of each has S/N >= SNR_MIN, and their magnitudes agree in all bands that both have. They are joined if one
constant speed explains all their detections.

* A star moves up to STAR_SPEED_MAX arcsec a year. Its groups are joined at any interval in time. A star that moves
  little more than the error of a position leaves few groups, a faster one many.
* Anything else that moves is an object of the solar system, up to SOLAR_SPEED_MAX arcsec an hour. Its groups are single
  detections. They are linked within SOLAR_PAIR days, if their images are as wide as a trail of that speed: over hours
  the object moves by arcminutes, and too many unrelated detections lie on a line. A chain of links on a line within
  SOLAR_SPAN days is one object. So is a single link whose two ends have no other. Detection may cut a bright trail into
  pieces: of those within PIECE_RADIUS arcsec in a frame, the one with the largest Kron flux represents the trail. The
  others are members without flux and weight.

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
SNR_MIN = 10.0  # fainter sources are detected in one frame and not in another by chance
STAR_SPEED_MAX = 5.0  # arcsec / yr; about ten stars are faster
# arcsec / hour; a main-belt asteroid at opposition moves at 30
SOLAR_SPEED_MAX = 120.0
SOLAR_SPEED_MIN = 0.5
# day
SOLAR_SPAN = 0.5
SOLAR_PAIR = 0.03
# error of a detection's position: sigma, arcsec, arcsec
N_SIGMA = 5.0
FLOOR = 0.010
PARALLAX = 0.03
TRAIL_FLUX_RATIO = 1.15  # minimum ratio of Kron to PSF flux of a trail longer than TRAIL_LENGTH
TRAIL_LENGTH = 0.4  # arcsec
MAG_DIFFERENCE_MAX = 0.5  # mag, between groups in a band: most variable stars vary less
PIECE_RADIUS = 1.5  # arcsec: more than half a trail of 60 arcsec / hour in 150 s
_PAIRS_MAX = 2_000_000
_UNKNOWN_ERROR = 10.0  # arcsec: of a position without weight


class MovingSources(NamedTuple):
    """Detections (n,) as sources.

    source (n,): number, 0 to sources - 1; motion (sources,): STAR, SOLAR or 0; speed (sources, 2): arcsec / yr to the
    east and north; position (n, 3): unit vector to the source at the time of each detection, NaN for one at rest; epoch
    (sources,): MJD of the weighted mean position; is_piece (n,): a piece of a trail, which another detection of the
    frame represents.
    """

    source: IntArray
    motion: IntArray
    speed: FloatArray
    position: FloatArray
    epoch: FloatArray
    is_piece: BoolArray


class LinearMotion(NamedTuple):
    """Motion at constant speed: mean unit vector, speed (2,) [arcsec / yr], residuals (n, 2) [arcsec], mean MJD.

    Speed and residuals are to the east and north.
    """

    mean: FloatArray
    speed: FloatArray
    residual: FloatArray
    epoch: float


class _Motions(NamedTuple):
    """Fields of MovingSources that follow from the fits of their motions."""

    speed: FloatArray
    position: FloatArray
    epoch: FloatArray


def join_moving(found: ObjectTable, vectors: FloatArray, source: IntArray) -> MovingSources:
    """Return the detections with groups of one moving object joined; sources are numbered anew.

    found: ObjectTable of bricks.merge.DETECTION_COLUMNS with frame, mjd [day, NaN: not known] and exptime [s]; vectors
    (n, 3): unit vectors; source (n,): groups of bricks.associate.
    """
    source, host = _isolated(found, source)
    count = int(source.max(initial=-1)) + 1
    groups = _Groups(found, vectors, source, count)
    owner = np.arange(count)
    kind = np.zeros(count, int)
    if np.isfinite(groups.time).sum() > 1:
        for which, pairs in ((STAR, _star_pairs(groups)), (SOLAR, None)):
            pairs = _solar_pairs(groups, kind[owner] == 0) if pairs is None else pairs
            _join(groups, owner, kind, pairs, which)
    is_piece = np.zeros(count, bool)
    for brighter, fainter in groups.pieces:
        if kind[owner[brighter]] == SOLAR and kind[owner[fainter]] == 0:
            owner[fainter] = owner[brighter]
            is_piece[fainter] = True
    is_piece = is_piece[source]
    faint_groups = np.arange(count - len(host), count)
    returning = kind[owner[host]] == 0
    owner[faint_groups[returning]] = owner[host[returning]]
    owners, source = np.unique(owner[source], return_inverse=True)
    motion = kind[owners]
    motions = _motions(found, vectors, source, motion, is_piece)
    return MovingSources(source, motion, *motions, is_piece)


def _isolated(found: ObjectTable, source: IntArray) -> tuple[IntArray, IntArray]:
    """Return (source, host): the faint detections in a group with one bright detection become groups of their own.

    They may be there by chance. source (n,): their groups are numbered after all others; host (m,): the group that each
    of them came from, to which it returns if that group does not move.
    """
    count = int(source.max(initial=-1)) + 1
    bright = found["snr"] >= SNR_FAINT
    top = np.zeros(count)
    np.maximum.at(top, source, found["snr"])
    lonely = (np.bincount(source, bright, count) == 1) & (top >= SNR_MIN)
    rows = np.flatnonzero(lonely[source] & ~bright)
    host = source[rows]
    source = source.copy()
    source[rows] = count + np.arange(len(rows))
    return source, host


class _Groups:
    """Groups of detections: positions, times, frames, fluxes."""

    def __init__(self, found: ObjectTable, vectors: FloatArray, source: IntArray, count: int) -> None:
        self.found = found
        self.vectors = vectors
        self.source = source
        self.order = np.argsort(source, kind="stable")
        self.starts = np.searchsorted(source[self.order], np.arange(count + 1))
        weight = np.hypot(found["pos_err"], FLOOR) ** -2.0
        total = np.bincount(source, weight, count)
        mean = np.stack([np.bincount(source, weight * vectors[:, k], count) for k in range(3)], axis=1)
        self.position = normalised(mean / np.maximum(total, 1e-300)[:, None]) if count else mean
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

    def pairs(self, groups: IntArray, distance: float) -> tuple[IntArray, IntArray]:
        """Return the pairs (a, b) of `groups` within a distance [arcsec] and without a common frame."""
        tree = cKDTree(self.position[groups])
        candidates = tree.query_pairs(distance * ARCSEC, output_type="ndarray")
        if len(candidates) > _PAIRS_MAX:  # a crowded field: the closest pairs
            first, second = self.position[groups][candidates.T]
            separation = np.linalg.norm(first - second, axis=1)
            candidates = candidates[np.argsort(separation, kind="stable")[:_PAIRS_MAX]]
        a = groups[candidates[:, 0]]
        b = groups[candidates[:, 1]]
        separate = ((self.bits[a] & self.bits[b]) == 0).all(axis=1)
        return a[separate], b[separate]

    def may_be_one(self, a: int, b: int) -> bool:
        """Whether magnitudes of two groups agree and frames of each cover the position of the other."""
        return self.magnitudes_agree(a, b) and self.covers(a, b) and self.covers(b, a)

    def magnitudes_agree(self, a: int, b: int) -> bool:
        """Whether two groups have magnitudes that agree in every band that both have."""
        one = self.rows(a)
        other = self.rows(b)
        for band in np.intersect1d(self.band[one], self.band[other]):
            mags = [_median(self.mag[rows[self.band[rows] == band]]) for rows in (one, other)]
            if not abs(mags[0] - mags[1]) < MAG_DIFFERENCE_MAX:
                return False
        return True

    def covers(self, a: int, b: int) -> bool:
        """Whether a frame of group a covers the position of group b."""
        return any(self._covers(number, self.position[b]) for number in np.unique(self.number[self.rows(a)]))

    def _covers(self, number: int, position: FloatArray) -> bool:
        if number not in self._hulls:
            self._hulls[number] = _hull(self.vectors[self.number == number])
        hull = self._hulls[number]
        if hull is None:
            return False
        equations, axes = hull
        return bool((equations[:, :2] @ (axes @ position) + equations[:, 2] <= 1.0 * ARCSEC).all())


def _median(mags: FloatArray) -> float:
    """Return the median of the magnitudes that are not NaN; NaN if all are (no flux above zero)."""
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
    """Return the pairs (m, 2) of groups that may be a star, the closest in position first."""
    bright = np.flatnonzero((groups.snr >= SNR_MIN) & np.isfinite(groups.time))
    if len(bright) < 2:
        return np.zeros((0, 2), int)
    years = np.ptp(groups.time[bright]) / JULIAN_YEAR_DAYS
    a, b = groups.pairs(bright, STAR_SPEED_MAX * years + 2 * PARALLAX)
    distance = np.linalg.norm(groups.position[a] - groups.position[b], axis=1) / ARCSEC
    good = distance <= STAR_SPEED_MAX * np.abs(groups.time[a] - groups.time[b]) / JULIAN_YEAR_DAYS + 2 * PARALLAX
    order = np.lexsort((b[good], a[good], distance[good]))
    return np.stack([a[good][order], b[good][order]], axis=1)


def _solar_pairs(groups: _Groups, free: BoolArray) -> IntArray:
    """Return the pairs (m, 2) of single detections that may be an object of the solar system, closest in time first."""
    single: IntArray = np.flatnonzero(free & (groups.size == 1) & (groups.snr >= SNR_MIN) & np.isfinite(groups.time))
    single = _without_pieces(groups, single)
    if len(single) < 2:
        return np.zeros((0, 2), int)
    a, b = groups.pairs(single, SOLAR_SPEED_MAX * 24 * SOLAR_PAIR)
    hours = 24 * np.abs(groups.time[a] - groups.time[b])
    distance = np.linalg.norm(groups.position[a] - groups.position[b], axis=1) / ARCSEC
    with np.errstate(divide="ignore", invalid="ignore"):
        speed = distance / hours
    good = (hours > 0) & (hours <= 24 * SOLAR_PAIR) & (speed <= SOLAR_SPEED_MAX) & (speed >= SOLAR_SPEED_MIN)
    good &= _wide_enough(groups, a, speed) & _wide_enough(groups, b, speed)
    order = np.lexsort((b[good], a[good], distance[good], hours[good]))
    return np.stack([a[good][order], b[good][order]], axis=1)


def _without_pieces(groups: _Groups, single: IntArray) -> IntArray:
    """Return the `single` detections without the pieces of trails that another one represents.

    `groups.pieces` gets the pairs (brighter, fainter).
    """
    if len(single) < 2:
        return single
    rows = groups.order[groups.starts[single]]
    flux = np.nan_to_num(groups.found["flux_kron"][rows])
    number = groups.number[rows]
    pairs = cKDTree(groups.position[single]).query_pairs(PIECE_RADIUS * ARCSEC, output_type="ndarray")
    pairs = pairs[number[pairs[:, 0]] == number[pairs[:, 1]]]
    first = np.where(flux[pairs[:, 0]] >= flux[pairs[:, 1]], pairs[:, 0], pairs[:, 1])
    order = np.lexsort((pairs.sum(axis=1) - first, -flux[first]))
    is_piece = np.zeros(len(single), bool)
    for brighter, fainter in zip(first[order].tolist(), (pairs.sum(axis=1) - first)[order].tolist(), strict=True):
        if not is_piece[brighter] and not is_piece[fainter]:
            is_piece[fainter] = True
            groups.pieces.append((single[brighter], single[fainter]))
    return single[~is_piece]


def _wide_enough(groups: _Groups, group: IntArray, speed: FloatArray) -> BoolArray:
    """Whether the images of single detections are wide enough for a speed [arcsec / hour], (m,) bool."""
    rows = groups.order[groups.starts[group]]
    found = groups.found
    with np.errstate(divide="ignore", invalid="ignore"):
        wide = found["flux_kron"][rows] / found["flux_psf"][rows] >= TRAIL_FLUX_RATIO
    return wide | ~(speed * found["exptime"][rows] / 3600.0 > TRAIL_LENGTH)


def _join(groups: _Groups, owner: IntArray, kind: IntArray, pairs: IntArray, motion: int) -> None:
    """Join pairs of groups (m, 2), one after the other, if one speed explains all of both; changes owner and kind."""
    good = [(a, b) for a, b in pairs.tolist() if groups.may_be_one(a, b)]
    partners = np.bincount(np.array(good, int).ravel(), minlength=len(owner)) if good else np.zeros(len(owner), int)
    members: dict[int, list[int]] = {}
    for a, b in good:
        first_owner = owner[a]
        second_owner = owner[b]
        if first_owner == second_owner:
            continue
        joined = members.get(first_owner, [first_owner]) + members.get(second_owner, [second_owner])
        bits = [np.bitwise_or.reduce(groups.bits[members.get(g, [g])], axis=0) for g in (first_owner, second_owner)]
        if (bits[0] & bits[1]).any() or not _on_one_line(groups, joined, motion):
            continue
        keep = min(first_owner, second_owner)
        dropped = max(first_owner, second_owner)
        members[keep] = sorted(joined)
        members.pop(dropped, None)
        owner[np.isin(owner, (first_owner, second_owner))] = keep
        kind[keep] = motion
        kind[dropped] = 0
    if motion != SOLAR:
        return
    for owner_of_two, joined in members.items():  # two detections alone make a line of any two
        if kind[owner_of_two] == SOLAR and len(joined) == 2 and partners[joined].max() > 1:
            owner[joined] = joined
            kind[owner_of_two] = 0


def _on_one_line(groups: _Groups, members: Sequence[int], motion: int) -> bool:
    """Whether all detections of groups lie on one line at constant speed, within their errors and the maximum speed."""
    rows = groups.rows(members)
    found = groups.found
    time = found["mjd"][rows]
    error = np.hypot(found["pos_err"][rows], FLOOR)
    if motion == SOLAR and np.ptp(time) > SOLAR_SPAN:
        return False
    line = fit_motion(groups.vectors[rows], error, time)
    speed_max = STAR_SPEED_MAX if motion == STAR else SOLAR_SPEED_MAX * 24 * JULIAN_YEAR_DAYS
    # A piece that represents a trail is off its middle
    trail = np.hypot(*line.speed) / (24 * JULIAN_YEAR_DAYS) * np.nanmax(found["exptime"][rows]) / 3600.0
    tolerance = N_SIGMA * error + (PARALLAX if motion == STAR else 0.05 + 0.3 * trail)
    return bool(np.hypot(*line.speed) <= speed_max and (np.hypot(*line.residual.T) <= tolerance).all())


def fit_motion(vectors: FloatArray, error: FloatArray, time: FloatArray) -> LinearMotion:
    """Return the Line through positions (n, 3), unit vectors; error (n,): arcsec on an axis; time (n,): MJD."""
    weight = error**-2.0
    weight = weight / weight.sum()
    mean = normalised(weight @ vectors)
    epoch = float(weight @ time)
    plane = (vectors @ _axes(mean).T) / ARCSEC
    years = (time - epoch) / JULIAN_YEAR_DAYS
    spread = float(weight @ years**2)
    speed = (weight * years) @ plane / spread if spread > 0 else np.zeros(2)
    return LinearMotion(mean, speed, plane - weight @ plane - years[:, None] * speed, epoch)


def _motions(
    found: ObjectTable, vectors: FloatArray, source: IntArray, motion: IntArray, is_piece: BoolArray
) -> _Motions:
    """Return the _Motions of `join_moving`; sources at rest have speed 0."""
    count = len(motion)
    sigma = np.where(is_piece, _UNKNOWN_ERROR, np.hypot(found["pos_err"], FLOOR))
    weight = sigma**-2.0
    total = np.maximum(np.bincount(source, weight, count), 1e-300)
    epoch = np.bincount(source, weight * found["mjd"], count) / total
    speed = np.zeros((count, 2))
    position = np.full((len(source), 3), np.nan)
    order = np.argsort(source, kind="stable")
    starts = np.searchsorted(source[order], np.arange(count + 1))
    for number in np.flatnonzero(motion).tolist():
        rows = order[starts[number] : starts[number + 1]]
        error = sigma[rows]
        line = fit_motion(vectors[rows], error, found["mjd"][rows])
        speed[number] = line.speed
        years = (found["mjd"][rows] - line.epoch) / JULIAN_YEAR_DAYS
        position[rows] = normalised(line.mean + ARCSEC * (years[:, None] * line.speed) @ _axes(line.mean))
    return _Motions(speed, position, epoch)
