"""Faint tracks of cosmic rays: sources that are long and narrower than the PSF.

A track whose pixels are each too faint for bad_pixels is a line, one pixel wide. Through each source, strips in
all directions are compared: the one with the largest S/N is the track's, if there is one. A track has most of its light
within half a pixel of that line (FRACTION), and its strip's S/N exceeds that of the PSF (LONG). A galaxy seen from its
edge is as wide as the PSF at least.
"""

import math
from functools import lru_cache
from typing import NamedTuple

import numba
import numpy as np

from csstsim.base.types import BoolArray, FloatArray, IntArray

ANGLES = 24
LENGTH = 5.0  # px, half of the strip
# px, sigmas of the two strips across
NARROW = 0.5
WIDE = 1.2
# minimum flux in the narrow strip over that in the wide one: at most 0.66 for the PSF, 0.75 to 1 for a track
FRACTION = 0.70
LONG = 1.2  # minimum S/N of the strip over the peak's
SHIFTS = 2  # steps of a quarter of a pixel that the strip may lie off the source


class Strips(NamedTuple):
    """All directions and shifts: rows and columns (k, m, 2) from the source, and `narrow`, `wide` weights (k, m)."""

    offsets: IntArray
    narrow: FloatArray
    wide: FloatArray


def tracks(image: FloatArray, rms: FloatArray, x: FloatArray, y: FloatArray, snr: FloatArray) -> BoolArray:
    """Return bool (n,): which sources are tracks. `image`, `rms` float32 (ny, nx); x, y px; `snr` as of peaks."""
    return _tracks(image, rms, x, y, snr, _strips())


@lru_cache
def _strips() -> Strips:
    """Return the strips, padded with weights of 0 to as many pixels as the largest has."""
    reach = math.ceil(LENGTH) + 3
    v, u = np.mgrid[-reach : reach + 1, -reach : reach + 1]
    offsets = []
    narrow = []
    wide = []
    for angle in np.pi * np.arange(ANGLES) / ANGLES:
        for shift in range(-SHIFTS, SHIFTS + 1):
            across = np.cos(angle) * v - np.sin(angle) * u - 0.25 * shift
            some = (np.abs(np.cos(angle) * u + np.sin(angle) * v) <= LENGTH) & (np.abs(across) < 3.0)
            offsets.append(np.column_stack([v[some], u[some]]))
            narrow.append(np.exp(-0.5 * (across[some] / NARROW) ** 2))
            wide.append(np.exp(-0.5 * (across[some] / WIDE) ** 2))
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
            light, norm = _light(image, row, column, offsets[s], narrow[s])
            if light > 0.0 and light > best * math.sqrt(norm):
                best = light / math.sqrt(norm)
                chosen = s
        if chosen >= 0 and best > LONG * snr[k] * rms[row, column]:
            inner, _ = _light(image, row, column, offsets[chosen], narrow[chosen])
            whole, _ = _light(image, row, column, offsets[chosen], wide[chosen])
            out[k] = inner > FRACTION * whole
    return out


@numba.njit(cache=True)
def _light(image: FloatArray, row: int, column: int, offsets: IntArray, weights: FloatArray) -> tuple[float, float]:
    """Return (weighted light, sum of squared weights) of the pixels at `offsets` that are on the frame."""
    ny, nx = image.shape
    light = 0.0
    norm = 0.0
    for m in range(len(weights)):
        v = row + offsets[m, 0]
        u = column + offsets[m, 1]
        w = weights[m]
        if w > 1e-3 and 0 <= v < ny and 0 <= u < nx:
            light += w * image[v, u]
            norm += w * w
    return light, norm
