"""The outer part of a galaxy so long and thin that the PSF changes it: blurred across the long axis.

Far from the centre the profile changes slowly along its long axis, so the convolution with the PSF is one of lines
across it with the PSF's integral along it, whose transform is the PSF's own on a line through its origin (the
projection-slice theorem). It is computed on a table of distances along and across, from which the pixels are read.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numba
import numpy as np
from scipy.fft import irfft, next_fast_len, rfft
from scipy.ndimage import map_coordinates

from csstsim.base.types import ComplexArray, FloatArray
from csstsim.catalog.profiles.log_table import first_of, read
from csstsim.catalog.profiles.sersic import R2_LOW

_THIN = 0.05  # px: a thinner galaxy is rendered with this half-light radius across; the PSF is some twenty times wider
_FINE = 8  # samples of a component to its half-light radius across
_ALONG = 2.0  # px between lines across
_PER_PIXEL = 16  # values per pixel across that are stored
_BAND = 1.5  # of half the PSF's box, which ends at sqrt(2) across a diagonal: beyond, the profile is as it is
_LINES = 64  # at a time
_INSIDE = 64  # distances in a sample near the long axis
_R2_FIRST = first_of(R2_LOW)


class Components(NamedTuple):
    """The two components of a galaxy, disk and bulge, each split into an inner and an outer part (profiles.sersic).

    * sersic: (2, 3), index, b, half-light radius [arcsec]
    * light: (2,), fractions of the galaxy's flux
    * matrix: (2, 2), px per arcsec
    * inner: (2, m), transforms of the inner parts
    * outer: (2, l), profiles of the outer parts
    * cut: (2,), radius [half-light radii] at which the inner part ends; inf: there is no outer part
    """

    sersic: FloatArray
    light: FloatArray
    matrix: FloatArray
    inner: FloatArray
    outer: FloatArray
    cut: FloatArray


@dataclass(frozen=True)
class Across:
    """The light of the outer parts [electron / px^2] at distances along and across the long axis."""

    values: FloatArray  # (lines, samples) float64, from 0 along and from -band across
    axes: FloatArray  # (2, 2): unit vectors along and across, in columns
    band: float  # px: |distance across| of the samples


def across(mixture: ComplexArray, size: int, components: Components, far: float, half: float) -> Across:
    """Return the Across of a galaxy's outer parts.

    mixture: the PSF's transform (psf_mixture.transform) of period `size`; far: the largest distance along the long axis
    [px]; half: half the side of the PSF's box [px].
    """
    light = components.light
    axes, (long, short), _ = np.linalg.svd(components.matrix)
    period = 4.0 * half
    band = _BAND * half
    along = np.arange(0.0, far + 2 * _ALONG, _ALONG)
    stored = np.arange(-np.ceil(band * _PER_PIXEL) - 1, np.ceil(band * _PER_PIXEL) + 2)
    values = np.zeros((len(along), len(stored)))
    for c in np.flatnonzero((light > 0) & np.isfinite(components.cut)):
        radius = components.sersic[c, 2]
        table = components.outer[c]
        wide = long * radius
        thin = max(short * radius, _THIN)
        step = 1 / (_PER_PIXEL * next_fast_len(int(np.ceil(_FINE / (_PER_PIXEL * thin)))))
        count = round(period / step)
        slice_ = _slice(mixture, size, axes[:, 1], np.arange(count // 2 + 1) / period)
        distance = np.fft.fftfreq(count, 1 / period)
        cells = list(_cells(step))
        sampled = np.round(stored / (_PER_PIXEL * step)).astype(int) % count
        for first in range(0, len(along), _LINES):
            block = slice(first, first + _LINES)
            along2 = (along[block, None] / wide) ** 2
            lines = _profile(along2, (distance / thin) ** 2, table)
            for cell, (inside, weight) in enumerate(cells):
                mean = _profile(along2, (inside / thin) ** 2, table) @ weight
                lines[:, cell] = lines[:, -cell] = mean
            blurred = irfft(rfft(lines, axis=1) * slice_, count, axis=1)[:, sampled]
            values[block] += light[c] / (wide * thin) * blurred
    return Across(values, axes, -stored[0] / _PER_PIXEL)


def _cells(step: float) -> Iterator[tuple[FloatArray, FloatArray]]:
    """Yield (distances across, weights) of the means over the samples near the long axis, without the inner part."""
    middle = 0.5 * step * np.geomspace(1e-4, 1.0, _INSIDE)  # the profile may be steep
    yield middle, np.gradient(middle) / np.gradient(middle).sum()
    for cell in range(1, _FINE + 1):
        yield step * (cell - 0.5 + (np.arange(_INSIDE) + 0.5) / _INSIDE), np.full(_INSIDE, 1 / _INSIDE)


def _slice(mixture: ComplexArray, size: int, direction: FloatArray, frequency: FloatArray) -> ComplexArray:
    """Return the transform at frequencies [cycles per pixel] along a unit vector; 0 beyond the last."""
    last = mixture.shape[1] - 1
    turned = direction if direction[0] >= 0 else -direction  # columns of negative frequencies are not stored
    at = np.stack([last + frequency * size * turned[1], frequency * size * turned[0]])
    value = map_coordinates(mixture, at, order=1, mode="constant")
    return value if direction[0] >= 0 else value.conj()


@numba.njit(cache=True)
def _profile(along2: FloatArray, across2: FloatArray, table: FloatArray) -> FloatArray:
    """Return a profile at squared distances (lines, 1) along and (samples,) across, both in half-light radii."""
    out = np.empty((len(along2), len(across2)))
    line = np.empty(len(across2))
    bits = line.view(np.int64)
    for row in range(len(along2)):
        line[:] = along2[row, 0] + across2
        for column in range(len(across2)):
            out[row, column] = read(table, _R2_FIRST, bits[column])
    return out


@numba.njit(cache=True)
def add_band(stamp: FloatArray, values: FloatArray, axes: FloatArray, band: float, x: float, y: float) -> None:
    """Add an Across to the pixels of a stamp within its band, the galaxy's centre at x, y from the first pixel."""
    for row in range(stamp.shape[0]):
        for column in range(stamp.shape[1]):
            dx = column - x
            dy = row - y
            side = axes[0, 1] * dx + axes[1, 1] * dy
            i = abs(axes[0, 0] * dx + axes[1, 0] * dy) / _ALONG
            j = (side + band) * _PER_PIXEL
            k = int(i)
            m = int(np.floor(j))
            if 0 <= m < values.shape[1] - 1 and k < values.shape[0] - 1:
                u = i - k
                v = j - m
                near = (1 - v) * values[k, m] + v * values[k, m + 1]
                far = (1 - v) * values[k + 1, m] + v * values[k + 1, m + 1]
                stamp[row, column] += (1 - u) * near + u * far
