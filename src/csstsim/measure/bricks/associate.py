"""Group detections into sources: the brightest become seeds, and each other detection joins a seed it agrees with.

Two detections of different frames agree if they lie within `N_SIGMA` times their joint error, and at most `CAP` apart.
The error of each is its stated error and `FLOOR` in quadrature. A detection that agrees with no brighter seed is a
seed. Every other one joins a seed it agrees with. The likeliest pairs come first, by the Gaussian density of the joint
error, so that an uncertain seed does not take detections of a sharp one. A seed takes one detection of each frame;
detections that are left over are grouped in the same way among themselves. So there are no chains: all detections of a
source agree with its seed. The work is linear in the number of detections, at a given density.
"""

from typing import NamedTuple

import numba
import numpy as np

from csstsim.base.types import BoolArray, FloatArray, IntArray
from csstsim.measure.bricks.match import share_out

ARCSEC = np.pi / 180.0 / 3600.0
FLOOR = 0.010  # arcsec: residuals of the astrometry, and a slow star's motion over months
N_SIGMA = 5.0  # in two dimensions 4e-6 of the true pairs are further apart
CAP = 0.4  # arcsec: the largest error that noise gives a faint galaxy; beyond lies another source


class _Detections(NamedTuple):
    """Detections, one row each (n,): vectors (n, 3), sigma of a position [rad], frame; when two of them agree.

    They do within `n_sigma` times their joint error, and at most `cap` [rad] apart.
    """

    vectors: FloatArray
    sigma: FloatArray
    frame: IntArray
    n_sigma: float
    cap: float


class _Grid(NamedTuple):
    """Detections by the square cells of a plane: `cell` (n,) of each; keys (m,), rising, and their rows of detections.

    The cells of a line have successive numbers; `width` is the number of cells per line.
    """

    key: IntArray
    row: IntArray
    width: int
    cell: IntArray


class _Pairs(NamedTuple):
    """Detections and the seeds they agree with, each (pairs,), as rows.

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
    left = np.arange(len(vectors))
    while len(left):
        detections = _Detections(vectors[left], sigma[left], frame[left], n_sigma, cap * ARCSEC)
        grid = _grid(vectors[left], cap * ARCSEC)
        is_seed = _seeds(grid, detections)
        seed_of[left[is_seed]] = left[is_seed]
        pairs = _agreeing(grid, is_seed, detections)
        taken = _share_out(pairs, frame[left])
        seed_of[left[pairs.detection[taken]]] = left[pairs.seed[taken]]
        left = left[seed_of[left] < 0]
    return np.unique(seed_of, return_inverse=True)[1]


def _share_out(pairs: _Pairs, frame: IntArray) -> BoolArray:
    """Return a mask of the `pairs`, likeliest first, that are taken; a seed takes one detection of each frame."""
    _, slot = np.unique(pairs.seed * (frame.max(initial=0) + 1) + frame[pairs.detection], return_inverse=True)
    return share_out(pairs.detection, slot)


def _agreeing(grid: _Grid, is_seed: BoolArray, detections: _Detections) -> _Pairs:
    """Return all pairs that agree, likeliest first."""
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
        alone = True
        for line in (-grid.width, 0, grid.width):
            middle = grid.cell[i] + line
            start = np.searchsorted(key, middle - 1)
            while alone and start < len(key) and key[start] <= middle + 1:
                j = grid.row[start]
                if seed[j] and frame[j] != frame[i]:
                    alone = _apart(detections, i, j) > detections.n_sigma
                start += 1
        seed[i] = alone
    return seed


@numba.njit(cache=True)
def _fill_pairs(grid: _Grid, is_seed: BoolArray, detections: _Detections, pairs: _Pairs) -> int:
    """Write the pairs of a detection and a seed that agree, as far as `pairs` has room; return how many there are.

    The keys and rows of `grid` are those of the seeds alone.
    """
    frame = detections.frame
    sigma = detections.sigma
    key = grid.key
    count = 0
    for i in range(len(frame)):
        for line in (-grid.width, 0, grid.width):
            middle = grid.cell[i] + line
            start = np.searchsorted(key, middle - 1)
            while not is_seed[i] and start < len(key) and key[start] <= middle + 1:
                j = grid.row[start]
                distance = _apart(detections, i, j)
                if frame[j] != frame[i] and distance <= detections.n_sigma:
                    if count < len(pairs.seed):
                        pairs.detection[count] = i
                        pairs.seed[count] = j
                        pairs.rarity[count] = distance**2 + 2.0 * np.log(sigma[i] ** 2 + sigma[j] ** 2)
                    count += 1
                start += 1
    return count


@numba.njit(cache=True)
def _apart(detections: _Detections, i: int, j: int) -> float:
    """Return the distance of two detections in units of their joint error; infinite beyond the cap."""
    vectors = detections.vectors
    sigma = detections.sigma
    square = 0.0
    for axis in range(3):
        square += (vectors[i, axis] - vectors[j, axis]) ** 2
    if square > detections.cap**2:
        return np.inf
    return np.sqrt(square / (sigma[i] ** 2 + sigma[j] ** 2))
