"""Profiles of light across, or along, a spectrum: the image of an object, collapsed onto one axis.

    P(t) = PSF collapsed * sum_k share_k S_k(t)         S_k: component k of the galaxy, collapsed

A Sersic component is circular before its shape matrix M [px / arcsec] is applied, so its projection onto axis i is that
of the circle with the radius r_e |M_i| (row i of M): exact for any ellipticity. Of a circle of radius R the share of
light below t is 1/2 + arcsin(t / R) / pi, averaged over radii of equal light. The PSF's box is summed; beyond it comes
the profile of the wing (optics.scatter.halo). Profiles are kept as the share of all light below t, at the PSF's four
wavelengths, on OFFSETS; between wavelengths they are interpolated linearly. Left out: that profiles differ between the
columns of a line (measure.spectra.line_image), light beyond HALF px of the axis.
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
_WING = 512.0  # px: how far wings are summed; 0.5% of the light lies beyond
_RINGS = 4000


@dataclass(frozen=True, eq=False)
class Shapes:
    """Sizes of n objects: `light` (n, 2) share of disk and bulge, `radius` (n, 2, 2) px, of each axis (ALONG, ACROSS)
    and component, r_e |M_i|; `slant` (n,) of their images, M_x M_y / (|M_x| |M_y|), 0 if they lie along an axis;
    `image` (n,) bool, drawn from an image, which is taken for a disk. A point has light (1, 0) and radius 0."""

    light: FloatArray
    radius: FloatArray
    slant: FloatArray
    image: BoolArray

    @classmethod
    def points(cls, count: int) -> Self:
        """Return the shapes of points."""
        return cls(np.tile([1.0, 0.0], (count, 1)), np.zeros((count, 2, 2)), np.zeros(count), np.zeros(count, bool))

    @classmethod
    def of(cls, matrix: FloatArray, light: FloatArray, sizes: FloatArray, image: BoolArray | None = None) -> Self:
        """Shapes of matrices (n, 2, 2) [px / arcsec], shares (n, 2) and half-light radii (n, 2) [arcsec]; image (n,),
        or None: nowhere."""
        norm = np.linalg.norm(matrix, axis=2)
        radius = norm[:, :, None] * sizes[:, None, :]
        slant = (matrix[:, 0] * matrix[:, 1]).sum(axis=1) / np.maximum(norm.prod(axis=1), 1e-300)
        radius = np.nan_to_num(np.where(light[:, None, :] > 0, radius, 0.0))
        image = np.zeros(len(light), bool) if image is None else image
        return cls(light, radius, np.nan_to_num(slant), image)


def psf_profile(cells: ArrayLike, per_pixel: int, axis: int, wing: Wing | None = None) -> FloatArray:
    """Return (4, len(OFFSETS)): the share of all light below OFFSETS of a point.

    cells: (4, n, n) [y, x] integrals of the PSF, `per_pixel` to a pixel; wing: optics.scatter.halo.Wing beyond them, or
    None.
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
    place = np.clip((OFFSETS * per_pixel) + n / 2, 0, n)
    k = np.minimum(place.astype(int), n - 1)
    t = place - k
    point = np.arange(len(OFFSETS))
    bent = np.zeros((n + 1, n + 1))  # second derivatives [1 / step^2] of the samples' units; none at the ends
    inner = 4 * np.eye(n - 1) + np.eye(n - 1, k=1) + np.eye(n - 1, k=-1)
    bent[1:-1] = np.linalg.solve(inner, 6 * np.diff(np.eye(n + 1), 2, axis=0))
    out = bent[k] * ((1 - t) ** 3 - (1 - t))[:, None] / 6 + bent[k + 1] * (t**3 - t)[:, None] / 6
    out[point, k] += 1 - t
    out[point, k + 1] += t
    return np.ascontiguousarray(out.T)


@lru_cache(maxsize=4)
def _wing_below(wing: Wing, half: float) -> FloatArray:
    """Return the same for a wing outside the square of side 2 `half`, counted from the first of OFFSETS."""
    place = np.arange(HALF + 1.0)
    first = np.where(place < half, half, 1e-3)  # of the half line along which the wing is summed
    steps = np.geomspace(first, _WING, 200, axis=1)
    density = 2 * cast("FloatArray", np.trapezoid(wing.profile(np.hypot(place[:, None], steps)), steps))
    middle = 0.5 * (OFFSETS[1:] + OFFSETS[:-1])
    each = np.stack([np.interp(np.abs(middle), place, band) for band in density]) / PER_PX
    return np.concatenate([np.zeros((4, 1)), np.cumsum(each, axis=1)], axis=1)


@lru_cache
def _projected(index: float) -> tuple[FloatArray, FloatArray]:
    """Return (t, share of a Sersic profile's light beyond t along an axis), t in half-light radii, rising from 0."""
    light = (np.arange(_RINGS) + 0.5) / _RINGS
    radius = radius_of(light, index)
    t = np.concatenate([[0.0], np.geomspace(1e-3, 1e3, 400)])
    return t, np.array([np.mean(0.5 - np.arcsin(np.minimum(v / radius, 1.0)) / np.pi) for v in t])


def sersic_steps(index: float, radius: float) -> FloatArray:
    """Return the light of a collapsed Sersic profile in steps of 1 / PER_PX px centred on OFFSETS; radius > 0 in px."""
    t, share_beyond = _projected(index)
    edges = (np.arange(len(OFFSETS) + 1) - len(OFFSETS) / 2) / PER_PX
    share = np.interp(np.abs(edges) / radius, t, share_beyond)
    return np.diff(np.where(edges > 0, 1 - share, share))


def broadened(point: FloatArray, light: Iterable[float], radius: Iterable[float]) -> FloatArray:
    """Return the profile of an object: that of a point (4, n), and light and radius (2,) px of its components."""
    shape = np.zeros(len(OFFSETS))
    for index, share, size in zip((DISK, BULGE), light, radius, strict=True):
        if share > 0 and size > 0:
            shape += share * sersic_steps(index, size)
        elif share > 0:
            shape[len(shape) // 2] += share
    steps = np.diff(point, axis=1)
    n = steps.shape[1]
    whole = np.fft.irfft(np.fft.rfft(steps, 2 * n) * np.fft.rfft(shape, 2 * n), 2 * n)  # of n + len(shape) - 1 = 2 n
    return np.concatenate([np.zeros((len(point), 1)), np.cumsum(whole[:, n // 2 : n // 2 + n], axis=1)], axis=1)


@overload
def mixed(wavelength: float, bands: FloatArray) -> tuple[int, float]: ...


@overload
def mixed(wavelength: FloatArray, bands: FloatArray) -> tuple[IntArray, FloatArray]: ...


def mixed(wavelength: Floats, bands: FloatArray) -> tuple[int | IntArray, Floats]:
    """Return (band, share): profiles at `wavelength` are (1 - share) of `band` and share of the next one."""
    place = np.interp(wavelength, bands, np.arange(len(bands)))
    band = np.minimum(place.astype(int), len(bands) - 2)
    return band, place - band


@numba.njit(cache=True)
def pixel_shares(profile: FloatArray, band: IntArray, share: FloatArray, offset: FloatArray) -> FloatArray:
    """Return (n, rows): the share of a profile's light in pixels at `offset` [px]; band, share (n,): of `mixed`."""
    out = np.empty(offset.shape)
    for i in range(offset.shape[0]):
        first = profile[band[i]]
        second = profile[band[i] + 1]
        one = 1.0 - share[i]
        other = share[i]
        for j in range(offset.shape[1]):
            low = _place(offset[i, j] - 0.5)
            high = _place(offset[i, j] + 0.5)
            light = -one * _at(first, low) - other * _at(second, low)
            out[i, j] = light + one * _at(first, high) + other * _at(second, high)
    return out


@numba.njit(inline="always")
def _place(offset: float) -> float:
    """Return where an offset [px] lies among OFFSETS."""
    return min(max((offset + HALF) * PER_PX, 0.0), len(OFFSETS) - 1.001)


@numba.njit(inline="always")
def _at(profile: FloatArray, place: float) -> float:
    k = int(place)
    rest = place - k
    return (1.0 - rest) * profile[k] + rest * profile[k + 1]
