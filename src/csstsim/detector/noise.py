"""Shot noise and readout noise in pixels (paper, Appendix B, items 5 and 13).

The random numbers depend on the key and the pixel (csstsim.detector.random), not on the frame's height, the
order of work or the number of threads. Pixels are counted from the frame's corner, so a window has other numbers than
the same pixels of the whole frame.
"""

import numba
import numpy as np

from csstsim.base.types import FloatArray, IntArray
from csstsim.detector.random.normal import normal_row, normal_table
from csstsim.detector.random.poisson import alias_tables, poisson_row
from csstsim.detector.sparse_plane import SparsePlane

MEAN_MAX = 1e9  # electrons: up to this mean, counts are drawn as 32-bit integers


def add_poisson(
    image: FloatArray, key: np.uint64, *, dark: float = 0.0, counted: IntArray | SparsePlane | None = None
) -> None:
    """Replace expected electrons by counted ones, in place: image = counted + Poisson(image + dark).

    `image`: float32 (ny, nx); `dark`: electrons (scalar); `counted`: int32 of the same shape, or a SparsePlane, which
    already have Poisson noise, or None; `key`: uint64 (rng.Streams.exposure_key). For a mean m above M = MEAN_MAX the
    result is m + (n - M) sqrt(m / M), n Poisson of mean M. Raises ValueError, before any draw, if an expected
    value is negative or not finite.
    """
    invalid, above_max = _count_invalid(image, np.float32(dark))
    if invalid:
        raise ValueError(f"the expected electrons of {invalid} pixel(s) are negative or not finite")
    if above_max and isinstance(counted, SparsePlane):
        counted = counted.dense()
    none = np.zeros(0, np.int32)
    pixel, electrons = (counted.pixel, counted.electrons) if isinstance(counted, SparsePlane) else (none, none)
    counted = counted if isinstance(counted, np.ndarray) else none.reshape(0, 0)
    bright = np.nonzero(image + np.float32(dark) > MEAN_MAX) if above_max else ()
    means = image[bright].astype(float) + dark if above_max else None
    if above_max:
        image[bright] = MEAN_MAX - dark
    _add_poisson(image, counted, pixel, electrons, np.float32(dark), key, *alias_tables())
    if means is not None:
        counted_there = counted[bright] if counted.size else 0.0
        image[bright] = means + (image[bright] - counted_there - MEAN_MAX) * np.sqrt(means / MEAN_MAX) + counted_there


@numba.njit(cache=True)
def _count_invalid(image: FloatArray, dark: np.float32) -> tuple[int, int]:
    """Return how many expected values are negative or not finite, and how many are above MEAN_MAX."""
    invalid = above_max = 0
    for y in range(image.shape[0]):
        for x in range(image.shape[1]):
            invalid += not (0 <= image[y, x] + dark < np.inf)
            above_max += image[y, x] + dark > MEAN_MAX
    return invalid, above_max


@numba.njit(cache=True)
def _add_poisson(
    image: FloatArray,
    counted: IntArray,
    pixel: IntArray,
    electrons: IntArray,
    dark: np.float32,
    key: np.uint64,
    threshold: IntArray,
    alias: IntArray,
) -> None:
    """Draw row by row; add counted electrons, a plane (or one without pixels) and a list (SparsePlane) of them."""
    width = image.shape[1]
    index = 0
    words = np.empty(width, np.uint64)
    over = np.empty(width, np.float32)
    counts = np.empty(width, np.int32)
    for y in range(image.shape[0]):
        poisson_row(image[y], dark, key, y, words, over, counts, threshold, alias)
        if counted.size:
            counts += counted[y]
        while index < len(pixel) and pixel[index] < (y + 1) * width:
            counts[pixel[index] - y * width] += electrons[index]
            index += 1
        image[y] = counts


def add_gaussian(image: FloatArray, sigma: float, key: np.uint64) -> None:
    """Add Gaussian noise of standard deviation `sigma` (scalar, image's unit) to `image` (float32), in place.

    `key` as for add_poisson. Raises ValueError for a sigma that is negative or NaN.
    """
    if not sigma >= 0:
        raise ValueError(f"standard deviation of noise {sigma}; need 0 or more")
    if sigma > 0:
        _add_gaussian(image, np.float32(sigma), key, *normal_table())


@numba.njit(cache=True)
def _add_gaussian(image: FloatArray, sigma: np.float32, key: np.uint64, start: FloatArray, step: FloatArray) -> None:
    width = image.shape[1]
    halves = np.empty(width + 2, np.uint32)
    noise = np.empty(width, np.float32)
    for y in range(image.shape[0]):
        normal_row(key, y, 0, halves, noise, start, step)
        for x in range(width):
            image[y, x] += sigma * noise[x]
