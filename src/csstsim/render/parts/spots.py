"""Light as many spots: the knots of a galaxy, or the pixels of an image of one.

A group of spots is a profile as a Sersic component is: photons are drawn from it, and stamps multiply its transform by
that of the PSF. Knots are points of equal light. The pixels of an image are quadratic B-splines of one pixel with the
coefficients that reproduce the flux of each pixel (render.psf_table.spline_coefficients, as for the PSF), so the image
is smooth between pixels and does not ring. Positions are in arcsec (knots) or pixels of the image, before the 2 x 2
matrix of the object.
"""

from __future__ import annotations

import math
from functools import cached_property, lru_cache
from typing import TYPE_CHECKING, NamedTuple

import numba
import numpy as np
from scipy.ndimage import convolve1d

from csstsim.base.types import ComplexArray, FloatArray, IntArray
from csstsim.render.parts.lattice_transform import LatticeTransform
from csstsim.render.psf_table import spline_coefficients

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import ArrayLike

_TRANSFORMS_KEPT = 16
_RINGS = 1e-3  # of the light in negative coefficients, above which they are found by steps ...
_STEPS = 30  # ... of this number


class SampledSpots(NamedTuple):
    """Arrays of a Spots for compiled loops; keep, other: alias tables of the groups (`alias_table`), per spot."""

    start: IntArray
    u: FloatArray
    v: FloatArray
    keep: FloatArray
    other: IntArray
    blur: FloatArray


class SpotGroup(NamedTuple):
    """The positions u, v and the fractions of flux (n,), of sum 1, of one group of spots."""

    u: FloatArray
    v: FloatArray
    light: FloatArray


class Spots:
    """Groups of spots: first those of knots, then those of images.

    * start: (groups + 1,), index of each group's first spot
    * u, v: positions of all spots
    * blur: (groups,), side of an image's pixel, 0 for knots
    * extent: (groups,), the largest distance of flux from the origin
    """

    def __init__(
        self,
        counts: Sequence[int] | IntArray = (),
        u: ArrayLike = (),
        v: ArrayLike = (),
        images: Sequence[FloatArray] = (),
    ) -> None:
        """counts (k,), u, v (sum of counts,): knots; images: coefficients (rows, columns) of each, none negative."""
        lattices = [_lattice(image) for image in images]
        sizes = [*np.asarray(counts, int), *(len(lattice.light) for lattice in lattices)]
        self.start = np.concatenate([[0], np.cumsum(sizes)]).astype(np.int64)
        self.u = np.concatenate([np.asarray(u, float), *(lattice.u for lattice in lattices)])
        self.v = np.concatenate([np.asarray(v, float), *(lattice.v for lattice in lattices)])
        self.blur = np.concatenate([np.zeros(len(counts)), np.ones(len(lattices))])
        self._images = images
        self._knots = len(counts)
        self._light = [lattice.light for lattice in lattices]
        self._transform = lru_cache(_TRANSFORMS_KEPT)(lambda k: LatticeTransform(images[k]))

    def __len__(self) -> int:
        return len(self.blur)

    @cached_property
    def extent(self) -> FloatArray:
        """(groups,) the largest distance of flux from the origin."""
        r = np.hypot(self.u, self.v)
        return np.array([r[a:b].max(initial=0.0) for a, b in zip(self.start[:-1], self.start[1:], strict=True)]) + (
            1.5 * math.sqrt(2.0) * self.blur
        )

    @cached_property
    def sampled(self) -> SampledSpots:
        """The SampledSpots; knots have equal fluxes and need no alias table."""
        keep = np.ones(len(self.u))
        other = np.zeros(len(self.u), np.int32)
        for k, light in enumerate(self._light, self._knots):
            part = slice(self.start[k], self.start[k + 1])
            keep[part], other[part] = alias_table(light)
        return SampledSpots(self.start, self.u, self.v, keep, other, self.blur)

    def group(self, k: int) -> SpotGroup:
        """Return the SpotGroup k."""
        part = slice(self.start[k], self.start[k + 1])
        count = self.start[k + 1] - self.start[k]
        light = np.full(count, 1 / count) if k < self._knots else self._light[k - self._knots]
        return SpotGroup(self.u[part], self.v[part], light)

    def image(self, k: int) -> FloatArray | None:
        """Return the coefficients (rows, columns) of group k, an image; None for knots."""
        return None if k < self._knots else self._images[k - self._knots]

    def transform(self, k: int, matrix: FloatArray, size: int, last: int) -> ComplexArray:
        """Return the transform of group k, light 1, at the frequencies of render.psf_mixture.transform, complex64."""
        image = self.image(k)
        if image is None:
            knots = self.group(k)
            x, y = matrix @ np.stack([knots.u, knots.v])
            return _knots_transform(x, y, size, last)
        out = self._transform(k - self._knots).at(matrix, size, last)
        # Its origin is a pixel's centre; that of the group is the middle of the image
        shift_x, shift_y = matrix @ [n // 2 - (n - 1) / 2 for n in image.shape[::-1]]
        if shift_x or shift_y:
            turn_x = np.exp(-2j * np.pi / size * shift_x * np.arange(last + 1))
            turn_y = np.exp(-2j * np.pi / size * shift_y * np.arange(-last, last + 1))
            out *= (turn_y[:, None] * turn_x).astype(np.complex64)
        return out


def _lattice(coefficients: FloatArray) -> SpotGroup:
    """Return the SpotGroup of the pixels of an image that have flux; positions from its middle."""
    rows, columns = np.nonzero(coefficients > 0)
    light = coefficients[rows, columns]
    ny, nx = coefficients.shape
    return SpotGroup(columns - (nx - 1) / 2, rows - (ny - 1) / 2, light / light.sum())


def image_coefficients(pixels: FloatArray) -> FloatArray:
    """Return the B-spline coefficients (rows + 2, columns + 2), none negative and of sum 1, of an image's pixels.

    An image sampled well has no negative ones, and they reproduce each pixel. Others, as single bright pixels, get the
    coefficients nearest to that by Richardson-Lucy steps, which keep them positive and smooth.
    """
    padded = np.pad(pixels, 1)
    coefficients, below = spline_coefficients(padded)
    if below > _RINGS * padded.sum():
        coefficients = padded / padded.sum()
        for _ in range(_STEPS):
            seen = in_pixels(coefficients)
            coefficients = coefficients * in_pixels(np.divide(padded, seen, out=np.zeros_like(seen), where=seen > 0))
    return coefficients / coefficients.sum()


def in_pixels(coefficients: FloatArray) -> FloatArray:
    """Return the light in pixels of splines with these coefficients."""
    for axis in (0, 1):
        coefficients = convolve1d(coefficients, [1 / 6, 2 / 3, 1 / 6], axis=axis, mode="constant")
    return coefficients


@numba.njit(cache=True)
def alias_table(light: FloatArray) -> tuple[FloatArray, IntArray]:
    """Return (keep, other): a draw of j evenly, then of j with probability keep[j] and else other[j] (Vose 1991)."""
    n = len(light)
    keep = np.empty(n)
    other = np.empty(n, np.int32)
    scaled = light * (n / light.sum())
    small = np.empty(n, np.int64)
    large = np.empty(n, np.int64)
    few = many = 0
    for j in range(n):
        other[j] = j
        if scaled[j] < 1.0:
            small[few] = j
            few += 1
        else:
            large[many] = j
            many += 1
    while few > 0 and many > 0:
        few -= 1
        a = small[few]
        b = large[many - 1]
        keep[a] = scaled[a]
        other[a] = b
        scaled[b] -= 1.0 - scaled[a]
        if scaled[b] < 1.0:
            many -= 1
            small[few] = b
            few += 1
    for k in range(many):
        keep[large[k]] = 1.0
    for k in range(few):
        keep[small[k]] = 1.0
    return keep, other


@numba.njit(cache=True)
def _knots_transform(x: FloatArray, y: FloatArray, size: int, last: int) -> ComplexArray:
    """Return (2 last + 1, last + 1) complex64: the mean of exp(-2 pi i (k_x x + k_y y) / size) over knots."""
    out = np.zeros((2 * last + 1, last + 1), np.complex64)
    step = 2 * math.pi / size
    n = len(x)
    line = np.empty(last + 1, np.complex128)
    for row in range(2 * last + 1):
        ky = row - last
        count = int(math.sqrt(last * last - ky * ky)) + 1
        line[:count] = 0.0
        for j in range(n):
            value = complex(math.cos(step * ky * y[j]), -math.sin(step * ky * y[j])) / n
            turn = complex(math.cos(step * x[j]), -math.sin(step * x[j]))
            for k in range(count):
                line[k] += value
                value *= turn
        for k in range(count):
            out[row, k] = line[k]
    return out
