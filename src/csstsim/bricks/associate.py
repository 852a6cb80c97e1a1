"""Group detections into sources: the brightest become seeds, and each other detection joins a seed it agrees with.

Two detections of different frames agree if they lie within `N_SIGMA` times their joint error, and at most `CAP` apart.
The error of each is its stated error and `FLOOR` in quadrature. A detection that agrees with no brighter seed is a
seed. Every other one joins a seed it agrees with. The likeliest pairs come first, by the Gaussian density of the joint
error, so that an uncertain seed does not take detections of a sharp one. A seed takes one detection of each frame;
detections that are left over are grouped in the same way among themselves. So there are no chains: all detections of a
source agree with its seed. The work is linear in the number of detections, at a given density.
"""

from typing import TypeAlias

import numba
import numpy as np

from csstsim.base.types import BoolArray, FloatArray, IntArray
from csstsim.bricks.match import share_out

ARCSEC = np.pi / 180.0 / 3600.0
FLOOR = 0.010  # arcsec: residuals of the astrometry, and a slow star's motion over months
N_SIGMA = 5.0  # in two dimensions 4e-6 of the true pairs are further apart
CAP = 0.4  # arcsec: the largest error that noise gives a faint galaxy; beyond lies another source
Place: TypeAlias = tuple[FloatArray, FloatArray, IntArray, float, float]  # unit vectors, sigma, frame; n_sigma, cap


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
        place: Place = vectors[left], sigma[left], frame[left], n_sigma, cap * ARCSEC
        grid = _grid(vectors[left], cap * ARCSEC)
        seed = _seeds(*grid + place)
        seed_of[left[seed]] = left[seed]
        pair = _agreeing(*grid, seed, place)
        taken, by = _share_out(pair, frame[left])
        seed_of[left[taken]] = left[by]
        left = left[seed_of[left] < 0]
    return np.unique(seed_of, return_inverse=True)[1]


def _share_out(pair: tuple[IntArray, IntArray], frame: IntArray) -> tuple[IntArray, IntArray]:
    """Return (detections, seeds) of the pairs that are taken, likeliest first; a seed takes one of each frame."""
    detection, seed = pair
    _, slot = np.unique(seed * (frame.max(initial=0) + 1) + frame[detection], return_inverse=True)
    taken = share_out(detection, slot)
    return detection[taken], seed[taken]


def _agreeing(
    key: IntArray, order: IntArray, width: int, cell: IntArray, seed: BoolArray, place: Place
) -> tuple[IntArray, IntArray]:
    """Return (detections, seeds) of all pairs that agree, likeliest first."""
    of_seed = seed[order]
    grid = key[of_seed], order[of_seed], width, cell
    size = _pairs(*(*grid, seed, *place, *_room(0)))
    detections, seeds, rarity = pairs = _room(size)
    _pairs(*(*grid, seed, *place, *pairs))
    order = np.lexsort((seeds, detections, rarity))
    return detections[order], seeds[order]


def _room(size: int) -> tuple[IntArray, IntArray, FloatArray]:
    return np.empty(size, np.int64), np.empty(size, np.int64), np.empty(size)


def _grid(vectors: FloatArray, size: float) -> tuple[IntArray, IntArray, int, IntArray]:
    """Return (sorted keys, their detections, cells per line, cell of each) of a grid of cells `size` radians wide."""
    centre = vectors.mean(axis=0)
    axis = np.eye(3)[np.abs(centre).argmin()]
    first = np.cross(centre, axis)
    first /= np.linalg.norm(first)
    plane = np.stack([vectors @ first, vectors @ np.cross(centre / np.linalg.norm(centre), first)], axis=1)
    # Projection never lengthens distances: neighbours within `size` are in neighbouring cells
    cell = np.floor(plane / size).astype(np.int64)
    cell += 1 - cell.min(axis=0)
    width = int(cell[:, 1].max()) + 2
    cell = cell[:, 0] * width + cell[:, 1]
    order = np.argsort(cell, kind="stable")
    return cell[order], order, width, cell


@numba.njit(cache=True)
def _seeds(
    key: IntArray,
    order: IntArray,
    width: int,
    cell: IntArray,
    vectors: FloatArray,
    sigma: FloatArray,
    frame: IntArray,
    n_sigma: float,
    cap: float,
) -> BoolArray:
    """Return a mask of the detections that agree with no seed before them."""
    seed = np.zeros(len(vectors), np.bool_)
    for i in range(len(vectors)):
        alone = True
        for line in (-width, 0, width):
            start = np.searchsorted(key, cell[i] + line - 1)
            while alone and start < len(key) and key[start] <= cell[i] + line + 1:
                j = order[start]
                if seed[j] and frame[j] != frame[i]:
                    alone = _apart(vectors, sigma, i, j, cap) > n_sigma
                start += 1
        seed[i] = alone
    return seed


@numba.njit(cache=True)
def _pairs(
    key: IntArray,
    order: IntArray,
    width: int,
    cell: IntArray,
    seed: BoolArray,
    vectors: FloatArray,
    sigma: FloatArray,
    frame: IntArray,
    n_sigma: float,
    cap: float,
    detections: IntArray,
    seeds: IntArray,
    rarity: FloatArray,
) -> int:
    """Write the pairs of a detection and a seed that agree, as far as the arrays have room; return how many there are.

    `rarity`: minus twice the logarithm of the density of their joint error, up to a constant.
    """
    count = 0
    for i in range(len(vectors)):
        for line in (-width, 0, width):
            start = np.searchsorted(key, cell[i] + line - 1)
            while not seed[i] and start < len(key) and key[start] <= cell[i] + line + 1:
                j = order[start]
                distance = _apart(vectors, sigma, i, j, cap)
                if frame[j] != frame[i] and distance <= n_sigma:
                    if count < len(seeds):
                        detections[count] = i
                        seeds[count] = j
                        rarity[count] = distance**2 + 2.0 * np.log(sigma[i] ** 2 + sigma[j] ** 2)
                    count += 1
                start += 1
    return count


@numba.njit(cache=True)
def _apart(vectors: FloatArray, sigma: FloatArray, i: int, j: int, cap: float) -> float:
    """Return the distance of two detections in units of their joint error; infinite beyond the cap."""
    square = 0.0
    for axis in range(3):
        square += (vectors[i, axis] - vectors[j, axis]) ** 2
    if square > cap**2:
        return np.inf
    return np.sqrt(square / (sigma[i] ** 2 + sigma[j] ** 2))
