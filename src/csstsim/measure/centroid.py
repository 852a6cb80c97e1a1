"""Errors of windowed positions: the noise of the pixels, passed on to the place where the weighted offsets cancel.

The position is where sum(w (r - r0) d) = 0, with a Gaussian w of sigma `window` about r0 itself (detect). To first
order noise n in the pixels moves it by sum(w dx n) / sum(w (1 - dx^2 / window^2) m), with m the source without noise:
the PSF for what was found as a point, the image itself for an extended source.
"""

import math

import numba
import numpy as np

from csstsim.measure.photometry import HALF, draw_psf

REACH = 4.0  # window sigma: where the window ends


@numba.njit(cache=True)
def position_errors(image, rms, x, y, window, extended, flux, counted, cell, coefficients):
    """Return the error (n,) of x and y (root of the mean square of both), px; infinite if the source has no light.

    `image`, `rms` float32 (ny, nx); `x`, `y`, `window` (n,) px of the frame; `flux` electron, of the PSF fit, taken
    for points; the rest as in photometry.fit_sources.
    """
    ny, nx = image.shape
    error = np.full(x.size, np.inf)
    stamp = np.empty((2 * HALF + 1, 2 * HALF + 1))
    for k in range(x.size):
        column, row = round(x[k]), round(y[k])
        draw_psf(coefficients[cell[k]], x[k] - column, y[k] - row, HALF, stamp)
        inverse, reach = window[k] ** -2, REACH * window[k]
        noise, pull_x, pull_y = 0.0, 0.0, 0.0
        for v in range(max(math.ceil(y[k] - reach), 0), min(math.floor(y[k] + reach) + 1, ny)):
            for u in range(max(math.ceil(x[k] - reach), 0), min(math.floor(x[k] + reach) + 1, nx)):
                dx, dy = u - x[k], v - y[k]
                r2 = dx * dx + dy * dy
                if r2 > reach * reach:
                    continue
                if extended[k]:
                    light = float(image[v, u])
                elif abs(u - column) <= HALF and abs(v - row) <= HALF:
                    light = flux[k] * stamp[v - row + HALF, u - column + HALF]
                else:
                    light = 0.0
                w = math.exp(-0.5 * inverse * r2)
                noise += w * w * r2 * (float(rms[v, u]) ** 2 + max(light, 0.0) / counted[k])
                pull_x += w * (1.0 - inverse * dx * dx) * light
                pull_y += w * (1.0 - inverse * dy * dy) * light
        pull = 0.5 * (pull_x + pull_y)
        if pull > 0.0:
            error[k] = math.sqrt(0.5 * noise) / pull
    return error
