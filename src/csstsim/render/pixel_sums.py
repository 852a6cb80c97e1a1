"""Integrals over pixels of a sum of quadratic B-splines on cells.

The integral is an exact, short, separable sum with the same weights for every pixel.
"""

import math

import numba
import numpy as np

from csstsim.base.types import FloatArray


@numba.njit(cache=True)
def pixel_sums(
    cells: FloatArray, start_y: float, start_x: float, per_pixel: int, step: int, out: FloatArray
) -> FloatArray:
    """Fill `out` (rows, columns) with the integrals over pixels and return it.

    cells: (ny, nx) float32 coefficients, cell i covers i to i + 1, and there is no light beyond them; the first pixel
    begins at start_y, start_x, pixels are `per_pixel` cells wide and begin every `step` cells.
    """
    ny, nx = cells.shape
    first_y, taps_y = _taps(start_y, per_pixel)
    first_x, taps_x = _taps(start_x, per_pixel)
    taps = len(taps_x)
    before = max(-first_x, 0)  # zeros before the cells; there are zeros after them too
    line = np.zeros(before + max(nx, first_x + step * out.shape[1] + taps), np.float32)
    inner = line[before : before + nx]
    for row in range(out.shape[0]):
        inner[:] = 0.0
        for j in range(taps):
            y = first_y + row * step + j
            if 0 <= y < ny:
                weight = taps_y[j]
                source = cells[y]
                for x in range(nx):
                    inner[x] += weight * source[x]
        if step == 1:  # neighbours in `line` are neighbours in `out`: add whole rows, tap by tap
            sums = out[row]
            sums[:] = 0.0
            for i in range(taps):
                weight = taps_x[i]
                part = line[before + first_x + i : before + first_x + i + len(sums)]
                for column in range(len(sums)):
                    sums[column] += weight * part[column]
            continue
        for column in range(out.shape[1]):
            at = before + first_x + column * step
            total = np.float32(0.0)
            for i in range(taps):
                total += taps_x[i] * line[at + i]
            out[row, column] = total
    return out


@numba.njit(cache=True)
def _taps(start: float, per_pixel: int) -> tuple[int, FloatArray]:
    """Return (first cell, weights): the fraction of each cell's spline that falls in a pixel beginning at `start`."""
    first = math.floor(start) - 1
    taps = np.empty(per_pixel + 3, np.float32)
    for i in range(len(taps)):
        offset = start - (first + 0.5 + i)  # of the pixel's left edge from the spline's centre
        taps[i] = _spline_integral(offset + per_pixel) - _spline_integral(offset)
    return first, taps


@numba.njit(cache=True)
def _spline_integral(t: float) -> float:
    """Return the integral of the quadratic B-spline from -3/2 to t."""
    if t <= -1.5:
        return 0.0
    if t >= 1.5:
        return 1.0
    if t < -0.5:
        return (t + 1.5) ** 3 / 6
    if t > 0.5:
        return 1 - (1.5 - t) ** 3 / 6
    return 0.5 + t * (0.75 - t * t / 3)
