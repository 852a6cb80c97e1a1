"""Stamps: the expected light of a point on its pixels, without noise.

The PSF's spline density (render.psf_table) is integrated over pixels at the object's sub-pixel place: a short separable
sum, exact, no transform.
"""

import numba
import numpy as np


def point_stamp(mixture, x, y, reach, per_pixel):
    """Return (stamp, column, row): light of a point at x, y on (2 reach + 1)^2 pixels whose first is column, row.

    mixture: (cells, cells) spline coefficients of the PSF, in electrons.
    """
    column, row = round(x) - reach, round(y) - reach
    half = len(mixture) / 2
    first_x, taps_x = _taps((column - 0.5 - x) * per_pixel + half, per_pixel)
    first_y, taps_y = _taps((row - 0.5 - y) * per_pixel + half, per_pixel)
    stamp = np.zeros((2 * reach + 1, 2 * reach + 1))
    _decimate(mixture, first_x, taps_x, first_y, taps_y, per_pixel, stamp)
    return stamp, column, row


def _taps(start, per_pixel):
    """Return (first cell, weights): the part of each cell's spline that falls in a pixel that begins at `start`."""
    first = int(np.floor(start)) - 1
    offset = start - (first + 0.5 + np.arange(per_pixel + 3))  # of the pixel's left edge from each spline's centre
    return first, _spline_integral(offset + per_pixel) - _spline_integral(offset)


def _spline_integral(t):
    """Return the integral of the quadratic B-spline from -3/2 to t."""
    t = np.clip(t, -1.5, 1.5)
    left, right = (t + 1.5) ** 3 / 6, 1 - (1.5 - t) ** 3 / 6
    return np.where(t < -0.5, left, np.where(t > 0.5, right, 0.5 + t * (0.75 - t * t / 3)))


@numba.njit(cache=True)
def _decimate(cells, first_x, taps_x, first_y, taps_y, step, stamp):
    ny, nx = cells.shape
    size = len(stamp)
    line = np.empty(size)
    for row in range(size):
        base = first_y + row * step
        for j in range(len(taps_y)):
            y = base + j
            if y < 0 or y >= ny:
                continue
            for column in range(size):
                total = 0.0
                at = first_x + column * step
                for i in range(len(taps_x)):
                    x = at + i
                    if 0 <= x < nx:
                        total += taps_x[i] * cells[y, x]
                line[column] = total
            for column in range(size):
                stamp[row, column] += taps_y[j] * line[column]
