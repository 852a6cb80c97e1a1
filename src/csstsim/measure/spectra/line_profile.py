"""Profiles of light across, or along, a spectrum: the image of an object, collapsed onto one axis.

    P(t) = PSF collapsed * sum_k f_k S_k(t)         f_k, S_k: fraction of component k of the galaxy, collapsed component

A Sersic component is circular before its shape matrix M [px / arcsec] is applied, so its projection onto axis i is that
of the circle with the radius r_e |M_i| (row i of M): exact for any ellipticity. The fraction of the flux of a circle of
radius R below t is 1/2 + arcsin(t / R) / pi, averaged over radii of equal flux. The PSF's box is summed; beyond it the
profile is that of the wing (optics.scatter.halo). Profiles are stored as the fraction of the total flux below t, at the
PSF's four wavelengths, on OFFSETS; between wavelengths they are interpolated linearly. Left out: differences of the
profile between the columns of a line (measure.spectra.line_image), flux beyond HALF px of the axis.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, Self, cast, overload

import numba
import numpy as np
from numpy.typing import ArrayLike

from csstsim.base.types import BoolArray, FloatArray, Floats, IntArray
from csstsim.catalog.profiles.sersic import BULGE, DISK, radius_of

if TYPE_CHECKING:
    from csstsim.optics.scatter.halo import Wing

PER_PX = 8
HALF = 64  # px
OFFSETS = np.arange(-HALF * PER_PX, HALF * PER_PX + 1) / PER_PX  # px
# axis of a profile: x (dispersion), y
ALONG = 0
ACROSS = 1
_WING = 512.0  # px: wings are summed to this radius; 0.5% of the flux is beyond
_RINGS = 4000


@dataclass(frozen=True, eq=False)
class Shapes:
    """Shapes of n objects.

    `fraction` (n, 2): of the flux, in disk and bulge; `radius` (n, 2, 2) px: r_e |M_i| of each axis (ALONG, ACROSS) and
    component; `slant` (n,): M_x M_y / (|M_x| |M_y|) of their images, 0 along an axis; `image` (n,) bool: rendered from
    an image, which is treated as a disk. A point has fraction (1, 0) and radius 0.
    """

    fraction: FloatArray
    radius: FloatArray
    slant: FloatArray
    image: BoolArray

    @classmethod
    def points(cls, count: int) -> Self:
        """Return the shapes of points."""
        return cls(np.tile([1.0, 0.0], (count, 1)), np.zeros((count, 2, 2)), np.zeros(count), np.zeros(count, bool))

    @classmethod
    def of(cls, matrix: FloatArray, fraction: FloatArray, sizes: FloatArray, image: BoolArray | None = None) -> Self:
        """Return the Shapes of matrices (n, 2, 2) [px / arcsec], fractions (n, 2) and half-light radii (n, 2) [arcsec].

        image (n,) bool, or None: no object has an image.
        """
        norm = np.linalg.norm(matrix, axis=2)
        radius = norm[:, :, None] * sizes[:, None, :]
        slant = (matrix[:, 0] * matrix[:, 1]).sum(axis=1) / np.maximum(norm.prod(axis=1), 1e-300)
        radius = np.nan_to_num(np.where(fraction[:, None, :] > 0, radius, 0.0))
        image = np.zeros(len(fraction), bool) if image is None else image
        return cls(fraction, radius, np.nan_to_num(slant), image)


def psf_profile(cells: ArrayLike, per_pixel: int, axis: int, wing: Wing | None = None) -> FloatArray:
    """Return (4, len(OFFSETS)): the fraction of a point's total flux below OFFSETS.

    cells: (4, n, n) [y, x] integrals of the PSF, `per_pixel` along a pixel; wing: optics.scatter.halo.Wing beyond them,
    or None.
    """
    line = np.asarray(cells, float).sum(axis=1 if axis == ALONG else 2)
    half = line.shape[1] / 2 / per_pixel
    below = np.concatenate([np.zeros((4, 1)), np.cumsum(line, axis=1)], axis=1)
    out = below @ _spline(line.shape[1], per_pixel)
    return out if wing is None else out + _wing_below(wing, half)


@lru_cache
def _spline(n: int, per_pixel: int) -> FloatArray:
    """Return (n + 1, len(OFFSETS)): the weights of n + 1 even samples in their natural cubic spline at OFFSETS.

    The samples end at +-n / 2 / per_pixel; beyond, the spline is as at its ends.
    """
    position = np.clip((OFFSETS * per_pixel) + n / 2, 0, n)
    k = np.minimum(position.astype(int), n - 1)
    t = position - k
    offset_row = np.arange(len(OFFSETS))
    second_derivatives = np.zeros((n + 1, n + 1))  # 1 / step^2, per unit of each sample; 0 at the ends
    inner = 4 * np.eye(n - 1) + np.eye(n - 1, k=1) + np.eye(n - 1, k=-1)
    second_derivatives[1:-1] = np.linalg.solve(inner, 6 * np.diff(np.eye(n + 1), 2, axis=0))
    before = second_derivatives[k]
    after = second_derivatives[k + 1]
    out = before * ((1 - t) ** 3 - (1 - t))[:, None] / 6 + after * (t**3 - t)[:, None] / 6
    out[offset_row, k] += 1 - t
    out[offset_row, k + 1] += t
    return np.ascontiguousarray(out.T)


@lru_cache(maxsize=4)
def _wing_below(wing: Wing, half: float) -> FloatArray:
    """Return (4, len(OFFSETS)): the fraction of a point's flux in its wing, outside the square of side 2 `half`."""
    position = np.arange(HALF + 1.0)
    first = np.where(position < half, half, 1e-3)  # of the half line along which the wing is summed
    steps = np.geomspace(first, _WING, 200, axis=1)
    density = 2 * cast("FloatArray", np.trapezoid(wing.profile(np.hypot(position[:, None], steps)), steps))
    middle = 0.5 * (OFFSETS[1:] + OFFSETS[:-1])
    in_step = np.stack([np.interp(np.abs(middle), position, band) for band in density]) / PER_PX
    return np.concatenate([np.zeros((4, 1)), np.cumsum(in_step, axis=1)], axis=1)


@lru_cache
def _projected(index: float) -> tuple[FloatArray, FloatArray]:
    """Return (t, fraction of a Sersic profile's flux beyond t along an axis), t in half-light radii, rising from 0."""
    light = (np.arange(_RINGS) + 0.5) / _RINGS
    radius = radius_of(light, index)
    t = np.concatenate([[0.0], np.geomspace(1e-3, 1e3, 400)])
    return t, np.array([np.mean(0.5 - np.arcsin(np.minimum(v / radius, 1.0)) / np.pi) for v in t])


def sersic_steps(index: float, radius: float) -> FloatArray:
    """Return the flux of a collapsed Sersic profile in steps of 1 / PER_PX px centred on OFFSETS; radius > 0 in px."""
    t, fraction_beyond = _projected(index)
    edges = (np.arange(len(OFFSETS) + 1) - len(OFFSETS) / 2) / PER_PX
    fraction = np.interp(np.abs(edges) / radius, t, fraction_beyond)
    return np.diff(np.where(edges > 0, 1 - fraction, fraction))


def broadened(point: FloatArray, fractions: Iterable[float], radius: Iterable[float]) -> FloatArray:
    """Return the profile (4, n) of an object from that of a point; fractions, radii [px] (2,) of its components."""
    shape = np.zeros(len(OFFSETS))
    for index, fraction, size in zip((DISK, BULGE), fractions, radius, strict=True):
        if fraction > 0 and size > 0:
            shape += fraction * sersic_steps(index, size)
        elif fraction > 0:
            shape[len(shape) // 2] += fraction
    steps = np.diff(point, axis=1)
    n = steps.shape[1]
    # the convolution has n + len(shape) - 1 = 2 n steps
    convolved = np.fft.irfft(np.fft.rfft(steps, 2 * n) * np.fft.rfft(shape, 2 * n), 2 * n)
    return np.concatenate([np.zeros((len(point), 1)), np.cumsum(convolved[:, n // 2 : n // 2 + n], axis=1)], axis=1)


@overload
def band_position(wavelength: float, bands: FloatArray) -> tuple[int, float]: ...


@overload
def band_position(wavelength: FloatArray, bands: FloatArray) -> tuple[IntArray, FloatArray]: ...


def band_position(wavelength: Floats, bands: FloatArray) -> tuple[int | IntArray, Floats]:
    """Return (band, fraction): the profile at `wavelength` is 1 - fraction of that of `band` plus fraction of the next.

    wavelength, bands: angstrom.
    """
    position = np.interp(wavelength, bands, np.arange(len(bands)))
    band = np.minimum(position.astype(int), len(bands) - 2)
    return band, position - band


@numba.njit(cache=True)
def pixel_fractions(profile: FloatArray, band: IntArray, fraction: FloatArray, offset: FloatArray) -> FloatArray:
    """Return (n, rows): the fraction of a profile's flux in pixels at `offset` (n, rows) [px].

    profile (4, len(OFFSETS)); band, fraction (n,): of `band_position`.
    """
    out = np.empty(offset.shape)
    for i in range(offset.shape[0]):
        first = profile[band[i]]
        second = profile[band[i] + 1]
        one = 1.0 - fraction[i]
        other = fraction[i]
        for j in range(offset.shape[1]):
            low = _step_of(offset[i, j] - 0.5)
            high = _step_of(offset[i, j] + 0.5)
            below = -one * _interpolated(first, low) - other * _interpolated(second, low)
            out[i, j] = below + one * _interpolated(first, high) + other * _interpolated(second, high)
    return out


@numba.njit(inline="always")
def _step_of(offset: float) -> float:
    """Return the position of an offset [px] among OFFSETS."""
    return min(max((offset + HALF) * PER_PX, 0.0), len(OFFSETS) - 1.001)


@numba.njit(inline="always")
def _interpolated(profile: FloatArray, position: float) -> float:
    k = int(position)
    t = position - k
    return (1.0 - t) * profile[k] + t * profile[k + 1]
