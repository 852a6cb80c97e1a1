"""Light within Kron ellipses and circles, without the isophotes of other sources.

Kron photometry (Kron 1980; galaxies) is Source Extractor's automatic aperture: KRON_FACTOR Kron radii, at least
KRON_MIN_RADIUS. Aperture photometry is the flux in a circle of APERTURE, divided by the share of a point's light that
the PSF has in it. Pixels on the isophote of another source get the mean of the aperture's other pixels.

The sums are those of `sep` (Barbary 2016) with subpix=5. Its functions need the numbers of isophotes at full size, and
to fill such a map of a whole frame takes longer than the sums.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numba
import numpy as np

from csstsim.base.types import BoolArray, FloatArray, IntArray
from csstsim.measure.detection.maps import BIN

if TYPE_CHECKING:
    from csstsim.measure.detection.combine import Detections

# Source Extractor's PHOT_AUTOPARAMS; the radius in px
KRON_FACTOR = 2.5
KRON_MIN_RADIUS = 3.5
KRON_REACH = 6.0  # of the ellipse: where the Kron radius is measured
APERTURE = 4.0  # px, 0.3 arcsec: radius
SUBPIXELS = 5  # an edge pixel counts by those of its 5 x 5 parts whose middles are inside
_HALF_DIAGONAL = 0.7072  # px


def aperture_flux(found: Detections, counted: FloatArray, share: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return (flux, error) of `combine.Detections` in circles of APERTURE, divided by the PSF's `share` (n,) there.

    `counted` (n,) as in `photometry.fit_sources`; electrons.
    """
    radius = np.full(len(found.x), APERTURE)
    zero = np.zeros(len(found.x))
    flux, error = _flux(found, radius, radius, zero, counted)
    return flux / share, error / share


def kron_flux(found: Detections, counted: FloatArray) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Return (flux, error, failed) of `combine.Detections` in Kron apertures, electron; failed: minimum circle used.

    `counted` (n,) as in `photometry.fit_sources`.
    """
    a = found.a
    b = found.b
    theta = found.theta
    radius = kron_radius(found.image, found.segments, found.segment, found.x, found.y, a, b, theta)
    failed = ~(radius > 0)
    scale = np.where(failed, 0.0, np.minimum(KRON_FACTOR * np.nan_to_num(radius), KRON_FACTOR * KRON_REACH))
    small = scale * np.sqrt(a * b) < KRON_MIN_RADIUS
    axis_a = np.where(small, KRON_MIN_RADIUS, scale * a)
    axis_b = np.where(small, KRON_MIN_RADIUS, scale * b)
    return *_flux(found, axis_a, axis_b, theta, counted), failed


def _flux(
    found: Detections, a: FloatArray, b: FloatArray, theta: FloatArray, counted: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return (flux, error) within ellipses; the error has the source's own noise as counted."""
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
    """Return (n,): the first moment of the light within KRON_REACH of an ellipse, in its axes; 0 without light.

    `image` (ny, nx); `segments`: numbers of isophotes on bins of BIN px, `number` (n,) of each source's own, 0 for
    none; `x`, `y`, `a`, `b` px, `theta` rad (n,).
    """
    out = np.zeros(x.size)
    ny, nx = image.shape
    for s in range(x.size):
        if not (math.isfinite(x[s]) and math.isfinite(y[s])):
            continue
        xx, yy, xy = _coefficients(a[s], b[s], theta[s])
        light = 0.0
        moment = 0.0
        limit = KRON_REACH**2
        first, last = _rows(y[s], KRON_REACH * _height(a[s], b[s], theta[s]), ny)
        for row in range(first, last):
            dy = row - y[s]
            low, high = _columns(x[s], dy, xx, yy, xy, limit, nx)
            for col in range(low, high):
                other = segments[row // BIN, col // BIN]
                if other > 0 and other != number[s]:
                    continue
                dx = col - x[s]
                square = xx * dx * dx + yy * dy * dy + xy * dx * dy
                if square <= limit:
                    light += image[row, col]
                    moment += math.sqrt(square) * image[row, col]
        if light > 0.0 and moment > 0.0:
            out[s] = moment / light
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
    """Return (n, 2): light within ellipses and variance of the background there, electron; NaN where all is others'.

    Arrays as in `kron_radius`; `rms` (ny, nx).
    """
    out = np.zeros((x.size, 2))
    ny, nx = image.shape
    for s in range(x.size):
        if not (math.isfinite(x[s]) and math.isfinite(y[s])):
            out[s] = math.nan
            continue
        xx, yy, xy = _coefficients(a[s], b[s], theta[s])
        inner = max(1.0 - _HALF_DIAGONAL / b[s], 0.0) ** 2
        outer = (1.0 + _HALF_DIAGONAL / b[s]) ** 2
        light = 0.0
        variance = 0.0
        area = 0.0
        others = 0.0
        first, last = _rows(y[s], math.sqrt(outer) * _height(a[s], b[s], theta[s]), ny)
        for row in range(first, last):
            dy = row - y[s]
            low, high = _columns(x[s], dy, xx, yy, xy, outer, nx)
            for col in range(low, high):
                dx = col - x[s]
                square = xx * dx * dx + yy * dy * dy + xy * dx * dy
                share = 1.0
                if square > inner:
                    share = _share(dx, dy, xx, yy, xy) if square <= outer else 0.0
                other = segments[row // BIN, col // BIN]
                area += share
                if other > 0 and other != number[s]:
                    others += share
                else:
                    light += share * image[row, col]
                    variance += share * float(rms[row, col]) ** 2
        if others > 0.0:
            whole = area / (area - others) if area > others else math.nan
            light = whole * light
            variance = whole * variance
        out[s] = light, variance
    return out


@numba.njit(cache=True)
def _coefficients(a: float, b: float, theta: float) -> tuple[float, float, float]:
    """Return (xx, yy, xy): the ellipse is xx dx^2 + yy dy^2 + xy dx dy = 1."""
    c = math.cos(theta)
    s = math.sin(theta)
    return (c / a) ** 2 + (s / b) ** 2, (s / a) ** 2 + (c / b) ** 2, 2.0 * c * s * (a**-2.0 - b**-2.0)


@numba.njit(cache=True)
def _height(a: float, b: float, theta: float) -> float:
    """Return the distance of an ellipse's highest point from its middle."""
    return math.hypot(a * math.sin(theta), b * math.cos(theta))


@numba.njit(cache=True)
def _rows(y: float, reach: float, ny: int) -> tuple[int, int]:
    return max(math.ceil(y - reach), 0), min(math.floor(y + reach) + 1, ny)


@numba.njit(cache=True)
def _columns(x: float, dy: float, xx: float, yy: float, xy: float, limit: float, nx: int) -> tuple[int, int]:
    """Return the first column and the one after the last within xx dx^2 + yy dy^2 + xy dx dy = limit on a row."""
    middle = x - 0.5 * xy * dy / xx
    half = math.sqrt(max((limit - yy * dy * dy) / xx + (0.5 * xy * dy / xx) ** 2, 0.0))
    return max(math.ceil(middle - half), 0), min(math.floor(middle + half) + 1, nx)


@numba.njit(cache=True)
def _share(dx: float, dy: float, xx: float, yy: float, xy: float) -> float:
    """Return the share of a pixel's parts whose middles lie within the ellipse."""
    inside = 0
    for j in range(SUBPIXELS):
        v = dy + (j + 0.5) / SUBPIXELS - 0.5
        for i in range(SUBPIXELS):
            u = dx + (i + 0.5) / SUBPIXELS - 0.5
            inside += xx * u * u + yy * v * v + xy * u * v <= 1.0
    return inside / SUBPIXELS**2
