"""Poisson random numbers of pixels: as in csstsim.detector.random.normal, they do not depend on the order of drawing.

Below TABLE_MAX the mean is split: Poisson(m) = Poisson(a) + Poisson(m - a) with a = floor(16 m) / 16. The first is read
from an alias table (Walker 1977, ACM TOMS 3, 253) with 40 bits of the pixel's word. The second, of mean below 1/16, is
drawn by inversion with the other 24 bits. Larger means are drawn by rejection (csstsim.base.counter.poisson). The
finite number of bits changes no probability by more than 1e-7.
"""

from functools import cache

import numba
import numpy as np

from csstsim.base.counter import poisson, word
from csstsim.base.types import FloatArray, IntArray
from csstsim.detector.random.normal import pixel_counter

TABLE_MAX = 128  # electrons; above the sky of a 250 s exposure and the wings of objects
_MEAN_MAX = np.float32(127.99)
_STEPS = np.float32(16)  # tabulated means per electron
_CELLS = 256  # P(256 or more) at mean 128 is 1e-22
_S8 = np.uint64(8)
_S24 = np.uint64(24)
_S56 = np.uint64(56)
_LOW_32 = np.uint64((1 << 32) - 1)
_REST_MASK = np.uint64((1 << 24) - 1)
_REST_UNIT = np.float32(2.0**-24)
_REJECTED = np.float32(2)
_REST_MAX = 20  # P(more) of a mean below 1/16 is 1e-43
_ZERO = np.uint64(0)


@cache
def alias_tables() -> tuple[IntArray, IntArray]:
    """Return (threshold, alias), uint32 and uint8.

    For the mean i / 16, cell 256 i + n gives n with probability threshold / 2^32, else its alias.
    """
    mean = np.arange(int(TABLE_MAX * _STEPS)) / float(_STEPS)
    probability = np.exp(-mean)
    parts = np.empty((len(mean), _CELLS), np.int64)
    for n in range(_CELLS):
        parts[:, n] = np.rint(probability * 2.0**40)
        probability *= mean / (n + 1)
    parts[np.arange(len(mean)), mean.astype(int)] += 2**40 - parts.sum(axis=1)  # integers: the same on any machine
    threshold, alias = (np.empty(parts.shape, kind) for kind in (np.uint32, np.uint8))
    for row in range(len(mean)):
        _fill_alias(parts[row], threshold[row], alias[row])
    return threshold.ravel(), alias.ravel()


@numba.njit(cache=True)
def _fill_alias(parts: IntArray, threshold: IntArray, alias: IntArray) -> None:
    """Divide 2^40 parts among 256 cells of 2^32, each with one or two outcomes."""
    size = 2**32
    small = np.empty(_CELLS, np.int64)
    large = np.empty(_CELLS, np.int64)
    n_small = n_large = 0
    for n in range(_CELLS):
        if parts[n] < size:
            small[n_small] = n
            n_small += 1
        else:
            large[n_large] = n
            n_large += 1
    while n_small:
        n_small -= 1
        low = small[n_small]
        high = large[n_large - 1]
        threshold[low] = parts[low]
        alias[low] = high
        parts[high] -= size - parts[low]
        if parts[high] < size:
            n_large -= 1
            small[n_small] = high
            n_small += 1
    for i in range(n_large):  # the remaining cells have exactly 2^32 parts
        threshold[large[i]], alias[large[i]] = 0, large[i]


@numba.njit(cache=True)
def poisson_row(
    means: FloatArray,
    dark: np.float32,
    key: np.uint64,
    y: int,
    words: IntArray,
    over: FloatArray,
    counts: IntArray,
    threshold: IntArray,
    alias: IntArray,
) -> None:
    """Fill `counts` (n,) int32 with Poisson numbers of mean means + dark [>= 0, finite], columns 0 to n - 1 of row y.

    means: (n,) float32; dark: float32; words, over: (n,) uint64 and float32, work space; threshold, alias: of
    alias_tables().
    There are four loops instead of one, so that the compiler can vectorise the first three.
    """
    counter = pixel_counter(0, y)
    for x in range(len(means)):
        words[x] = word(key, counter + np.uint64(x))
    for x in range(len(means)):
        table = np.uint64(np.int32(min(means[x] + dark, _MEAN_MAX) * _STEPS))
        cell = words[x] >> _S56
        index = (table << _S8) | cell
        counts[x] = np.int32(cell) if (words[x] >> _S24) & _LOW_32 < threshold[index] else np.int32(alias[index])
    for x in range(len(means)):  # exp(-rest) >= 1 - rest, so rest + u < 1 means no event
        mean = means[x] + dark
        rest = mean - np.floor(mean * _STEPS) / _STEPS
        u = np.float32(np.int32(words[x] & _REST_MASK)) * _REST_UNIT
        over[x] = rest + u if mean < TABLE_MAX else _REJECTED
    for x in range(len(means)):
        if over[x] >= 1:
            mean = means[x] + dark
            if mean < TABLE_MAX:
                rest = np.float64(mean - np.floor(mean * _STEPS) / _STEPS)
                counts[x] += _invert(rest, np.float64(words[x] & _REST_MASK) * _REST_UNIT)
            else:
                counts[x] = poisson(np.float64(mean), word(~key, counter + np.uint64(x)), _ZERO)[0]


@numba.njit()
def _invert(mean: float, u: float) -> int:
    p = np.exp(-mean)
    k = 0
    while u >= p and k < _REST_MAX:
        u -= p
        k += 1
        p *= mean / k
    return k
