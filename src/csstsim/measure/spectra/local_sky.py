"""Sky next to a spectrum: clipped means of a strip on either side of the trace, per block of columns.

The mean of the two sides is the level at the trace also if the sky slopes across it; between blocks it is linear. A
side whose usable fraction is below USABLE (the window's edge, a saturated neighbour) is left out. The strips also
contain wings of the object, so bright columns raise the sky of dim ones; `sky_without_object` corrects this.
"""

from dataclasses import dataclass
from typing import NamedTuple, Self

import numba
import numpy as np

from csstsim.base.arrays.robust_sigma import SIGMA_PER_MAD
from csstsim.base.types import BoolArray, FloatArray, IntArray

BLOCK = 48  # columns
# robust sigma about the median
CLIP = 4.0
ROUNDS = 3
USABLE = 0.25
OBJECT_ROUNDS = 4  # a few per cent of the object's flux are in the strips; each round leaves a few per cent of these
SMALL = 2e-4  # electron / px: a smaller change of the sky needs no further round


class Sky(NamedTuple):
    """Sky by column, or by block: `level` [electron / px], its `variance`, `fraction` of the object's flux in a pixel.

    The fraction is that in the pixels of the strips.
    """

    level: FloatArray
    variance: FloatArray
    fraction: FloatArray


class _Side(NamedTuple):
    """The values of Sky in one strip."""

    level: float
    variance: float
    fraction: float


class _StripPixels(NamedTuple):
    """Fields of Strips; number: its `count`."""

    data: FloatArray
    fraction: FloatArray
    column: IntArray
    number: IntArray


@dataclass(frozen=True, eq=False)
class Strips:
    """The usable pixels of the strips of n columns, in blocks: strips 2 k and 2 k + 1 are the sides of block k.

    data, fraction, column (strips, pixels): electrons, fraction of the object's flux and column of each pixel; count
    (strips,): number of pixels, 0 for a strip with too few; middle (blocks,): column; columns: n.
    """

    data: FloatArray
    fraction: FloatArray
    column: IntArray
    count: IntArray
    middle: FloatArray
    columns: int

    @classmethod
    def of(
        cls, data: FloatArray, good: BoolArray, offset: FloatArray, fraction: FloatArray, inner: float, width: float
    ) -> Self:
        """Return the Strips of a cutout (n, rows) at |offset| from `inner` to `inner` + `width` [px].

        data: electrons; good: bool; offset: rows from the trace; fraction: of the object's flux in each pixel.
        """
        n = len(good)
        edges = np.linspace(0, n, max(1, round(n / BLOCK)) + 1).astype(int)
        pixels = _pixels(data, good, offset, fraction, edges, float(inner), float(width))
        middle = 0.5 * (edges[1:] + edges[:-1] - 1)
        return cls(pixels.data, pixels.fraction, pixels.column, pixels.number, middle, n)

    def sky(self, electrons: FloatArray) -> Sky:
        """Return the Sky of the columns without the object's `electrons` (n,); NaN if no strip is usable."""
        blocks = self.by_block(electrons)
        known = np.isfinite(blocks.level)
        if not known.any():
            return Sky(*np.full((3, self.columns), np.nan))
        return Sky(*(np.interp(np.arange(self.columns), self.middle[known], values[known]) for values in blocks))

    def by_block(self, electrons: FloatArray) -> Sky:
        """Return the Sky in the middle of each block (blocks,), as `sky`; NaN where no strip is usable."""
        values = _values(self.data, self.fraction, self.column, self.count, electrons)
        return _by_block(values, np.sort(values, axis=1), self.fraction, self.count)

    def sky_without_object(
        self, data: FloatArray, good: BoolArray, fraction: FloatArray, overlap: FloatArray, known: BoolArray
    ) -> Sky:
        """Return the Sky of the columns without the flux of the object in the strips.

        Each round measures the object's electrons in the good pixels of an aperture with the sky of the last round,
        sum of overlap (data - sky) / sum of overlap fraction. It subtracts them from the strips and measures the sky
        again, until that would change by less than SMALL. data (electrons), good, fraction, overlap (n, rows): of the
        aperture; known (n,): columns whose electrons are measured; those of others are interpolated.
        """
        electrons = np.zeros(len(data))
        column = np.arange(len(data))
        for _ in range(OBJECT_ROUNDS):
            sky = self.sky(electrons)
            if known.any() and np.isfinite(sky.level).all():
                in_aperture = _electrons(data, good, fraction, overlap, sky.level)
                before = electrons
                electrons = np.interp(column, column[known], in_aperture[known])
                if np.abs(electrons - before).mean() * sky.fraction.max() < SMALL:
                    break
        return sky


@numba.njit(cache=True)
def _pixels(
    data: FloatArray,
    good: BoolArray,
    offset: FloatArray,
    fraction: FloatArray,
    edges: IntArray,
    inner: float,
    width: float,
) -> _StripPixels:
    rows = good.shape[1]
    pixels_max = (edges[1:] - edges[:-1]).max() * (int(width) + 1)
    count = np.zeros(2 * (len(edges) - 1), np.int64)
    values = np.zeros((len(count), pixels_max))
    fractions = np.zeros((len(count), pixels_max))
    column = np.zeros((len(count), pixels_max), np.int64)
    for strip in range(len(count)):
        k = strip // 2
        side = 2.0 * (strip % 2) - 1.0
        n = 0
        for i in range(edges[k], edges[k + 1]):
            for j in range(rows):
                if good[i, j] and inner <= side * offset[i, j] < inner + width:
                    values[strip, n] = data[i, j]
                    fractions[strip, n] = fraction[i, j]
                    column[strip, n] = i
                    n += 1
        if n >= max(USABLE * (edges[k + 1] - edges[k]) * width, 2):
            count[strip] = n
    return _StripPixels(values, fractions, column, count)


@numba.njit(cache=True)
def _values(
    data: FloatArray, fraction: FloatArray, column: IntArray, count: IntArray, electrons: FloatArray
) -> FloatArray:
    """Return (strips, pixels): the electrons of the strips' pixels without the object's; inf after the last pixel."""
    out = np.full((len(count), max(count.max(), 1)), np.inf)
    for strip in range(len(count)):
        for k in range(count[strip]):
            out[strip, k] = data[strip, k] - electrons[column[strip, k]] * fraction[strip, k]
    return out


@numba.njit(cache=True)
def _by_block(values: FloatArray, ranked: FloatArray, fractions: FloatArray, count: IntArray) -> Sky:
    """Return the Sky of each block, the mean of its usable sides; NaN where none is usable.

    values (strips, pixels): of `_values`; ranked: the same in rising order; fractions: of Strips.
    """
    blocks = len(count) // 2
    sky = Sky(np.full(blocks, np.nan), np.full(blocks, np.nan), np.full(blocks, np.nan))
    for k in range(blocks):
        level = 0.0
        variance = 0.0
        fraction = 0.0
        sides = 0
        for strip in range(2 * k, 2 * k + 2):
            n = count[strip]
            if n:
                side = _clipped(values[strip, :n], ranked[strip, :n], fractions[strip, :n])
                level += side.level
                variance += side.variance
                fraction += side.fraction
                sides += 1
        if sides:
            sky.level[k] = level / sides
            sky.variance[k] = variance / sides / sides  # of the mean of two strips
            sky.fraction[k] = fraction / sides
    return sky


@numba.njit(cache=True)
def _clipped(values: FloatArray, ranked: FloatArray, fractions: FloatArray) -> _Side:
    """Return the mean of the values within CLIP robust sigma about their median, its variance, their mean fraction."""
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
    lowest = ranked[low]
    highest = ranked[high - 1]
    n = high - low
    mean = 0.0
    fraction = 0.0
    for k in range(len(values)):
        if lowest <= values[k] <= highest:
            mean += values[k]
            fraction += fractions[k]
    mean /= n
    spread = 0.0
    for value in values:
        if lowest <= value <= highest:
            spread += (value - mean) ** 2
    return _Side(mean, spread / n**2, fraction / n)


@numba.njit(cache=True)
def _deviation(ranked: FloatArray, centre: float) -> float:
    """Return the median distance from `centre` of values in rising order."""
    n = len(ranked)
    total = 0.0
    for nearest in ((n + 1) // 2, n // 2 + 1):  # the distance of the farthest of this number of nearest values
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
    data: FloatArray, good: BoolArray, fraction: FloatArray, overlap: FloatArray, level: FloatArray
) -> FloatArray:
    """Return (n,): the object's electrons from the good pixels of the aperture; NaN without good pixels."""
    out = np.empty(len(data))
    for i in range(data.shape[0]):
        flux = 0.0
        norm = 0.0
        for j in range(data.shape[1]):
            if good[i, j]:
                flux += overlap[i, j] * (data[i, j] - level[i])
                norm += overlap[i, j] * fraction[i, j]
        out[i] = flux / norm if norm != 0.0 else np.nan
    return out
