"""Faint tracks of cosmic rays: sources that are long and narrower than the PSF.

A track whose pixels are each too faint for measure.bad_pixels is a line, one pixel wide. Through each source, strips in
all directions are compared: the one with the largest S/N is the track's, if there is one. A track has most of its light
within half a pixel of that line (SHARE), and its strip's S/N exceeds that of the PSF (LONG). A galaxy seen from its
edge is as wide as the PSF at least.
"""

import math

import numba
import numpy as np

ANGLES = 24
LENGTH = 5.0  # px, half of the strip
NARROW, WIDE = 0.5, 1.2  # px, sigmas of the two strips across
SHARE = (
    0.70  # least light in the narrow strip over that in the wide one: at most 0.66 for the PSF, 0.75 to 1 for a track
)
LONG = 1.2  # least S/N of the strip over the peak's
SHIFTS = 2  # steps of a quarter of a pixel that the strip may lie beside the source


@numba.njit(cache=True)
def tracks(image, rms, x, y, snr):
    """Return bool (n,): which sources are tracks. `image`, `rms` float32 (ny, nx); x, y px; `snr` as of peaks."""
    ny, nx = image.shape
    reach = math.ceil(LENGTH) + 3
    out = np.zeros(x.size, np.bool_)
    cosines = np.array([math.cos(math.pi * k / ANGLES) for k in range(ANGLES)])
    sines = np.array([math.sin(math.pi * k / ANGLES) for k in range(ANGLES)])
    for k in range(x.size):
        column, row = round(x[k]), round(y[k])
        if row < 0 or row >= ny or column < 0 or column >= nx:
            continue
        best, chosen, beside = 0.0, -1, 0.0
        for a in range(ANGLES):
            for shift in range(-SHIFTS, SHIFTS + 1):
                light, norm = _strip(image, column, row, reach, cosines[a], sines[a], 0.25 * shift, NARROW)
                if norm > 0.0 and light / math.sqrt(norm) > best:
                    best, chosen, beside = light / math.sqrt(norm), a, 0.25 * shift
        if chosen < 0 or best < LONG * snr[k] * rms[row, column]:
            continue
        narrow, _ = _strip(image, column, row, reach, cosines[chosen], sines[chosen], beside, NARROW)
        wide, _ = _strip(image, column, row, reach, cosines[chosen], sines[chosen], beside, WIDE)
        out[k] = narrow > SHARE * wide
    return out


@numba.njit(cache=True)
def _strip(image, column, row, reach, cosine, sine, beside, width):
    """Return (light, sum of squares) of Gaussian weights of sigma `width` across a line, `beside` the source."""
    ny, nx = image.shape
    light, norm = 0.0, 0.0
    for v in range(max(row - reach, 0), min(row + reach + 1, ny)):
        for u in range(max(column - reach, 0), min(column + reach + 1, nx)):
            along = cosine * (u - column) + sine * (v - row)
            across = cosine * (v - row) - sine * (u - column) - beside
            if abs(along) <= LENGTH and abs(across) < 3.0:
                w = math.exp(-0.5 * (across / width) ** 2)
                light += w * image[v, u]
                norm += w * w
    return light, norm
