"""Group detections into sources: the brightest become seeds, and each other detection joins a seed it agrees with.

Two detections of different frames agree if their distance is at most `N_SIGMA` times their joint error and at most
`CAP`. The error of each is its stated error and `FLOOR` in quadrature. A detection that agrees with no brighter seed is
a seed. Every other detection joins a seed that it agrees with. The most likely pairs come first, by the Gaussian
density of the joint error, so that an uncertain seed does not take detections of a sharp one. A seed takes one
detection of each frame. The remaining detections are grouped in the same way among themselves. So there are no chains:
all detections of a source agree with its seed. The time is linear in the number of detections, at a given density.
"""

from typing import NamedTuple

import numba
import numpy as np

from csstsim.base.types import BoolArray, FloatArray, IntArray
from csstsim.measure.bricks.match import greedy_match

ARCSEC = np.pi / 180.0 / 3600.0
FLOOR = 0.010  # arcsec: residuals of the astrometry, and a slow star's motion over months
N_SIGMA = 5.0  # in two dimensions 4e-6 of the true pairs are further apart
CAP = 0.4  # arcsec: the maximum error from noise, that of a faint galaxy; detections further apart are two sources


class _Detections(NamedTuple):
    """Detections (n,): unit vectors (n, 3), sigma of each position [rad], number of each frame.

    Two of them agree if their distance is at most `n_sigma` times their joint error and at most `cap` [rad].
    """

    vectors: FloatArray
    sigma: FloatArray
    frame: IntArray
    n_sigma: float
    cap: float


class _Grid(NamedTuple):
    """Detections in the square cells of a plane.

    key (m,): cells, rising; row (m,): the detection in each; width: number of cells per line of the plane, whose
    numbers are successive; cell (n,): the cell of each detection.
    """

    key: IntArray
    row: IntArray
    width: int
    cell: IntArray


class _Pairs(NamedTuple):
    """Pairs of a detection and a seed that agree, (pairs,): row of the detection, row of the seed.

    rarity: minus twice the logarithm of the density of their joint error, up to a constant.
    """

    detection: IntArray
    seed: IntArray
    rarity: FloatArray


def associate(
    vectors: FloatArray,
    error: FloatArray,
    frame: IntArray,
    *,
    floor: float = FLOOR,
    n_sigma: float = N_SIGMA,
    cap: float = CAP,
) -> IntArray:
    """Return the source number (n,) of each detection; sources are numbered in the order of their seeds.

    Detections are in order of brightness and within a few degrees: `vectors` (n, 3) are unit vectors, `error` (n,)
    [arcsec on an axis] is finite and positive, `frame` (n,) a number (two detections of one frame are two sources).
    """
    sigma = np.hypot(error, floor) * ARCSEC
    seed_of = np.full(len(vectors), -1)
    remaining = np.arange(len(vectors))
    while len(remaining):
        detections = _Detections(vectors[remaining], sigma[remaining], frame[remaining], n_sigma, cap * ARCSEC)
        grid = _grid(vectors[remaining], cap * ARCSEC)
        is_seed = _seeds(grid, detections)
        seed_of[remaining[is_seed]] = remaining[is_seed]
        pairs = _agreeing(grid, is_seed, detections)
        accepted = _accepted(pairs, frame[remaining])
        seed_of[remaining[pairs.detection[accepted]]] = remaining[pairs.seed[accepted]]
        remaining = remaining[seed_of[remaining] < 0]
    return np.unique(seed_of, return_inverse=True)[1]


def _accepted(pairs: _Pairs, frame: IntArray) -> BoolArray:
    """Return a mask of the `pairs`, most likely first, that are accepted; a seed takes one detection of each frame."""
    _, seed_frame = np.unique(pairs.seed * (frame.max(initial=0) + 1) + frame[pairs.detection], return_inverse=True)
    return greedy_match(pairs.detection, seed_frame)


def _agreeing(grid: _Grid, is_seed: BoolArray, detections: _Detections) -> _Pairs:
    """Return all pairs that agree, the most likely first."""
    of_seed = is_seed[grid.row]
    seeds = grid._replace(key=grid.key[of_seed], row=grid.row[of_seed])
    size = _fill_pairs(seeds, is_seed, detections, _empty_pairs(0))
    pairs = _empty_pairs(size)
    _fill_pairs(seeds, is_seed, detections, pairs)
    order = np.lexsort((pairs.seed, pairs.detection, pairs.rarity))
    return _Pairs(pairs.detection[order], pairs.seed[order], pairs.rarity[order])


def _empty_pairs(size: int) -> _Pairs:
    return _Pairs(np.empty(size, np.int64), np.empty(size, np.int64), np.empty(size))


def _grid(vectors: FloatArray, size: float) -> _Grid:
    """Return the _Grid of cells `size` radians wide."""
    centre = vectors.mean(axis=0)
    axis = np.eye(3)[np.abs(centre).argmin()]
    first = np.cross(centre, axis)
    first /= np.linalg.norm(first)
    plane = np.stack([vectors @ first, vectors @ np.cross(centre / np.linalg.norm(centre), first)], axis=1)
    # Projection never lengthens distances: neighbours within `size` are in neighbouring cells
    line_column = np.floor(plane / size).astype(np.int64)
    line_column += 1 - line_column.min(axis=0)
    width = int(line_column[:, 1].max()) + 2
    cell = line_column[:, 0] * width + line_column[:, 1]
    order = np.argsort(cell, kind="stable")
    return _Grid(cell[order], order, width, cell)


@numba.njit(cache=True)
def _seeds(grid: _Grid, detections: _Detections) -> BoolArray:
    """Return a mask of the detections that agree with no seed before them."""
    frame = detections.frame
    key = grid.key
    seed = np.zeros(len(frame), np.bool_)
    for i in range(len(frame)):
        is_new = True
        for line in (-grid.width, 0, grid.width):
            middle = grid.cell[i] + line
            k = np.searchsorted(key, middle - 1)
            while is_new and k < len(key) and key[k] <= middle + 1:
                j = grid.row[k]
                if seed[j] and frame[j] != frame[i]:
                    is_new = _scaled_distance(detections, i, j) > detections.n_sigma
                k += 1
        seed[i] = is_new
    return seed


@numba.njit(cache=True)
def _fill_pairs(grid: _Grid, is_seed: BoolArray, detections: _Detections, pairs: _Pairs) -> int:
    """Write the pairs of a detection and a seed that agree, up to the length of `pairs`; return their number.

    The keys and rows of `grid` are those of the seeds alone.
    """
    frame = detections.frame
    sigma = detections.sigma
    key = grid.key
    count = 0
    for i in range(len(frame)):
        for line in (-grid.width, 0, grid.width):
            middle = grid.cell[i] + line
            k = np.searchsorted(key, middle - 1)
            while not is_seed[i] and k < len(key) and key[k] <= middle + 1:
                j = grid.row[k]
                distance = _scaled_distance(detections, i, j)
                if frame[j] != frame[i] and distance <= detections.n_sigma:
                    if count < len(pairs.seed):
                        pairs.detection[count] = i
                        pairs.seed[count] = j
                        pairs.rarity[count] = distance**2 + 2.0 * np.log(sigma[i] ** 2 + sigma[j] ** 2)
                    count += 1
                k += 1
    return count


@numba.njit(cache=True)
def _scaled_distance(detections: _Detections, i: int, j: int) -> float:
    """Return the distance of two detections in units of their joint error; infinity beyond the cap."""
    vectors = detections.vectors
    sigma = detections.sigma
    square = 0.0
    for axis in range(3):
        square += (vectors[i, axis] - vectors[j, axis]) ** 2
    if square > detections.cap**2:
        return np.inf
    return np.sqrt(square / (sigma[i] ** 2 + sigma[j] ** 2))
