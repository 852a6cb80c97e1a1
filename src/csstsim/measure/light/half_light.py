"""Radius of the circle with half of a source's flux within a larger circle."""

import math

import numba
import numpy as np

from csstsim.base.types import FloatArray

BIN = 0.1  # px
SPLIT_RADIUS = 5.0  # px: pixels within are divided into SUBPIXELS x SUBPIXELS
SUBPIXELS = 4
RADIUS_MIN = 0.5  # px, also without flux


@numba.njit(cache=True)
def half_light_radius(image: FloatArray, x: FloatArray, y: FloatArray, reach: FloatArray) -> FloatArray:
    """Return (n,) px: the radius of half the flux that `image` (ny, nx) has within `reach` (n,) px of x, y.

    Beyond the frame the flux is zero. Pixels beyond SPLIT_RADIUS count with their centres. The radius is RADIUS_MIN
    where there is no flux.
    """
    ny, nx = image.shape
    out = np.full(x.size, RADIUS_MIN)
    for k in range(x.size):
        growth = np.zeros(int(reach[k] / BIN) + 2)
        for v in range(max(math.ceil(y[k] - reach[k] - 0.5), 0), min(math.floor(y[k] + reach[k] + 0.5) + 1, ny)):
            for u in range(max(math.ceil(x[k] - reach[k] - 0.5), 0), min(math.floor(x[k] + reach[k] + 0.5) + 1, nx)):
                parts = SUBPIXELS if (u - x[k]) ** 2 + (v - y[k]) ** 2 < SPLIT_RADIUS**2 else 1
                flux = image[v, u] / parts**2
                for j in range(parts):
                    for i in range(parts):
                        dx = u + (i + 0.5) / parts - 0.5 - x[k]
                        dy = v + (j + 0.5) / parts - 0.5 - y[k]
                        radius = math.sqrt(dx * dx + dy * dy)
                        if radius <= reach[k]:
                            growth[int(radius / BIN)] += flux
        half = 0.5 * growth.sum()
        total = 0.0
        if not half > 0.0:
            continue
        for b in range(growth.size):
            if total + growth[b] >= half:
                out[k] = max(BIN * (b + (half - total) / growth[b]), RADIUS_MIN)
                break
            total += growth[b]
    return out
