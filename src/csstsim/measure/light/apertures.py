"""Flux within Kron ellipses and circles, without the isophotes of other sources.

Kron photometry (Kron 1980; galaxies) is Source Extractor's automatic aperture: KRON_FACTOR Kron radii, at least
KRON_MIN_RADIUS. Aperture photometry is the flux in a circle of APERTURE, divided by the fraction of a point's flux in
it. Pixels on the isophote of another source get the mean of the aperture's other pixels.

The sums are those of `sep` (Barbary 2016) with subpix=5. Its functions need the numbers of isophotes at full size, and
to fill such a map of a whole frame takes longer than the sums.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numba
import numpy as np

from csstsim.base.types import BoolArray, FloatArray, IntArray
from csstsim.measure.detection.maps import BIN

if TYPE_CHECKING:
    from csstsim.measure.detection.combine import Detections

# Source Extractor's PHOT_AUTOPARAMS; the radius in px
KRON_FACTOR = 2.5
KRON_MIN_RADIUS = 3.5
KRON_REACH = 6.0  # in units of the ellipse: the Kron radius is measured within
APERTURE = 4.0  # px, 0.3 arcsec: radius
SUBPIXELS = 5  # an edge pixel counts by the fraction of its 5 x 5 parts whose middles are inside
_HALF_DIAGONAL = 0.7072  # px


class KronFlux(NamedTuple):
    """Fluxes in Kron apertures and their errors (n,) [electron]; failed (n,): the minimum circle was used."""

    flux: FloatArray
    error: FloatArray
    failed: BoolArray


class _Ellipse(NamedTuple):
    """The ellipse xx dx^2 + yy dy^2 + xy dx dy = 1, with dx, dy [px] from its centre."""

    xx: float
    yy: float
    xy: float


def aperture_flux(found: Detections, counted: FloatArray, fraction: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return (flux, error) (n,) [electron] of `combine.Detections` in circles of APERTURE, corrected to the total.

    `counted` (n,) as in `photometry.fit_sources`; `fraction` (n,): of a point's flux in the circle.
    """
    radius = np.full(len(found.x), APERTURE)
    zero = np.zeros(len(found.x))
    flux, error = _flux(found, radius, radius, zero, counted)
    return flux / fraction, error / fraction


def kron_flux(found: Detections, counted: FloatArray) -> KronFlux:
    """Return the KronFlux of `combine.Detections`; `counted` (n,) as in `photometry.fit_sources`."""
    a = found.a
    b = found.b
    theta = found.theta
    radius = kron_radius(found.image, found.segments, found.segment, found.x, found.y, a, b, theta)
    failed = ~(radius > 0)
    scale = np.where(failed, 0.0, np.minimum(KRON_FACTOR * np.nan_to_num(radius), KRON_FACTOR * KRON_REACH))
    small = scale * np.sqrt(a * b) < KRON_MIN_RADIUS
    axis_a = np.where(small, KRON_MIN_RADIUS, scale * a)
    axis_b = np.where(small, KRON_MIN_RADIUS, scale * b)
    return KronFlux(*_flux(found, axis_a, axis_b, theta, counted), failed)


def _flux(
    found: Detections, a: FloatArray, b: FloatArray, theta: FloatArray, counted: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return (flux, error) within ellipses; the error includes the Poisson noise of the counted flux."""
    sums = ellipse_sums(found.image, found.rms, found.segments, found.segment, found.x, found.y, a, b, theta)
    flux, variance = sums.T
    return flux, np.sqrt(variance + np.maximum(flux, 0.0) / counted)


@numba.njit(cache=True)
def kron_radius(
    image: FloatArray,
    segments: IntArray,
    number: IntArray,
    x: FloatArray,
    y: FloatArray,
    a: FloatArray,
    b: FloatArray,
    theta: FloatArray,
) -> FloatArray:
    """Return (n,): the first moment of the flux within KRON_REACH of an ellipse, in its units; 0 without flux.

    `image` (ny, nx); `segments`: numbers of isophotes on bins of BIN px; `number` (n,): that of each source, 0 for
    none; `x`, `y`, `a`, `b` px, `theta` rad (n,).
    """
    out = np.zeros(x.size)
    ny, nx = image.shape
    for s in range(x.size):
        if not (math.isfinite(x[s]) and math.isfinite(y[s])):
            continue
        ellipse = _ellipse(a[s], b[s], theta[s])
        xx, yy, xy = ellipse
        flux = 0.0
        moment = 0.0
        limit = KRON_REACH**2
        first, last = _rows(y[s], KRON_REACH * _height(a[s], b[s], theta[s]), ny)
        for row in range(first, last):
            dy = row - y[s]
            low, high = _columns(x[s], dy, ellipse, limit, nx)
            for col in range(low, high):
                other = segments[row // BIN, col // BIN]
                if other > 0 and other != number[s]:
                    continue
                dx = col - x[s]
                square = xx * dx * dx + yy * dy * dy + xy * dx * dy
                if square <= limit:
                    flux += image[row, col]
                    moment += math.sqrt(square) * image[row, col]
        if flux > 0.0 and moment > 0.0:
            out[s] = moment / flux
    return out


@numba.njit(cache=True)
def ellipse_sums(
    image: FloatArray,
    rms: FloatArray,
    segments: IntArray,
    number: IntArray,
    x: FloatArray,
    y: FloatArray,
    a: FloatArray,
    b: FloatArray,
    theta: FloatArray,
) -> FloatArray:
    """Return (n, 2): flux [electron] within ellipses and variance of the background there.

    Arrays as in `kron_radius`; `rms`: noise of a pixel, on bins of BIN px. NaN where all pixels are on isophotes of
    other sources.
    """
    out = np.zeros((x.size, 2))
    ny, nx = image.shape
    for s in range(x.size):
        if not (math.isfinite(x[s]) and math.isfinite(y[s])):
            out[s] = math.nan
            continue
        ellipse = _ellipse(a[s], b[s], theta[s])
        xx, yy, xy = ellipse
        inner = max(1.0 - _HALF_DIAGONAL / b[s], 0.0) ** 2
        outer = (1.0 + _HALF_DIAGONAL / b[s]) ** 2
        flux = 0.0
        variance = 0.0
        area = 0.0
        masked_area = 0.0
        first, last = _rows(y[s], math.sqrt(outer) * _height(a[s], b[s], theta[s]), ny)
        for row in range(first, last):
            dy = row - y[s]
            low, high = _columns(x[s], dy, ellipse, outer, nx)
            for col in range(low, high):
                dx = col - x[s]
                square = xx * dx * dx + yy * dy * dy + xy * dx * dy
                fraction = 1.0
                if square > inner:
                    fraction = _fraction_inside(dx, dy, ellipse) if square <= outer else 0.0
                other = segments[row // BIN, col // BIN]
                area += fraction
                if other > 0 and other != number[s]:
                    masked_area += fraction
                else:
                    flux += fraction * image[row, col]
                    variance += fraction * float(rms[row // BIN, col // BIN]) ** 2
        if masked_area > 0.0:
            completion = area / (area - masked_area) if area > masked_area else math.nan
            flux = completion * flux
            variance = completion * variance
        out[s] = flux, variance
    return out


@numba.njit(cache=True)
def _ellipse(a: float, b: float, theta: float) -> _Ellipse:
    """Return the ellipse of axes a, b [px] and position angle theta [rad]."""
    c = math.cos(theta)
    s = math.sin(theta)
    return _Ellipse((c / a) ** 2 + (s / b) ** 2, (s / a) ** 2 + (c / b) ** 2, 2.0 * c * s * (a**-2.0 - b**-2.0))


@numba.njit(cache=True)
def _height(a: float, b: float, theta: float) -> float:
    """Return half the height of an ellipse [px]."""
    return math.hypot(a * math.sin(theta), b * math.cos(theta))


@numba.njit(cache=True)
def _rows(y: float, reach: float, ny: int) -> tuple[int, int]:
    return max(math.ceil(y - reach), 0), min(math.floor(y + reach) + 1, ny)


@numba.njit(cache=True)
def _columns(x: float, dy: float, ellipse: _Ellipse, limit: float, nx: int) -> tuple[int, int]:
    """Return the columns, half-open, of a row where xx dx^2 + yy dy^2 + xy dx dy is at most `limit`."""
    xx, yy, xy = ellipse
    middle = x - 0.5 * xy * dy / xx
    half = math.sqrt(max((limit - yy * dy * dy) / xx + (0.5 * xy * dy / xx) ** 2, 0.0))
    return max(math.ceil(middle - half), 0), min(math.floor(middle + half) + 1, nx)


@numba.njit(cache=True)
def _fraction_inside(dx: float, dy: float, ellipse: _Ellipse) -> float:
    """Return the fraction of a pixel's parts whose middles lie within the ellipse."""
    xx, yy, xy = ellipse
    inside = 0
    for j in range(SUBPIXELS):
        v = dy + (j + 0.5) / SUBPIXELS - 0.5
        for i in range(SUBPIXELS):
            u = dx + (i + 0.5) / SUBPIXELS - 0.5
            inside += xx * u * u + yy * v * v + xy * u * v <= 1.0
    return inside / SUBPIXELS**2
