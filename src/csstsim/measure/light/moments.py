"""Shapes: adaptive moments of sources and of the PSF at their positions, and ellipticities corrected for the PSF.

Adaptive moments (Bernstein & Jarvis 2002, AJ 123, 583; Hirata & Seljak 2003, MNRAS 343, 459: "HSM"): the elliptical
Gaussian whose weighted second moments are half its own, which is also its least-squares fit to the image. Shapes are
distortions, e1 = (Mxx - Myy)/(Mxx + Myy), e2 = 2 Mxy/(Mxx + Myy), |e| = (a2 - b2)/(a2 + b2), and sigma = det(M)^(1/4).

The pixels sample a star too coarsely: its adaptive Gaussian collapses onto one of them. So all moments, of source and
PSF alike, are those of the image smoothed with a round Gaussian of SMOOTH px. No image is actually smoothed: if r and
C are mean offset and moments of the pixels with the weight widened from M to V = M + SMOOTH^2, those of the smoothed
image are K r and K C K + SMOOTH^2 K, with K = M V^-1.

A pixel that cannot be used (saturated, bad, on another source's isophote, off the frame) takes the value of the fitted
Gaussian. The PSF is drawn and measured at the source's position within its pixel.

The correction is that of Bernstein & Jarvis with the kurtosis terms of Hirata & Seljak: in the frame where the PSF is
round, e is divided by the resolution R = 1 - T_psf/T (1 - p)(1 + o)/((1 + p)(1 - o)), with T = Mxx + Myy, and
p, o = <rho^4>/2 - 1 of PSF and source, 0 for a Gaussian. Exact for Gaussians. Left out: the light of neighbours
without an isophote, re-Gaussianisation, noise bias.
"""

import math
from typing import TypeAlias

import numba
import numpy as np

from csstsim.base.types import BoolArray, ComplexArray, FloatArray, IntArray
from csstsim.measure.detection.maps import BIN
from csstsim.measure.light.photometry import HALF, draw_psf

SMOOTH = 1.0  # px
REACH = 5.0  # sigma of the widened weight; beyond it the weight is below 4e-6
CONVERGED = 1e-5  # last step, relative to the size
MAX_STEPS = 100
MAX_GROWTH = 4.0  # of sigma from its start; a fit that grows beyond has run into its surroundings
MIN_USABLE = 0.5  # least share of the fitted, weighted light on usable pixels
RESOLUTION_MIN = 0.1  # below it noise and errors of the PSF model dominate the correction
SIZE_MIN = 0.8  # px: least sigma to start with, about a star's
_Symmetric: TypeAlias = tuple[float, float, float]  # a matrix: xx, xy, yy


@numba.njit(cache=True)
def _inverse(xx: float, xy: float, yy: float) -> _Symmetric:
    """Return the inverse of a symmetric matrix; such matrices are tuples (xx, xy, yy)."""
    det = xx * yy - xy * xy
    return yy / det, -xy / det, xx / det


@numba.njit(cache=True)
def _product(a: _Symmetric, b: _Symmetric) -> _Symmetric:
    """Return the product of symmetric matrices with common axes, symmetric too."""
    return a[0] * b[0] + a[1] * b[1], a[0] * b[1] + a[1] * b[2], a[1] * b[1] + a[2] * b[2]


@numba.njit(cache=True)
def _matrices(gauss: FloatArray, smooth: float) -> tuple[_Symmetric, _Symmetric, _Symmetric]:
    """Return (V^-1, K, inverse of the pixels' own Gaussian), each (xx, xy, yy), of `gauss` (5,): x, y, Mxx, Mxy, Myy.

    The own Gaussian is M less the smoothing, of which at most 0.7 of the short axis squared is taken.
    """
    xx = gauss[2]
    xy = gauss[3]
    yy = gauss[4]
    s2 = smooth * smooth
    wide = _inverse(xx + s2, xy, yy + s2)
    short = 0.5 * (xx + yy) - math.hypot(0.5 * (xx - yy), xy)
    t = min(s2, 0.7 * short)
    return wide, (1.0 - s2 * wide[0], -s2 * wide[1], 1.0 - s2 * wide[2]), _inverse(xx - t, xy, yy - t)


@numba.njit(cache=True)
def _trace(a: _Symmetric, b: _Symmetric) -> float:
    """Return the trace of the product of two symmetric matrices."""
    return a[0] * b[0] + 2.0 * a[1] * b[1] + a[2] * b[2]


@numba.njit(cache=True)
def _quadratic(m: _Symmetric, dx: float, dy: float) -> float:
    return m[0] * dx * dx + 2.0 * m[1] * dx * dy + m[2] * dy * dy


@numba.njit(cache=True)
def _within(inverse: _Symmetric, x: float, dy: float) -> tuple[int, int]:
    """Return the columns, first and last (half-open), where rho^2 <= REACH^2 in the row at `dy` from the centre."""
    a, b, c = inverse
    middle = -b * dy / a
    half = math.sqrt(max((b * b - a * c) * dy * dy + a * REACH * REACH, 0.0)) / a
    return math.ceil(x + middle - half), math.floor(x + middle + half) + 1


@numba.njit(cache=True)
def _add_row(
    sums: FloatArray, square: _Symmetric, dy: float, one: float, two: float, three: float, four: float, five: float
) -> None:
    """Add to `sums` (7,) those of a row at `dy`: of light, light x dx, ..., light x dx^4."""
    a = square[0]
    b = 2.0 * square[1] * dy
    c = square[2] * dy * dy
    sums[0] += one
    sums[1] += two
    sums[2] += one * dy
    sums[3] += three
    sums[4] += two * dy
    sums[5] += one * dy * dy
    sums[6] += a * a * five + 2.0 * a * b * four + (b * b + 2.0 * a * c) * three + 2.0 * b * c * two + c * c * one


@numba.njit(cache=True)
def _sums(
    image: FloatArray,
    unusable: IntArray,
    segments: IntArray,
    number: int,
    gauss: FloatArray,
    smooth: float,
    out: FloatArray,
) -> tuple[float, float, float]:
    """Fill `out` (6,): means of dx, dy, dx^2, dx dy, dy^2, (r K V^-1 r)^2 with the widened weight.

    Returns (light, amplitude, usable share); light: sum of weight times image, amplitude: of the own Gaussian.
    """
    x = gauss[0]
    y = gauss[1]
    ny, nx = image.shape
    inverse, k, own = _matrices(gauss, smooth)
    square = _product(k, inverse)
    reach_y = REACH * math.sqrt(gauss[4] + smooth * smooth)
    seen = np.zeros(7)
    missing = np.zeros(7)
    bend = math.exp(-inverse[0])
    for row in range(math.ceil(y - reach_y), math.floor(y + reach_y) + 1):
        dy = row - y
        first, last = _within(inverse, x, dy)
        # The weight exp(-rho^2 / 2) from column to column: its ratio changes by a constant factor
        weight = math.exp(-0.5 * _quadratic(inverse, first - x, dy))
        ratio = math.exp(-inverse[0] * (first - x + 0.5) - inverse[1] * dy)
        # sums of light, light x dx, ..., light x dx^4
        one = 0.0
        two = 0.0
        three = 0.0
        four = 0.0
        five = 0.0
        for col in range(first, last):
            dx = col - x
            good = 0 <= row < ny and 0 <= col < nx and not unusable[row, col]
            other = segments[row // BIN, col // BIN] if good else 0
            if good and (other == number or other <= 0):
                light = weight * image[row, col]
                one += light
                two += light * dx
                three += light * (dx * dx)
                four += light * (dx * dx * dx)
                five += light * (dx * dx) ** 2
            else:
                light = weight * math.exp(-0.5 * _quadratic(own, dx, dy))
                _add_row(missing, square, dy, light, light * dx, light * dx**2, light * dx**3, light * dx**4)
            weight *= ratio
            ratio *= bend
        _add_row(seen, square, dy, one, two, three, four, five)
    both = inverse[0] + own[0], inverse[1] + own[1], inverse[2] + own[2]
    complete = 2.0 * math.pi / math.sqrt(both[0] * both[2] - both[1] ** 2)
    share = 1.0 - missing[0] / complete
    amplitude = seen[0] / (complete - missing[0]) if share > 0.0 else 0.0
    light = seen[0] + amplitude * missing[0]
    for i in range(6):
        out[i] = (seen[i + 1] + amplitude * missing[i + 1]) / light if light > 0.0 else 0.0
    return light, amplitude, share


@numba.njit(cache=True)
def _smoothed(means: FloatArray, gauss: FloatArray, smooth: float) -> tuple[float, float, float, float, float, float]:
    """Return (dx, dy, xx, xy, yy, kurtosis) of the smoothed image about `gauss`, from the pixels' `means` (6,)."""
    s2 = smooth * smooth
    inverse, k, _ = _matrices(gauss, smooth)
    dx = k[0] * means[0] + k[1] * means[1]
    dy = k[1] * means[0] + k[2] * means[1]
    c = means[2], means[3], means[4]
    xx = k[0] * k[0] * c[0] + 2.0 * k[0] * k[1] * c[1] + k[1] * k[1] * c[2]
    xy = k[0] * k[1] * c[0] + (k[0] * k[2] + k[1] * k[1]) * c[1] + k[1] * k[2] * c[2]
    yy = k[1] * k[1] * c[0] + 2.0 * k[1] * k[2] * c[1] + k[2] * k[2] * c[2]
    # rho^4 of the smoothed light: each K r is the centre of a Gaussian of covariance s2 K
    a = (s2 * inverse[0], s2 * inverse[1], s2 * inverse[2])
    b = _product(k, inverse)
    spread = a[0] + a[2]
    rho4 = means[5] + 2.0 * spread * _trace(b, c) + 4.0 * _trace(_product(a, b), c) + spread**2 + 2.0 * _trace(a, a)
    return dx, dy, xx + s2 * k[0] - dx * dx, xy + s2 * k[1] - dx * dy, yy + s2 * k[2] - dy * dy, 0.5 * rho4 - 1.0


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
    gauss: FloatArray,
) -> tuple[float, float, float]:
    """Fit an elliptical Gaussian, starting round at (x, y) px with `sigma` px; `smooth` px: the smoothing of the image.

    `image` (ny, nx); `unusable` (ny, nx), 0 for good; `segments`, on bins of BIN px: pixels of other sources than
    `number` are left out. Fills `gauss` (5,) with x, y, Mxx, Mxy, Myy. Returns (<rho^4>/2 - 1, light, amplitude);
    light, the weighted sum, is 0 where the fit failed: no positive light, too few usable pixels, too far from the
    start, too large, not converged.
    """
    means = np.empty(6)
    gauss[0] = x
    gauss[1] = y
    gauss[2] = sigma * sigma
    gauss[3] = 0.0
    gauss[4] = sigma * sigma
    largest = (MAX_GROWTH * sigma) ** 4
    for _ in range(MAX_STEPS):
        light, amplitude, share = _sums(image, unusable, segments, number, gauss, smooth, means)
        if not (light > 0.0 and share >= MIN_USABLE):
            break
        dx, dy, xx, xy, yy, kurtosis = _smoothed(means, gauss, smooth)
        if not (xx > 0.0 and yy > 0.0 and xx * yy > xy * xy):
            break
        # To first order the error is four times the excess for a Gaussian source; twice the moments is always safe
        size = gauss[2] + gauss[4]
        new_xx = 4.0 * xx - gauss[2]
        new_xy = 4.0 * xy - gauss[3]
        new_yy = 4.0 * yy - gauss[4]
        if new_xx + new_yy < 0.3 * size or new_xx * new_yy - new_xy**2 < 0.1 * (new_xx + new_yy) ** 2 / 4.0:
            new_xx = 2.0 * xx
            new_xy = 2.0 * xy
            new_yy = 2.0 * yy
        step = max(abs(new_xx - gauss[2]), abs(new_xy - gauss[3]), abs(new_yy - gauss[4])) / size
        if max(step, math.hypot(dx, dy) / math.sqrt(size)) < CONVERGED:
            return kurtosis, light, amplitude
        gauss[0] += 2.0 * dx
        gauss[1] += 2.0 * dy
        gauss[2] = new_xx
        gauss[3] = new_xy
        gauss[4] = new_yy
        if math.hypot(gauss[0] - x, gauss[1] - y) > 1.0 + sigma or new_xx * new_yy - new_xy**2 > largest:
            break
    return 0.0, 0.0, 0.0


@numba.njit(cache=True)
def _distortion_error(
    rms: FloatArray,
    unusable: IntArray,
    segments: IntArray,
    number: int,
    counted: float,
    gauss: FloatArray,
    smooth: float,
    fit: tuple[float, float, float],
) -> float:
    """Return the error of e1 and e2 (root of the mean square of both) from the noise of the pixels.

    `fit`: of adaptive_moments. A quadrupole q of the moments makes the Gaussian's own larger by 4 q / (1 - kurtosis).
    """
    kurtosis, light, amplitude = fit
    x, y, xx, xy, yy = gauss
    ny, nx = rms.shape
    s2 = smooth * smooth
    inverse, (kxx, kxy, kyy), own = _matrices(gauss, smooth)
    size = xx + yy
    e1 = (xx - yy) / size
    e2 = 2.0 * xy / size
    one_0 = s2 * (kxx - kyy - e1 * (kxx + kyy))
    two_0 = s2 * (2.0 * kxy - e2 * (kxx + kyy))
    reach_x = REACH * math.sqrt(xx + s2)
    reach_y = REACH * math.sqrt(yy + s2)
    total = 0.0
    for row in range(max(math.ceil(y - reach_y), 0), min(math.floor(y + reach_y) + 1, ny)):
        for col in range(max(math.ceil(x - reach_x), 0), min(math.floor(x + reach_x) + 1, nx)):
            other = segments[row // BIN, col // BIN]
            if unusable[row, col] or (other > 0 and other != number):
                continue
            dx = col - x
            dy = row - y
            w = math.exp(-0.5 * _quadratic(inverse, dx, dy))
            source = amplitude * math.exp(-0.5 * _quadratic(own, dx, dy))
            u = kxx * dx + kxy * dy
            v = kxy * dx + kyy * dy
            r2 = u * u + v * v
            one = u * u - v * v - e1 * r2 + one_0
            two = 2.0 * u * v - e2 * r2 + two_0
            total += w * w * (float(rms[row, col]) ** 2 + source / counted) * (one * one + two * two)
    return 4.0 / ((1.0 - kurtosis) * size * light) * math.sqrt(0.5 * total) if kurtosis < 1.0 else math.inf


@numba.njit(cache=True)
def measure_shapes(
    image: FloatArray,
    rms: FloatArray,
    unusable: IntArray,
    segments: IntArray,
    number: IntArray,
    x: FloatArray,
    y: FloatArray,
    size: FloatArray,
    wanted: BoolArray,
    counted: FloatArray,
    cell: IntArray,
    coefficients: FloatArray,
    per_pixel: int,
) -> FloatArray:
    """Measure sources and the PSF at their positions; all lengths px.

    `image`, `rms` float32, `unusable` uint8 (ny, nx); `segments` int32 on bins of BIN px; `number` (n,) of each
    source's own segment; `x`, `y`, `size` (n,) position and first guess of sigma; `wanted` (n,) bool: for the others
    only the PSF is measured; `counted`, `cell`, `coefficients`, `per_pixel` as in photometry.fit_sources.
    Returns (n, 11): x, y, sigma, e1, e2, kurtosis, error of e, then sigma, e1, e2, kurtosis of the PSF; NaN: failed.
    """
    result = np.full((x.size, 11), np.nan)
    stamp = np.empty((2 * HALF + 1, 2 * HALF + 1))
    clear = np.zeros(stamp.shape, np.uint8)
    alone = np.zeros(stamp.shape, np.int32)
    gauss = np.empty(5)
    for k in range(x.size):
        dx = x[k] - round(x[k])
        dy = y[k] - round(y[k])
        draw_psf(coefficients[cell[k]], per_pixel, dx, dy, HALF, stamp)
        start = math.hypot(SIZE_MIN, SMOOTH)
        fit = adaptive_moments(stamp, clear, alone, 0, HALF + dx, HALF + dy, start, SMOOTH, gauss)
        if fit[1] > 0.0:
            _write(gauss, result[k, 7:])
            result[k, 10] = fit[0]
        if not wanted[k]:
            continue
        start = math.hypot(max(size[k], SIZE_MIN), SMOOTH)
        fit = adaptive_moments(image, unusable, segments, number[k], x[k], y[k], start, SMOOTH, gauss)
        if fit[1] > 0.0:
            result[k, :2] = gauss[:2]
            _write(gauss, result[k, 2:])
            result[k, 5] = fit[0]
            result[k, 6] = _distortion_error(rms, unusable, segments, number[k], counted[k], gauss, SMOOTH, fit)
    return result


@numba.njit(cache=True)
def _write(gauss: FloatArray, out: FloatArray) -> None:
    xx, xy, yy = gauss[2:]
    out[0] = (xx * yy - xy * xy) ** 0.25
    out[1] = (xx - yy) / (xx + yy)
    out[2] = 2.0 * xy / (xx + yy)


def without_psf(shapes: FloatArray) -> tuple[ComplexArray, FloatArray, FloatArray]:
    """Return (distortion, error, resolution): e1 + i e2 (n,) without the PSF, pixel axes; error per axis.

    `shapes` (n, 11): from `measure_shapes`. The distortion is NaN unless it is below 1 and the resolution is
    RESOLUTION_MIN to 1.
    """
    _, _, sigma, e1, e2, kurtosis, noise, psf_sigma, psf_e1, psf_e2, psf_kurtosis = shapes.T
    e = e1 + 1j * e2
    psf = psf_e1 + 1j * psf_e2
    rounded = _sheared(e, -psf)
    # det(M) does not change with the frame: T = 2 sigma^2 / sqrt(1 - |e|^2) in each
    ratio = (psf_sigma / sigma) ** 2 * np.sqrt(1.0 - np.abs(rounded) ** 2)
    resolution = 1.0 - ratio * (1 - psf_kurtosis) / (1 + psf_kurtosis) * (1 + kurtosis) / (1 - kurtosis)
    resolved = (resolution > RESOLUTION_MIN) & (resolution <= 1.0)  # beyond: negative wings
    larger = np.where(resolved, rounded / np.where(resolved, resolution, 1.0), np.nan)
    possible = np.abs(larger) < 1.0
    e = np.where(possible, _sheared(np.where(possible, larger, 0.0), psf), np.nan)
    return e, np.where(possible, noise / np.where(resolved, resolution, 1.0), np.nan), resolution


@np.errstate(invalid="ignore")  # NaN in, NaN out
def _sheared(e: ComplexArray, by: ComplexArray) -> ComplexArray:
    """Return the distortion of an ellipse of distortion `e` after the shear that makes a circle into `by`, complex."""
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
