"""Sky beside a spectrum: clipped means of a strip on either side of the trace, per block of columns.

The mean of the two sides is the level at the trace also if the sky slopes across it; between blocks it is linear. A
side with a usable share below USABLE (the window's edge, a saturated neighbour) is left out. The strips also contain
the object's own far light, so bright columns raise the sky of dim ones; `sky_less_own` corrects this.
"""

from dataclasses import dataclass
from typing import Self

import numba
import numpy as np

from csstsim.base.arrays.robust_sigma import SIGMA_PER_MAD
from csstsim.base.types import BoolArray, FloatArray, IntArray

BLOCK = 48  # columns
# robust sigma about the median
CLIP = 4.0
ROUNDS = 3
USABLE = 0.25
OWN_ROUNDS = 4  # the object's light in the strips is a few per cent; each round leaves a few per cent of it


@dataclass(frozen=True, eq=False)
class Sky:
    """By column, (n,): `level` electron / px, `variance` of it, `own` share of the object's light in a strip's px."""

    level: FloatArray
    variance: FloatArray
    own: FloatArray


@dataclass(frozen=True, eq=False)
class Strips:
    """The usable pixels of the strips of n columns, in blocks: strips 2 k and 2 k + 1 are the sides of block k.

    data, share, column (strips, most): electrons, share of the object's light and column of each pixel; count
    (strips,): pixels of each, 0 of those with too few; middle (blocks,): column; columns: n.
    """

    data: FloatArray
    share: FloatArray
    column: IntArray
    count: IntArray
    middle: FloatArray
    columns: int

    @classmethod
    def of(
        cls, data: FloatArray, good: BoolArray, offset: FloatArray, share: FloatArray, inner: float, width: float
    ) -> Self:
        """Return the Strips of a cutout (n, rows) at |offset| from `inner` to `inner` + `width` [px].

        data: electrons; good: bool; offset: rows from the trace; share: of the object's light.
        """
        n = len(good)
        edges = np.linspace(0, n, max(1, round(n / BLOCK)) + 1).astype(int)
        found = _pixels(data, good, offset, share, edges, float(inner), float(width))
        return cls(*found, 0.5 * (edges[1:] + edges[:-1] - 1), n)

    def sky(self, light: FloatArray) -> Sky:
        """Return the Sky of the electrons less light (n,) of the object; NaN where no strip is usable."""
        found = self.by_block(light)
        level, _, _ = found
        there = np.isfinite(level)
        if not there.any():
            return Sky(*np.full((3, self.columns), np.nan))
        return Sky(*(np.interp(np.arange(self.columns), self.middle[there], one[there]) for one in found))

    def by_block(self, light: FloatArray) -> FloatArray:
        """Return (3, blocks): the values of `sky` in the middle of each block; NaN where no strip is usable."""
        values = _values(self.data, self.share, self.column, self.count, light)
        return _by_block(values, np.sort(values, axis=1), self.share, self.count)

    def sky_less_own(
        self, data: FloatArray, good: BoolArray, share: FloatArray, overlap: FloatArray, known: BoolArray
    ) -> Sky:
        """Return the Sky without the light of the object itself in the strips.

        Each round measures the object's light in the good pixels of an aperture, sum of overlap (data - sky) over that
        of overlap share, with the sky so far, removes it from the strips and measures the sky again. data (electrons),
        good, share, overlap (n, rows): of the aperture; known (n,): columns with such light; others are interpolated.
        """
        light = np.zeros(len(data))
        column = np.arange(len(data))
        for _ in range(OWN_ROUNDS):
            sky = self.sky(light)
            if known.any() and np.isfinite(sky.level).all():
                found = _electrons(data, good, share, overlap, sky.level)
                light = np.interp(column, column[known], found[known])
        return sky


@numba.njit(cache=True)
def _pixels(
    data: FloatArray,
    good: BoolArray,
    offset: FloatArray,
    share: FloatArray,
    edges: IntArray,
    inner: float,
    width: float,
) -> tuple[FloatArray, FloatArray, IntArray, IntArray]:
    """Return Strips.data, share, column and count."""
    rows = good.shape[1]
    most = (edges[1:] - edges[:-1]).max() * (int(width) + 1)
    count = np.zeros(2 * (len(edges) - 1), np.int64)
    values = np.zeros((len(count), most))
    own = np.zeros((len(count), most))
    column = np.zeros((len(count), most), np.int64)
    for strip in range(len(count)):
        k = strip // 2
        side = 2.0 * (strip % 2) - 1.0
        n = 0
        for i in range(edges[k], edges[k + 1]):
            for j in range(rows):
                if good[i, j] and inner <= side * offset[i, j] < inner + width:
                    values[strip, n], own[strip, n], column[strip, n] = data[i, j], share[i, j], i
                    n += 1
        if n >= max(USABLE * (edges[k + 1] - edges[k]) * width, 2):
            count[strip] = n
    return values, own, column, count


@numba.njit(cache=True)
def _values(data: FloatArray, share: FloatArray, column: IntArray, count: IntArray, light: FloatArray) -> FloatArray:
    """Return (strips, most): the electrons of the strips' pixels less the object's; inf after the last one."""
    out = np.full((len(count), max(count.max(), 1)), np.inf)
    for strip in range(len(count)):
        for k in range(count[strip]):
            out[strip, k] = data[strip, k] - light[column[strip, k]] * share[strip, k]
    return out


@numba.njit(cache=True)
def _by_block(values: FloatArray, ranked: FloatArray, own: FloatArray, count: IntArray) -> FloatArray:
    """Return (3, blocks): level, its variance and the object's share, means of the usable sides; NaN: none is.

    values, own (strips, most): of Strips; ranked: values in rising order.
    """
    out = np.full((3, len(count) // 2), np.nan)
    for k in range(out.shape[1]):
        total = np.zeros(3)
        sides = 0
        for strip in range(2 * k, 2 * k + 2):
            n = count[strip]
            if n:
                total += _clipped(values[strip, :n], ranked[strip, :n], own[strip, :n])
                sides += 1
        if sides:
            out[:, k] = total / sides
            out[1, k] /= sides  # of two strips' mean
    return out


@numba.njit(cache=True)
def _clipped(values: FloatArray, ranked: FloatArray, own: FloatArray) -> FloatArray:
    """Return (3,): mean of the values within CLIP robust sigma about their median, its variance, mean of their own."""
    low = 0
    high = len(ranked)
    for _ in range(ROUNDS):
        centre = 0.5 * (ranked[(low + high - 1) // 2] + ranked[(low + high) // 2])
        sigma = SIGMA_PER_MAD * _deviation(ranked[low:high], centre) + 0.5  # at least about a DN of rounding
        before = (low, high)
        low = 0
        high = len(ranked)
        while np.abs(ranked[low] - centre) > CLIP * sigma:
            low += 1
        while np.abs(ranked[high - 1] - centre) > CLIP * sigma:
            high -= 1
        if before == (low, high):
            break
    least = ranked[low]
    most = ranked[high - 1]
    n = high - low
    mean = 0.0
    share = 0.0
    for k in range(len(values)):
        if least <= values[k] <= most:
            mean += values[k]
            share += own[k]
    mean /= n
    spread = 0.0
    for value in values:
        if least <= value <= most:
            spread += (value - mean) ** 2
    return np.array([mean, spread / n**2, share / n])


@numba.njit(cache=True)
def _deviation(ranked: FloatArray, centre: float) -> float:
    """Return the median distance from `centre` of values in rising order."""
    n = len(ranked)
    total = 0.0
    for nearest in ((n + 1) // 2, n // 2 + 1):  # the distance of the farthest of so many nearest ones
        low = 0
        high = n - nearest
        while low < high:
            middle = (low + high) // 2
            if centre - ranked[middle] > ranked[middle + nearest] - centre:
                low = middle + 1
            else:
                high = middle
        total += max(centre - ranked[low], ranked[low + nearest - 1] - centre)
    return 0.5 * total


@numba.njit(cache=True)
def _electrons(
    data: FloatArray, good: BoolArray, share: FloatArray, overlap: FloatArray, level: FloatArray
) -> FloatArray:
    """Return (n,): an object's electrons from the good pixels of the aperture; NaN without any."""
    out = np.empty(len(data))
    for i in range(data.shape[0]):
        light = 0.0
        norm = 0.0
        for j in range(data.shape[1]):
            if good[i, j]:
                light += overlap[i, j] * (data[i, j] - level[i])
                norm += overlap[i, j] * share[i, j]
        out[i] = light / norm if norm != 0.0 else np.nan
    return out
