"""Sources that no single frame shows: peaks of the chi2 of all bands and visits in a brick (Szalay et al. 1999).

In each frame the models of the sources that were measured are subtracted (measure.detection.residual). What is left is
smoothed as for the detection in one frame, which gives the S/N of a point at each pixel. On a grid over the brick, the
S/N of a band's visits add with the weights of their depths, because the flux is the same. Bands do not, because the
colour is not known: the sum of squares of the positive S/N is the chi2 of a source of any colour. Noise exceeds the
threshold with the probability FALSE_ALARM at each pixel, whatever the number of bands is.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numba
import numpy as np

from csstsim.base.healpix import NSIDE, brick_corners, pixel_centre
from csstsim.base.sphere import ra_dec, unit_vectors
from csstsim.base.types import FloatArray, IntArray
from csstsim.measure.bricks.joint_frame import JointFrame
from csstsim.measure.detection.maps import add_interpolated
from csstsim.measure.detection.peaks import smoothed_snr
from csstsim.measure.detection.residual import BLANK, values

FALSE_ALARM = 2.87e-7  # probability of a pixel, that of 5 sigma: a peak of noise in some 30 square arc minutes
BORDER_POINTS = 8  # of a side of a brick, which is curved
REST_FALSE_ALARM = 1e-3  # the same, of all frames but the best: a cosmic ray or a track is in one frame only
KNOWN_MIN = 0.75  # fraction of the frames in which the pixel must be known: cores of bright sources are not
POSITION_FACTOR = 3.0  # position error times S/N, over the sigma of the PSF: sqrt(2) of a point; galaxies are wider
SKY_BLOCK = 32  # px
TILE = 1024  # px of the grid
NODES = 64  # px between the positions that are computed; between them they are interpolated


class JointPeaks(NamedTuple):
    """Peaks (n,): position [deg], its error on an axis [arcsec], and chi2."""

    ra: FloatArray
    dec: FloatArray
    pos_err: FloatArray
    chi2: FloatArray


class _Band(NamedTuple):
    """Sums over a band's frames on a tile: S/N times depth, squares of depths."""

    total: FloatArray
    weight: FloatArray


class _Frames(NamedTuple):
    """Sums over all frames on a tile.

    `covering`: frames that contain the pixel; `known`: those in which it is known; `squares`: of their positive S/N;
    `largest`: the largest of these.
    """

    covering: IntArray
    known: IntArray
    squares: FloatArray
    largest: FloatArray


@dataclass(frozen=True)
class Grid:
    """Square pixels of `pixel` rad on the plane that touches the sphere at the centre of a brick."""

    centre: FloatArray
    east: FloatArray
    north: FloatArray
    pixel: float

    @classmethod
    def of(cls, pix: int, pixel: float) -> Grid:
        """Return the Grid of a brick."""
        centre = unit_vectors(*pixel_centre(NSIDE, pix))
        axis = np.eye(3)[np.abs(centre).argmin()]
        east = np.cross(axis, centre)
        east /= np.linalg.norm(east)
        return cls(centre, east, np.cross(centre, east), pixel)

    def sky(self, u: FloatArray, v: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return ra, dec [deg] of positions [px]."""
        u, v = (np.asarray(one, float)[..., None] * self.pixel for one in (u, v))
        return ra_dec(self.centre + u * self.east + v * self.north)

    def plane(self, ra: FloatArray, dec: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return u, v [px] of positions [deg]."""
        vectors = unit_vectors(ra, dec)
        scale = 1.0 / (vectors @ self.centre) / self.pixel
        return vectors @ self.east * scale, vectors @ self.north * scale


def thresholds(number: int, probability: float) -> FloatArray:
    """Return (number + 1,): the sum of squares of 0, 1, ... positive S/N that noise exceeds with a probability."""
    from scipy.optimize import brentq
    from scipy.special import comb, gammaincc

    def excess(chi2: float, n: int) -> float:
        k = np.arange(1, n + 1)
        return float((comb(n, k) / 2.0**n * gammaincc(k / 2.0, chi2 / 2.0)).sum()) / probability - 1.0

    return np.array([0.0, *(brentq(excess, 1e-9, 200.0 + 2.0 * n, args=(n,)) for n in range(1, number + 1))])


def joint_peaks(pix: int, frames: Sequence[JointFrame]) -> JointPeaks:
    """Return the JointPeaks of a brick on which there is at least one frame, and those beside it on the grid."""
    pixel = frames[0].pixel
    grid = Grid.of(pix, math.radians(pixel / 3600.0))
    u, v = grid.plane(*brick_corners(pix, BORDER_POINTS))
    step = TILE // NODES
    first = [math.floor(one.min() / TILE) * TILE for one in (u, v)]
    count = [math.ceil((one.max() - low) / TILE) for one, low in zip((u, v), first, strict=True)]
    nodes = [low - 1 + NODES * np.arange(n * step + 2) for low, n in zip(first, count, strict=True)]
    sky = grid.sky(*np.meshgrid(*nodes))
    places = [np.stack(frame.to_pixel(*(one.ravel() for one in sky))).reshape(2, *sky[0].shape) for frame in frames]
    limits = thresholds(len({frame.band for frame in frames}), FALSE_ALARM)
    rest = thresholds(len(frames), REST_FALSE_ALARM)
    parts: list[list[FloatArray]] = [[np.zeros(0)] * 3]
    for j in range(count[1]):
        for i in range(count[0]):
            part = slice(j * step, (j + 1) * step + 2), slice(i * step, (i + 1) * step + 2)
            on_tile = [
                (frame, place[:, *part])
                for frame, place in zip(frames, places, strict=True)
                if _part_of(frame, place[:, *part]) is not None
            ]
            if not on_tile:
                continue
            chi2, bands, of_frames = _tile(on_tile)
            at = _peaks(chi2, limits.astype(np.float32)[bands])
            y, x = _tops(chi2, *at)
            known = of_frames.known[at]
            others = of_frames.squares[at] - of_frames.largest[at]
            good = (others > rest[known - 1]) & (known >= KNOWN_MIN * of_frames.covering[at])
            columns = x + (first[0] - 1 + i * TILE), y + (first[1] - 1 + j * TILE), chi2[at]
            parts.append([column[good] for column in columns])
    u, v, chi2 = (np.concatenate(column) for column in zip(*parts, strict=True))
    ra, dec = grid.sky(u, v)
    width = pixel * float(np.median([frame.width for frame in frames]))
    return JointPeaks(ra, dec, POSITION_FACTOR * width / np.sqrt(chi2), chi2)


def _tile(frames: Sequence[tuple[JointFrame, FloatArray]]) -> tuple[FloatArray, IntArray, _Frames]:
    """Return (chi2, number of bands, sums of the frames) on a tile; frames: with the positions of its nodes."""
    shape = TILE + 2, TILE + 2
    chi2 = np.zeros(shape, np.float32)
    bands = np.zeros(shape, np.int8)
    of_frames = _Frames(*(np.zeros(shape, kind) for kind in (np.int16, np.int16, np.float32, np.float32)))
    for band in dict.fromkeys(frame.band for frame, _ in frames):
        of_band = _Band(np.zeros(shape, np.float32), np.zeros(shape, np.float32))
        for frame, place in frames:
            if frame.band == band:
                _add(frame, place, of_band, of_frames)
        _add_chi2(chi2, bands, of_band)
    return chi2, bands, of_frames


def _add(frame: JointFrame, place: FloatArray, of_band: _Band, of_frames: _Frames) -> None:
    """Add a frame to the sums of a tile; place (2, n, n): x, y of the tile's nodes on it [px]."""
    x, y = place
    part = _part_of(frame, place)
    assert part is not None
    rows, columns = part
    steps = np.ascontiguousarray(frame.residual.steps[part])
    image = values(steps)
    _subtract_sky(image, steps)
    snr = smoothed_snr(image, np.ones_like(image), frame.weight)
    _add_frame(of_band, of_frames, snr, steps, x - columns.start, y - rows.start, 1.0 / frame.error)


def _part_of(frame: JointFrame, place: FloatArray) -> tuple[slice, slice] | None:
    """Return the rows and columns of a frame, in whole blocks, that a tile needs; None if it is beside the frame."""
    ny, nx = frame.residual.steps.shape
    parts = []
    for position, size in zip(place[::-1], (ny, nx), strict=True):
        low = SKY_BLOCK * (math.floor(position.min()) // SKY_BLOCK - 1)
        high = SKY_BLOCK * (math.ceil(position.max()) // SKY_BLOCK + 2)
        parts.append(slice(max(low, 0), min(high, size)))
    rows, columns = parts
    return (rows, columns) if rows.start < rows.stop and columns.start < columns.stop else None


def _subtract_sky(image: FloatArray, steps: IntArray) -> None:
    """Subtract the mean of blocks of SKY_BLOCK px in place: wings of stars outside the frame are left in it."""
    rows, columns = (np.arange(0, size, SKY_BLOCK) for size in image.shape)
    total, known = (
        np.add.reduceat(np.add.reduceat(plane, rows, axis=0, dtype=np.float32), columns, axis=1)
        for plane in (image, steps != BLANK)
    )
    middle = [
        0.5 * (start + np.minimum(start + SKY_BLOCK, size) - 1)
        for start, size in zip((rows, columns), image.shape, strict=True)
    ]
    add_interpolated(image, total / np.maximum(known, 1.0), middle, -1.0)


@numba.njit(cache=True)
def _add_frame(
    of_band: _Band, of_frames: _Frames, snr: FloatArray, steps: IntArray, x: FloatArray, y: FloatArray, depth: float
) -> None:
    """Add a frame to the sums; x, y: positions in `snr` of every NODES-th pixel of the tile."""
    ny, nx = snr.shape
    for v in range(of_band.total.shape[0]):
        j = v // NODES
        q = (v - j * NODES) / NODES
        for u in range(of_band.total.shape[1]):
            i = u // NODES
            p = (u - i * NODES) / NODES
            px = (1 - q) * ((1 - p) * x[j, i] + p * x[j, i + 1]) + q * ((1 - p) * x[j + 1, i] + p * x[j + 1, i + 1])
            py = (1 - q) * ((1 - p) * y[j, i] + p * y[j, i + 1]) + q * ((1 - p) * y[j + 1, i] + p * y[j + 1, i + 1])
            if not (0.0 <= px < nx - 1 and 0.0 <= py < ny - 1):
                continue
            of_frames.covering[v, u] += 1
            if steps[round(py), round(px)] == BLANK:
                continue
            of_frames.known[v, u] += 1
            a = int(px)
            b = int(py)
            s = px - a
            t = py - b
            below = (1 - s) * snr[b, a] + s * snr[b, a + 1]
            above = (1 - s) * snr[b + 1, a] + s * snr[b + 1, a + 1]
            value = np.float32((1 - t) * below + t * above)
            of_band.total[v, u] += np.float32(depth) * value
            of_band.weight[v, u] += np.float32(depth) ** 2
            if value > 0:
                of_frames.squares[v, u] += value * value
                of_frames.largest[v, u] = max(of_frames.largest[v, u], value * value)


@numba.njit(cache=True)
def _add_chi2(chi2: FloatArray, bands: IntArray, of_band: _Band) -> None:
    """Add a band to the chi2 and to the number of bands."""
    for v in range(chi2.shape[0]):
        for u in range(chi2.shape[1]):
            weight = of_band.weight[v, u]
            if weight > 0:
                bands[v, u] += 1
                chi2[v, u] += max(of_band.total[v, u], np.float32(0)) ** 2 / weight


def _peaks(chi2: FloatArray, limit: FloatArray) -> tuple[IntArray, IntArray]:
    """Return y, x of the pixels above the limit that exceed their neighbours, without those at the tile's edges."""
    from scipy.ndimage import maximum_filter

    top = (chi2 > np.where(limit > 0, limit, np.inf)) & (chi2 == maximum_filter(chi2, 3))
    top[[0, -1]] = top[:, [0, -1]] = False
    y, x = np.nonzero(top)
    return y, x


def _tops(chi2: FloatArray, y: IntArray, x: IntArray) -> tuple[FloatArray, FloatArray]:
    """Return y, x of the tops of peaks, from parabolas through the pixels beside them."""
    middle = chi2[y, x]
    return (
        y + _vertex(chi2[y - 1, x], middle, chi2[y + 1, x]),
        x + _vertex(chi2[y, x - 1], middle, chi2[y, x + 1]),
    )


def _vertex(before: FloatArray, middle: FloatArray, after: FloatArray) -> FloatArray:
    """Return the position, within half a pixel, of the top of a parabola through a peak and its neighbours."""
    curvature = np.minimum(before - 2.0 * middle + after, -1e-6 * middle)
    return np.clip(0.5 * (before - after) / curvature, -0.5, 0.5)
