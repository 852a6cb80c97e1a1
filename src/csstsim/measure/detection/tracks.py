"""Faint tracks of cosmic rays: sources that are long and narrower than the PSF.

A track whose pixels are each too faint for bad_pixels is a line, one pixel wide. Through each source, strips in all
directions are compared: the strip with the largest S/N is that of the track, if there is one. A track has most of its
flux within half a pixel of that line (NARROW_FRACTION_MIN), and the S/N of its strip exceeds that of the PSF
(SNR_RATIO_MIN). An edge-on galaxy is at least as wide as the PSF.
"""

import math
from functools import lru_cache
from typing import NamedTuple

import numba
import numpy as np

from csstsim.base.types import BoolArray, FloatArray, IntArray
from csstsim.measure.detection.maps import BIN

ANGLES = 24
HALF_LENGTH = 5.0  # px, half the length of a strip
# px, sigmas of the two strips across
NARROW_SIGMA = 0.5
WIDE_SIGMA = 1.2
# ratio of the flux in the narrow strip to that in the wide one: at most 0.66 for the PSF, 0.75 to 1 for a track
NARROW_FRACTION_MIN = 0.70
SNR_RATIO_MIN = 1.2  # S/N of the strip over that of the peak
SHIFTS = 2  # maximum offset of the strip from the source, in quarters of a pixel


class Strips(NamedTuple):
    """k strips of m pixels, in all directions and shifts: row and column (k, m, 2) from the source, weights (k, m)."""

    offsets: IntArray
    narrow: FloatArray
    wide: FloatArray


def tracks(image: FloatArray, rms: FloatArray, x: FloatArray, y: FloatArray, snr: FloatArray) -> BoolArray:
    """Return bool (n,): the sources that are tracks.

    `image` float32 (ny, nx); `rms`: noise of a pixel, on bins of BIN px; `x`, `y` (n,) px; `snr` (n,) of peaks.
    """
    return _tracks(image, rms, x, y, snr, _strips())


@lru_cache
def _strips() -> Strips:
    """Return the strips, padded with weights of 0 to the number of pixels of the largest strip."""
    reach = math.ceil(HALF_LENGTH) + 3
    v, u = np.mgrid[-reach : reach + 1, -reach : reach + 1]
    offsets = []
    narrow = []
    wide = []
    for angle in np.pi * np.arange(ANGLES) / ANGLES:
        for shift in range(-SHIFTS, SHIFTS + 1):
            across = np.cos(angle) * v - np.sin(angle) * u - 0.25 * shift
            inside = (np.abs(np.cos(angle) * u + np.sin(angle) * v) <= HALF_LENGTH) & (np.abs(across) < 3.0)
            offsets.append(np.column_stack([v[inside], u[inside]]))
            narrow.append(np.exp(-0.5 * (across[inside] / NARROW_SIGMA) ** 2))
            wide.append(np.exp(-0.5 * (across[inside] / WIDE_SIGMA) ** 2))
    largest = max(len(weights) for weights in narrow)
    return Strips(
        np.array([np.pad(pixels, [(0, largest - len(pixels)), (0, 0)]) for pixels in offsets]),
        np.array([np.pad(weights, (0, largest - len(weights))) for weights in narrow]),
        np.array([np.pad(weights, (0, largest - len(weights))) for weights in wide]),
    )


@numba.njit(cache=True)
def _tracks(
    image: FloatArray, rms: FloatArray, x: FloatArray, y: FloatArray, snr: FloatArray, strips: Strips
) -> BoolArray:
    offsets, narrow, wide = strips
    ny, nx = image.shape
    out = np.zeros(x.size, np.bool_)
    for k in range(x.size):
        column = round(x[k])
        row = round(y[k])
        if row < 0 or row >= ny or column < 0 or column >= nx:
            continue
        best = 0.0
        chosen = -1
        for s in range(len(offsets)):
            flux, norm = _weighted_flux(image, row, column, offsets[s], narrow[s])
            if flux > 0.0 and flux > best * math.sqrt(norm):
                best = flux / math.sqrt(norm)
                chosen = s
        if chosen >= 0 and best > SNR_RATIO_MIN * snr[k] * rms[row // BIN, column // BIN]:
            narrow_flux, _ = _weighted_flux(image, row, column, offsets[chosen], narrow[chosen])
            wide_flux, _ = _weighted_flux(image, row, column, offsets[chosen], wide[chosen])
            out[k] = narrow_flux > NARROW_FRACTION_MIN * wide_flux
    return out


@numba.njit(cache=True)
def _weighted_flux(
    image: FloatArray, row: int, column: int, offsets: IntArray, weights: FloatArray
) -> tuple[float, float]:
    """Return (weighted flux, sum of squared weights) of the pixels at `offsets` that are on the frame."""
    ny, nx = image.shape
    flux = 0.0
    norm = 0.0
    for m in range(len(weights)):
        v = row + offsets[m, 0]
        u = column + offsets[m, 1]
        w = weights[m]
        if w > 1e-3 and 0 <= v < ny and 0 <= u < nx:
            flux += w * image[v, u]
            norm += w * w
    return flux, norm
