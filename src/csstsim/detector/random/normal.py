"""Normal random numbers of pixels: that of pixel (x, y) depends only on the key, not on the order of drawing.

Two pixels share a word of csstsim.base.counter, 32 bits each: 12 bits choose one of CELLS equally probable intervals,
20 bits the position in it, linear between its ends. In the EDGE outermost intervals on either side, beyond TAIL = 2.66
sigma, the number is drawn from the exact tail (Marsaglia 1964, Technometrics 6, 101), with words of that pixel only.
The linear intervals change the distribution function by up to 2e-6 and the variance by up to 1e-5.
"""

import math
from functools import cache
from statistics import NormalDist
from typing import NamedTuple

import numba
import numpy as np

from csstsim.base.counter import unit, word
from csstsim.base.types import FloatArray, IntArray

CELLS = 4096
EDGE = 16
TAIL = -NormalDist().inv_cdf(EDGE / CELLS)
_BEYOND = np.float32(9.0)  # value in the table that marks the tail
_POSITION_BITS = np.uint32(20)
_POSITION_MASK = np.uint32((1 << 20) - 1)
_S1 = np.uint64(1)
_S32 = np.uint64(32)
_ONE = np.uint64(1)
_TWO = np.uint64(2)


class NormalTable(NamedTuple):
    """(CELLS,) float32 each: the number of a cell is start + step x position, position 0 to 2^20."""

    start: FloatArray
    step: FloatArray


@cache
def normal_table() -> NormalTable:
    """Return the NormalTable, (CELLS,)."""
    inverse = NormalDist().inv_cdf
    ends = np.array([inverse(i / CELLS) for i in range(EDGE, CELLS - EDGE + 1)])
    start = np.full(CELLS, _BEYOND)
    step = np.zeros(CELLS, np.float32)
    start[:EDGE] = -_BEYOND
    start[EDGE : CELLS - EDGE] = ends[:-1]
    step[EDGE : CELLS - EDGE] = np.diff(ends) / 2.0**20
    return NormalTable(start, step)


@numba.njit(inline="always")
def pixel_counter(x: int, y: int) -> np.uint64:
    """Return the counter of pixel column x, row y (both from 0 to 2^32 - 1)."""
    return (np.uint64(y) << _S32) + np.uint64(x)


@numba.njit(cache=True)
def normal_row(
    key: np.uint64, y: int, x0: int, halves: IntArray, out: FloatArray, start: FloatArray, step: FloatArray
) -> None:
    """Fill `out` (n,) float32 with the numbers of columns x0 to x0 + n - 1 of row y.

    halves: (n + 2,) uint32, work space; start, step: normal_table().
    """
    first = x0 & 1
    counter = pixel_counter(x0 >> 1, y)
    for i in range((first + len(out) + 1) >> 1):
        bits = word(key, counter + np.uint64(i))
        halves[2 * i] = np.uint32(bits)
        halves[2 * i + 1] = np.uint32(bits >> _S32)
    for x in range(len(out)):
        half = halves[first + x]
        cell = np.int32(half >> _POSITION_BITS)
        out[x] = start[cell] + step[cell] * np.float32(np.int32(half & _POSITION_MASK))
    for x in range(len(out)):
        if abs(out[x]) >= _BEYOND:
            out[x] = math.copysign(_tail(word(~key, pixel_counter(x0 + x, y))), out[x])


@numba.njit(inline="always")
def normal(half: np.uint32, key: np.uint64, start: FloatArray, step: FloatArray) -> float:
    """Return the normal number of 32 bits (uint32); key: of words for the tail, not used elsewhere."""
    cell = half >> _POSITION_BITS
    z = np.float64(start[cell] + step[cell] * np.float32(np.int32(half & _POSITION_MASK)))
    return math.copysign(_tail(key), z) if abs(z) >= _BEYOND else z


@numba.njit()
def _tail(key: np.uint64) -> float:
    """Return a normal number above TAIL."""
    counter = np.uint64(0)
    while True:
        distance = -math.log(unit(word(key, counter))) / TAIL
        if -2 * math.log(unit(word(key, counter + _ONE))) >= distance * distance:
            return TAIL + distance
        counter += _TWO
