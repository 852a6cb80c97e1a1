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
    corner = math.sqrt(0.5)
    for k in range(x.size):
        top = reach[k]
        growth = np.zeros(int(top / BIN) + 2)
        for v in range(max(math.ceil(y[k] - top - 0.5), 0), min(math.floor(y[k] + top + 0.5) + 1, ny)):
            dv = v - y[k]
            half_width = math.sqrt(max((top + corner) ** 2 - dv * dv, 0.0))
            for u in range(max(math.ceil(x[k] - half_width), 0), min(math.floor(x[k] + half_width) + 1, nx)):
                du = u - x[k]
                square = du * du + dv * dv
                if square < SPLIT_RADIUS**2:
                    flux = image[v, u] / SUBPIXELS**2
                    for j in range(SUBPIXELS):
                        dy = dv + ((j + 0.5) / SUBPIXELS - 0.5)
                        for i in range(SUBPIXELS):
                            dx = du + ((i + 0.5) / SUBPIXELS - 0.5)
                            radius = math.sqrt(dx * dx + dy * dy)
                            if radius <= top:
                                growth[int(radius / BIN)] += flux
                else:
                    radius = math.sqrt(square)
                    if radius <= top:
                        growth[int(radius / BIN)] += image[v, u]
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
