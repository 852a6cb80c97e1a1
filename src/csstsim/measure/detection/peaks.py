"""Peaks of the matched-filter S/N: every pixel where a point source may be.

The image is smoothed with a round Gaussian, close to the PSF and a little wider (WIDTH_FACTOR), which suits a faint
galaxy better and a cosmic ray less. At each pixel the smoothed flux over its noise is the S/N that a source of the
Gaussian's shape would have there. A peak is a pixel that exceeds its eight neighbours and the threshold. Two Gaussian
passes along the axes need a fiftieth of the products of a convolution with the PSF, and give points 0.94 of its S/N.
"""

import math
from typing import NamedTuple

import numba
import numpy as np

from csstsim.base.types import FloatArray, IntArray
from csstsim.measure.calibration.bad_pixels import FULL
from csstsim.measure.detection.maps import BIN

WIDTH_FACTOR = 1.2  # of the Gaussian that suits the PSF best
_WIDTHS = np.linspace(0.5, 3.0, 101)  # px


class Peaks(NamedTuple):
    """Peaks (n,): position [px of the frame] and S/N."""

    x: FloatArray
    y: FloatArray
    snr: FloatArray


def smoothing_sigma(kernel: FloatArray) -> float:
    """Return the sigma [px] of the Gaussian for a PSF's stamp (n, n) on pixels, n odd."""
    axis = np.arange(len(kernel)) - len(kernel) // 2
    trial = np.exp(-0.5 * (axis / _WIDTHS[:, None]) ** 2)
    gain = np.einsum("kx,ky,yx->k", trial, trial, kernel) / (trial**2).sum(axis=1)
    return WIDTH_FACTOR * float(_WIDTHS[int(np.argmax(gain))])


def smoothing(kernel: FloatArray) -> FloatArray:
    """Return that Gaussian (2 r + 1,); its largest value is 1."""
    sigma = smoothing_sigma(kernel)
    reach = math.ceil(3.0 * sigma)
    return np.exp(-0.5 * (np.arange(-reach, reach + 1) / sigma) ** 2).astype(np.float32)


@numba.njit(cache=True)
def _next_row(
    image: FloatArray, hidden: IntArray, new_row: int, weight: FloatArray, line: FloatArray, out: FloatArray
) -> None:
    """Fill `out` with row `new_row` of `image` smoothed along x; 0 beyond the frame and where `hidden` has FULL."""
    ny, nx = image.shape
    reach = weight.size // 2
    out[:] = 0.0
    if new_row >= ny:
        return
    for x in range(nx):
        line[x + reach] = image[new_row, x]
    if hidden.size:
        for x in range(nx):
            if hidden[new_row, x] & FULL:
                line[x + reach] = 0.0
    for k in range(weight.size):
        w = weight[k]
        for x in range(nx):
            out[x] += w * line[x + k]


@numba.njit(cache=True)
def _row_of_snr(
    across: FloatArray, rms: FloatArray, y: int, weight: FloatArray, norm: np.float32, out: FloatArray
) -> None:
    """Fill `out` with the S/N of row y from the rows around it, smoothed along x: row v at v % weight.size.

    rms (nx,): noise of the row.
    """
    out[:] = 0.0
    for k in range(weight.size):
        w = weight[k]
        row = across[(y + k - weight.size // 2) % weight.size]
        for x in range(out.size):
            out[x] += w * row[x]
    for x in range(out.size):
        out[x] /= norm * rms[x]


@numba.njit(cache=True)
def smoothed_snr(image: FloatArray, rms: FloatArray, weight: FloatArray) -> FloatArray:
    """Return float32 (ny, nx): the S/N at each pixel of a source that is `weight` (2 r + 1,) along both axes."""
    ny, nx = image.shape
    reach = weight.size // 2
    norm = np.float32((weight**2).sum())
    out = np.empty((ny, nx), np.float32)
    across = np.zeros((weight.size, nx), np.float32)
    line = np.zeros(nx + 2 * reach, np.float32)
    none = np.empty((0, 0), np.uint8)
    for y in range(-reach, ny):
        new_row = y + reach
        _next_row(image, none, new_row, weight, line, across[new_row % weight.size])
        if y >= 0:
            _row_of_snr(across, rms[y], y, weight, norm, out[y])
    return out


@numba.njit(cache=True)
def find_peaks(image: FloatArray, rms: FloatArray, hidden: IntArray, weight: FloatArray, threshold: float) -> Peaks:
    """Return the Peaks above `threshold`, by rows.

    `image` float32 (ny, nx); `rms` float32: its noise, on bins of BIN px; `hidden` uint8 (ny, nx): the flux of pixels
    with the bit FULL counts as 0; `weight`: of `smoothing`. Beyond the frame the flux is 0.
    """
    ny, nx = image.shape
    reach = weight.size // 2
    norm = np.float32((weight**2).sum())
    across = np.zeros((weight.size, nx), np.float32)
    line = np.zeros(nx + 2 * reach, np.float32)
    noise = np.empty(nx, np.float32)
    snr = np.zeros((3, nx), np.float32)  # of the last three rows
    peaks = [(0.0, 0.0, 0.0) for _ in range(0)]
    for y in range(-reach, ny + 1):
        new_row = y + reach
        _next_row(image, hidden, new_row, weight, line, across[new_row % weight.size])
        if y < 0:
            continue
        if y < ny:
            for x in range(nx):
                noise[x] = rms[y // BIN, x // BIN]
            _row_of_snr(across, noise, y, weight, norm, snr[y % 3])
        else:
            snr[y % 3] = 0.0
        if y == 0:
            continue
        above = snr[(y - 2) % 3]
        middle = snr[(y - 1) % 3]
        below = snr[y % 3]
        for x in range(nx):
            value = middle[x]
            if value > threshold and not hidden[y - 1, x] & FULL and _highest(above, middle, below, x):
                peaks.append((float(x), float(y - 1), float(value)))
    x_of = np.empty(len(peaks))
    y_of = np.empty(len(peaks))
    snr_of = np.empty(len(peaks))
    for k in range(len(peaks)):
        x_of[k], y_of[k], snr_of[k] = peaks[k]
    return Peaks(x_of, y_of, snr_of)


@numba.njit(cache=True)
def _highest(above: FloatArray, middle: FloatArray, below: FloatArray, x: int) -> bool:
    """Return whether pixel x of `middle` exceeds its neighbours; the last of equal pixels counts."""
    value = middle[x]
    last = middle.size - 1
    for u in range(max(x - 1, 0), min(x + 1, last) + 1):
        if above[u] > value or below[u] >= value or (u < x and middle[u] > value) or (u > x and middle[u] >= value):
            return False
    return True
