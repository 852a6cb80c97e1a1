"""Radius of a circle with half of a source's light, within a larger circle."""

import math

import numba
import numpy as np

from csstsim.base.types import FloatArray

BIN = 0.1  # px
# px; nearer pixels are split into PARTS x PARTS
FINE = 5.0
PARTS = 4
LEAST = 0.5  # px, also where there is no light


@numba.njit(cache=True)
def half_light_radius(image: FloatArray, x: FloatArray, y: FloatArray, reach: FloatArray) -> FloatArray:
    """Return (n,) px: the radius of half the light that `image` (ny, nx) has within `reach` (n,) px of x, y.

    Light beyond the frame is zero. Pixels far from the source count with their centres. LEAST where there is no light.
    """
    ny, nx = image.shape
    out = np.full(x.size, LEAST)
    for k in range(x.size):
        growth = np.zeros(int(reach[k] / BIN) + 2)
        for v in range(max(math.ceil(y[k] - reach[k] - 0.5), 0), min(math.floor(y[k] + reach[k] + 0.5) + 1, ny)):
            for u in range(max(math.ceil(x[k] - reach[k] - 0.5), 0), min(math.floor(x[k] + reach[k] + 0.5) + 1, nx)):
                parts = PARTS if (u - x[k]) ** 2 + (v - y[k]) ** 2 < FINE**2 else 1
                light = image[v, u] / parts**2
                for j in range(parts):
                    for i in range(parts):
                        dx = u + (i + 0.5) / parts - 0.5 - x[k]
                        dy = v + (j + 0.5) / parts - 0.5 - y[k]
                        radius = math.sqrt(dx * dx + dy * dy)
                        if radius <= reach[k]:
                            growth[int(radius / BIN)] += light
        half = 0.5 * growth.sum()
        total = 0.0
        if not half > 0.0:
            continue
        for b in range(growth.size):
            if total + growth[b] >= half:
                out[k] = max(BIN * (b + (half - total) / growth[b]), LEAST)
                break
            total += growth[b]
    return out
