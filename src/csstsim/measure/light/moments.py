"""Shapes: adaptive moments of sources and of the PSF at their positions, and ellipticities corrected for the PSF.

Adaptive moments (Bernstein & Jarvis 2002, AJ 123, 583; Hirata & Seljak 2003, MNRAS 343, 459: "HSM"): the moments M of
the elliptical Gaussian such that, with it as weight, the second moments of the image are M / 2. It is also the
least-squares fit of a Gaussian to the image. Shapes are distortions, e1 = (Mxx - Myy)/(Mxx + Myy),
e2 = 2 Mxy/(Mxx + Myy), |e| = (a2 - b2)/(a2 + b2), and sigma = det(M)^(1/4).

The pixels sample a star too coarsely: its adaptive Gaussian collapses onto one of them. So all moments, of source and
PSF alike, are those of the image smoothed with a round Gaussian of SMOOTH px. No image is actually smoothed: if r and
C are mean offset and moments of the pixels with the weight widened from M to V = M + SMOOTH^2, those of the smoothed
image are K r and K C K + SMOOTH^2 K, with K = M V^-1.

A pixel that cannot be used (saturated, bad, on another source's isophote, off the frame) gets the value of the fitted
Gaussian. The PSF is sampled and measured at the source's position within its pixel.

The correction is that of Bernstein & Jarvis with the kurtosis terms of Hirata & Seljak: in the frame where the PSF is
round, e is divided by the resolution R = 1 - T_psf/T (1 - p)(1 + o)/((1 + p)(1 - o)), with T = Mxx + Myy, and
p, o = <rho^4>/2 - 1 of PSF and source, 0 for a Gaussian. Exact for Gaussians. Left out: the light of neighbours
without an isophote, re-Gaussianisation, noise bias.
"""

import math
from typing import NamedTuple

import numba
import numpy as np

from csstsim.base.types import BoolArray, ComplexArray, FloatArray, IntArray
from csstsim.measure.detection.maps import BIN
from csstsim.measure.light.photometry import HALF, SourcePsfs, render_psf
from csstsim.measure.light.pixels import Pixels

SMOOTH = 1.0  # px
REACH = 5.0  # sigma of the widened weight; beyond it the weight is below 4e-6
CONVERGED = 1e-5  # last step, relative to the size
MAX_STEPS = 100
MAX_GROWTH = 4.0  # of sigma from its start; a fit that grows more includes its surroundings
MIN_USABLE = 0.5  # fraction of the fitted, weighted flux on usable pixels
RESOLUTION_MIN = 0.1  # below it noise and errors of the PSF model dominate the correction
SIZE_MIN = 0.8  # px: minimum sigma to start with, about a star's


class Symmetric(NamedTuple):
    """A symmetric matrix."""

    xx: float
    xy: float
    yy: float


class Gaussian(NamedTuple):
    """An elliptical Gaussian: position [px] and second moments [px^2]."""

    x: float
    y: float
    xx: float
    xy: float
    yy: float


class AdaptiveFit(NamedTuple):
    """The adaptive Gaussian of a source and its kurtosis <rho^4>/2 - 1.

    `flux`: sum of weight times image, 0 where the fit failed; `amplitude` of the Gaussian, electron / px.
    """

    gaussian: Gaussian
    kurtosis: float
    flux: float
    amplitude: float


class AdaptiveShapes(NamedTuple):
    """Adaptive shapes (n,): `sigma` det(M)^(1/4) px, distortions `e1`, `e2`, `kurtosis`; NaN: failed."""

    sigma: FloatArray
    e1: FloatArray
    e2: FloatArray
    kurtosis: FloatArray


class MeasuredShapes(NamedTuple):
    """Positions `x`, `y` (n,) px, shapes of `source` and `psf`, `error` (n,) of the source's e1 and e2; NaN: failed."""

    x: FloatArray
    y: FloatArray
    source: AdaptiveShapes
    error: FloatArray
    psf: AdaptiveShapes


class CorrectedShapes(NamedTuple):
    """Shapes (n,) without the PSF: complex distortion `e`, its `error` on an axis, `resolution`."""

    e: ComplexArray
    error: FloatArray
    resolution: FloatArray


class _Matrices(NamedTuple):
    """V^-1 of the widened weight, K of the smoothed image, and the inverse of the Gaussian in the unsmoothed pixels."""

    inverse: Symmetric
    smoothed: Symmetric
    pixel_gaussian: Symmetric


class _Sums(NamedTuple):
    """Sums over the pixels with the widened weight.

    `flux`: of weight times image; `amplitude`: of the Gaussian in the pixels; `usable`: fraction of its flux on usable
    pixels; then the means of dx, dy, dx^2, dx dy, dy^2 and (r K V^-1 r)^2.
    """

    flux: float
    amplitude: float
    usable: float
    dx: float
    dy: float
    xx: float
    xy: float
    yy: float
    quartic: float


class _SmoothedMoments(NamedTuple):
    """Mean offset [px], second moments [px^2] about it and kurtosis of the smoothed image."""

    dx: float
    dy: float
    xx: float
    xy: float
    yy: float
    kurtosis: float


@numba.njit(cache=True)
def _inverse(xx: float, xy: float, yy: float) -> Symmetric:
    """Return the inverse of a symmetric matrix."""
    det = xx * yy - xy * xy
    return Symmetric(yy / det, -xy / det, xx / det)


@numba.njit(cache=True)
def _product(a: Symmetric, b: Symmetric) -> Symmetric:
    """Return the product of symmetric matrices with common axes, symmetric too."""
    return Symmetric(a.xx * b.xx + a.xy * b.xy, a.xx * b.xy + a.xy * b.yy, a.xy * b.xy + a.yy * b.yy)


@numba.njit(cache=True)
def _matrices(gauss: Gaussian, smooth: float) -> _Matrices:
    """Return the matrices of a Gaussian and the smoothing [px].

    The Gaussian in the pixels is M minus the smoothing, of which at most 0.7 of the minor axis squared is subtracted.
    """
    xx = gauss.xx
    xy = gauss.xy
    yy = gauss.yy
    s2 = smooth * smooth
    widened = _inverse(xx + s2, xy, yy + s2)
    minor = 0.5 * (xx + yy) - math.hypot(0.5 * (xx - yy), xy)
    t = min(s2, 0.7 * minor)
    smoothed = Symmetric(1.0 - s2 * widened.xx, -s2 * widened.xy, 1.0 - s2 * widened.yy)
    return _Matrices(widened, smoothed, _inverse(xx - t, xy, yy - t))


@numba.njit(cache=True)
def _trace(a: Symmetric, b: Symmetric) -> float:
    """Return the trace of the product of two symmetric matrices."""
    return a.xx * b.xx + 2.0 * a.xy * b.xy + a.yy * b.yy


@numba.njit(cache=True)
def _quadratic(m: Symmetric, dx: float, dy: float) -> float:
    return m.xx * dx * dx + 2.0 * m.xy * dx * dy + m.yy * dy * dy


@numba.njit(cache=True)
def _within(inverse: Symmetric, x: float, dy: float) -> tuple[int, int]:
    """Return the columns, first and last (half-open), where rho^2 <= REACH^2 in the row at `dy` from the centre."""
    a, b, c = inverse
    middle = -b * dy / a
    half = math.sqrt(max((b * b - a * c) * dy * dy + a * REACH * REACH, 0.0)) / a
    return math.ceil(x + middle - half), math.floor(x + middle + half) + 1


@numba.njit(cache=True)
def _add_row(
    sums: FloatArray, metric: Symmetric, dy: float, row_0: float, row_1: float, row_2: float, row_3: float, row_4: float
) -> None:
    """Add a row at `dy` to `sums` (7,): of the weighted flux, and of it times the quantities whose means are in _Sums.

    `row_0` to `row_4`: the row's sums of flux, flux x dx, ..., flux x dx^4; `metric`: K V^-1.
    """
    a = metric.xx
    b = 2.0 * metric.xy * dy
    c = metric.yy * dy * dy
    sums[0] += row_0
    sums[1] += row_1
    sums[2] += row_0 * dy
    sums[3] += row_2
    sums[4] += row_1 * dy
    sums[5] += row_0 * dy * dy
    sums[6] += a * a * row_4 + 2.0 * a * b * row_3 + (b * b + 2.0 * a * c) * row_2 + 2.0 * b * c * row_1 + c * c * row_0


@numba.njit(cache=True)
def _sums(
    image: FloatArray, unusable: IntArray, segments: IntArray, number: int, gauss: Gaussian, smooth: float
) -> _Sums:
    x = gauss.x
    y = gauss.y
    ny, nx = image.shape
    inverse, smoothed, pixel_gaussian = _matrices(gauss, smooth)
    metric = _product(smoothed, inverse)
    reach_y = REACH * math.sqrt(gauss.yy + smooth * smooth)
    measured = np.zeros(7)
    missing = np.zeros(7)
    ratio_change = math.exp(-inverse.xx)
    for row in range(math.ceil(y - reach_y), math.floor(y + reach_y) + 1):
        dy = row - y
        first, last = _within(inverse, x, dy)
        # The weight exp(-rho^2 / 2) from column to column: its ratio changes by a constant factor
        weight = math.exp(-0.5 * _quadratic(inverse, first - x, dy))
        ratio = math.exp(-inverse.xx * (first - x + 0.5) - inverse.xy * dy)
        # sums of flux, flux x dx, ..., flux x dx^4
        row_0 = 0.0
        row_1 = 0.0
        row_2 = 0.0
        row_3 = 0.0
        row_4 = 0.0
        for col in range(first, last):
            dx = col - x
            good = 0 <= row < ny and 0 <= col < nx and not unusable[row, col]
            isophote = segments[row // BIN, col // BIN] if good else 0
            if good and (isophote == number or isophote <= 0):
                flux = weight * image[row, col]
                row_0 += flux
                row_1 += flux * dx
                row_2 += flux * (dx * dx)
                row_3 += flux * (dx * dx * dx)
                row_4 += flux * (dx * dx) ** 2
            else:
                flux = weight * math.exp(-0.5 * _quadratic(pixel_gaussian, dx, dy))
                _add_row(missing, metric, dy, flux, flux * dx, flux * dx**2, flux * dx**3, flux * dx**4)
            weight *= ratio
            ratio *= ratio_change
        _add_row(measured, metric, dy, row_0, row_1, row_2, row_3, row_4)
    combined = Symmetric(inverse.xx + pixel_gaussian.xx, inverse.xy + pixel_gaussian.xy, inverse.yy + pixel_gaussian.yy)
    integral = 2.0 * math.pi / math.sqrt(combined.xx * combined.yy - combined.xy**2)
    usable = 1.0 - missing[0] / integral
    amplitude = measured[0] / (integral - missing[0]) if usable > 0.0 else 0.0
    flux = measured[0] + amplitude * missing[0]
    for i in range(7):  # in place: temporary arrays cost a fifth of the time
        measured[i] = (measured[i] + amplitude * missing[i]) / flux if flux > 0.0 else 0.0
    _, dx, dy, xx, xy, yy, quartic = measured
    return _Sums(flux, amplitude, usable, dx, dy, xx, xy, yy, quartic)


@numba.njit(cache=True)
def _smoothed(means: _Sums, gauss: Gaussian, smooth: float) -> _SmoothedMoments:
    """Return the moments of the smoothed image about `gauss`, from the pixels' `means`."""
    s2 = smooth * smooth
    inverse, k, _ = _matrices(gauss, smooth)
    dx = k.xx * means.dx + k.xy * means.dy
    dy = k.xy * means.dx + k.yy * means.dy
    c = Symmetric(means.xx, means.xy, means.yy)
    xx = k.xx * k.xx * c.xx + 2.0 * k.xx * k.xy * c.xy + k.xy * k.xy * c.yy
    xy = k.xx * k.xy * c.xx + (k.xx * k.yy + k.xy * k.xy) * c.xy + k.xy * k.yy * c.yy
    yy = k.xy * k.xy * c.xx + 2.0 * k.xy * k.yy * c.xy + k.yy * k.yy * c.yy
    # rho^4 of the smoothed image: each K r is the centre of a Gaussian of covariance s2 K
    a = Symmetric(s2 * inverse.xx, s2 * inverse.xy, s2 * inverse.yy)
    b = _product(k, inverse)
    spread = a.xx + a.yy
    rho4 = (
        means.quartic + 2.0 * spread * _trace(b, c) + 4.0 * _trace(_product(a, b), c) + spread**2 + 2.0 * _trace(a, a)
    )
    return _SmoothedMoments(
        dx, dy, xx + s2 * k.xx - dx * dx, xy + s2 * k.xy - dx * dy, yy + s2 * k.yy - dy * dy, 0.5 * rho4 - 1.0
    )


@numba.njit(cache=True)
def adaptive_moments(
    image: FloatArray,
    unusable: IntArray,
    segments: IntArray,
    number: int,
    x: float,
    y: float,
    sigma: float,
    smooth: float,
) -> AdaptiveFit:
    """Fit an elliptical Gaussian, starting round at (x, y) px with `sigma` px; `smooth` px: the smoothing of the image.

    `image` (ny, nx); `unusable` (ny, nx), 0 for good; `segments`, on bins of BIN px: pixels of other sources than
    `number` are left out. The fit fails without positive flux, with too few usable pixels, too far from the start, if
    it is too large, or does not converge.
    """
    gauss = Gaussian(float(x), float(y), sigma * sigma, 0.0, sigma * sigma)
    largest = (MAX_GROWTH * sigma) ** 4
    for _ in range(MAX_STEPS):
        sums = _sums(image, unusable, segments, number, gauss, smooth)
        if not (sums.flux > 0.0 and sums.usable >= MIN_USABLE):
            break
        dx, dy, xx, xy, yy, kurtosis = _smoothed(sums, gauss, smooth)
        if not (xx > 0.0 and yy > 0.0 and xx * yy > xy * xy):
            break
        # To first order the error is four times the excess for a Gaussian source; twice the moments is always safe
        size = gauss.xx + gauss.yy
        new_xx = 4.0 * xx - gauss.xx
        new_xy = 4.0 * xy - gauss.xy
        new_yy = 4.0 * yy - gauss.yy
        if new_xx + new_yy < 0.3 * size or new_xx * new_yy - new_xy**2 < 0.1 * (new_xx + new_yy) ** 2 / 4.0:
            new_xx = 2.0 * xx
            new_xy = 2.0 * xy
            new_yy = 2.0 * yy
        step = max(abs(new_xx - gauss.xx), abs(new_xy - gauss.xy), abs(new_yy - gauss.yy)) / size
        if max(step, math.hypot(dx, dy) / math.sqrt(size)) < CONVERGED:
            return AdaptiveFit(gauss, kurtosis, sums.flux, sums.amplitude)
        gauss = Gaussian(gauss.x + 2.0 * dx, gauss.y + 2.0 * dy, new_xx, new_xy, new_yy)
        if math.hypot(gauss.x - x, gauss.y - y) > 1.0 + sigma or new_xx * new_yy - new_xy**2 > largest:
            break
    return AdaptiveFit(gauss, 0.0, 0.0, 0.0)


@numba.njit(cache=True)
def _distortion_error(pixels: Pixels, number: int, counted: float, fit: AdaptiveFit, smooth: float) -> float:
    """Return the error of e1 and e2 (root of the mean square of both) from the noise of the pixels.

    A quadrupole q of the measured moments changes the moments of the Gaussian by 4 q / (1 - kurtosis).
    """
    gauss, kurtosis, flux, amplitude = fit
    x, y, xx, xy, yy = gauss
    rms = pixels.rms
    unusable = pixels.unusable
    segments = pixels.segments
    ny, nx = pixels.image.shape
    s2 = smooth * smooth
    inverse, smoothed, pixel_gaussian = _matrices(gauss, smooth)
    kxx, kxy, kyy = smoothed
    size = xx + yy
    e1 = (xx - yy) / size
    e2 = 2.0 * xy / size
    smoothed_1 = s2 * (kxx - kyy - e1 * (kxx + kyy))
    smoothed_2 = s2 * (2.0 * kxy - e2 * (kxx + kyy))
    reach_x = REACH * math.sqrt(xx + s2)
    reach_y = REACH * math.sqrt(yy + s2)
    total = 0.0
    for row in range(max(math.ceil(y - reach_y), 0), min(math.floor(y + reach_y) + 1, ny)):
        for col in range(max(math.ceil(x - reach_x), 0), min(math.floor(x + reach_x) + 1, nx)):
            isophote = segments[row // BIN, col // BIN]
            if unusable[row, col] or (isophote > 0 and isophote != number):
                continue
            dx = col - x
            dy = row - y
            w = math.exp(-0.5 * _quadratic(inverse, dx, dy))
            source = amplitude * math.exp(-0.5 * _quadratic(pixel_gaussian, dx, dy))
            u = kxx * dx + kxy * dy
            v = kxy * dx + kyy * dy
            r2 = u * u + v * v
            q1 = u * u - v * v - e1 * r2 + smoothed_1
            q2 = 2.0 * u * v - e2 * r2 + smoothed_2
            total += w * w * (float(rms[row // BIN, col // BIN]) ** 2 + source / counted) * (q1 * q1 + q2 * q2)
    return 4.0 / ((1.0 - kurtosis) * size * flux) * math.sqrt(0.5 * total) if kurtosis < 1.0 else math.inf


@numba.njit(cache=True)
def measure_shapes(
    pixels: Pixels,
    number: IntArray,
    x: FloatArray,
    y: FloatArray,
    size: FloatArray,
    wanted: BoolArray,
    counted: FloatArray,
    psf: SourcePsfs,
) -> MeasuredShapes:
    """Measure sources and the PSF at their positions; all lengths px.

    `number` (n,): isophote of each source; `x`, `y`, `size` (n,): position and first guess of sigma; `wanted` (n,)
    bool: for the others only the PSF is measured; `counted` (n,) as in photometry.fit_sources.
    """
    n = x.size
    shapes = MeasuredShapes(np.full(n, np.nan), np.full(n, np.nan), _unknown(n), np.full(n, np.nan), _unknown(n))
    stamp = np.empty((2 * HALF + 1, 2 * HALF + 1))
    all_usable = np.zeros(stamp.shape, np.uint8)
    no_isophotes = np.zeros(stamp.shape, np.int32)
    none = no_isophotes[0]
    for k in range(n):
        dx = x[k] - round(x[k])
        dy = y[k] - round(y[k])
        render_psf(psf.coefficients[psf.cell[k]], psf.per_pixel, dx, dy, stamp)
        start = math.hypot(SIZE_MIN, SMOOTH)
        image = stamp.astype(np.float32)  # as the frame and its numbers: one compiled version
        fit = adaptive_moments(image, all_usable, no_isophotes, none[0], HALF + dx, HALF + dy, start, SMOOTH)
        if fit.flux > 0.0:
            _write(fit, shapes.psf, k)
        if not wanted[k]:
            continue
        start = math.hypot(max(size[k], SIZE_MIN), SMOOTH)
        fit = adaptive_moments(pixels.image, pixels.unusable, pixels.segments, number[k], x[k], y[k], start, SMOOTH)
        if fit.flux > 0.0:
            shapes.x[k] = fit.gaussian.x
            shapes.y[k] = fit.gaussian.y
            _write(fit, shapes.source, k)
            shapes.error[k] = _distortion_error(pixels, number[k], counted[k], fit, SMOOTH)
    return shapes


@numba.njit(cache=True)
def _unknown(count: int) -> AdaptiveShapes:
    """Return the shapes of `count` sources, all NaN."""
    return AdaptiveShapes(
        np.full(count, np.nan), np.full(count, np.nan), np.full(count, np.nan), np.full(count, np.nan)
    )


@numba.njit(cache=True)
def _write(fit: AdaptiveFit, shapes: AdaptiveShapes, k: int) -> None:
    """Write the shape of a fit to row k of `shapes`."""
    _, _, xx, xy, yy = fit.gaussian
    shapes.sigma[k] = (xx * yy - xy * xy) ** 0.25
    shapes.e1[k] = (xx - yy) / (xx + yy)
    shapes.e2[k] = 2.0 * xy / (xx + yy)
    shapes.kurtosis[k] = fit.kurtosis


def without_psf(shapes: MeasuredShapes) -> CorrectedShapes:
    """Return shapes without the PSF, on pixel axes.

    The distortion is NaN unless it is below 1 and the resolution is RESOLUTION_MIN to 1.
    """
    sigma, e1, e2, kurtosis = shapes.source
    psf_sigma, psf_e1, psf_e2, psf_kurtosis = shapes.psf
    e = e1 + 1j * e2
    psf = psf_e1 + 1j * psf_e2
    rounded = _sheared(e, -psf)
    # det(M) does not change with the frame: T = 2 sigma^2 / sqrt(1 - |e|^2) in each
    ratio = (psf_sigma / sigma) ** 2 * np.sqrt(1.0 - np.abs(rounded) ** 2)
    resolution = 1.0 - ratio * (1 - psf_kurtosis) / (1 + psf_kurtosis) * (1 + kurtosis) / (1 - kurtosis)
    resolved = (resolution > RESOLUTION_MIN) & (resolution <= 1.0)  # beyond: negative wings
    corrected = np.where(resolved, rounded / np.where(resolved, resolution, 1.0), np.nan)
    possible = np.abs(corrected) < 1.0
    e = np.where(possible, _sheared(np.where(possible, corrected, 0.0), psf), np.nan)
    error = np.where(possible, shapes.error / np.where(resolved, resolution, 1.0), np.nan)
    return CorrectedShapes(e, error, resolution)


@np.errstate(invalid="ignore")  # NaN in, NaN out
def _sheared(e: ComplexArray, by: ComplexArray) -> ComplexArray:
    """Return the complex distortion of an ellipse of distortion `e` after the shear that turns a circle into `by`."""
    # M' = S M S with S = (1 + g-matrix); in terms of the reduced shear the law is a Moebius map
    g = reduced(e)
    s = reduced(by)
    g = (g + s) / (1.0 + np.conj(s) * g)
    return 2.0 * g / (1.0 + np.abs(g) ** 2)


@np.errstate(invalid="ignore")  # NaN in, NaN out
def reduced(e: ComplexArray) -> ComplexArray:
    """Return the ellipticity |g| = (a - b)/(a + b) of distortions |e| = (a2 - b2)/(a2 + b2), complex."""
    return e / (1.0 + np.sqrt(1.0 - np.abs(e) ** 2))


@np.errstate(invalid="ignore")  # NaN in, NaN out
def on_sky(e: ComplexArray, jacobian: FloatArray) -> ComplexArray:
    """Return complex distortions (n,) turned from pixel axes to east, north; `jacobian` (n, 2, 2) d(x, y)/d(e, n)."""
    shape = np.moveaxis(np.array([[1.0 + e.real, e.imag], [e.imag, 1.0 - e.real]]), -1, 0)
    inverse = np.linalg.inv(jacobian)
    sky = inverse @ shape @ np.swapaxes(inverse, -1, -2)
    return (sky[:, 0, 0] - sky[:, 1, 1] + 2j * sky[:, 0, 1]) / (sky[:, 0, 0] + sky[:, 1, 1])
