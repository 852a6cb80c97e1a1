"""A point's stamp: the PSF's spline density (render.psf_table) integrated over pixels at the sub-pixel place.

A short separable sum, exact, no transform; the mixture is summed only over the cells that the stamp needs.
"""

import math

import numba
import numpy as np


def point_stamp(mixer, node, share, x, y, bounds, core=None):
    """Return the light of a point at x, y on the pixels of `bounds` (x0, x1, y0, y1; half-open), float64.

    mixer: psf_mixture.Mixer; node (k,), share (k, 4): electrons from each node and sub-band; core: (cells, cells) share
    of each cell that counts, or None: all.
    """
    m, (x0, x1, y0, y1) = mixer.per_pixel, bounds
    middle = mixer.cells / 2
    first_x, taps_x = _taps((x0 - 0.5 - x) * m + middle, m)
    first_y, taps_y = _taps((y0 - 0.5 - y) * m + middle, m)
    stamp = np.zeros((y1 - y0, x1 - x0))
    first = max(first_y, 0), max(first_x, 0)
    last = tuple(min(f + (k + 1) * m + 2, mixer.cells) for f, k in zip((first_y, first_x), stamp.shape, strict=True))
    if first[0] < last[0] and first[1] < last[1]:
        cells = mixer.mixed_cells(node, share, first, last)
        if core is not None:
            cells *= core[first[0] : last[0], first[1] : last[1]]
        _sum_cells(cells, first_y - first[0], taps_y, first_x - first[1], taps_x, m, stamp)
    return stamp


@numba.njit(cache=True)
def _taps(start, per_pixel):
    """Return (first cell, weights): the part of each cell's spline that falls in a pixel that begins at `start`."""
    first = math.floor(start) - 1
    taps = np.empty(per_pixel + 3)
    for i in range(len(taps)):
        offset = start - (first + 0.5 + i)  # of the pixel's left edge from the spline's centre
        taps[i] = _spline_integral(offset + per_pixel) - _spline_integral(offset)
    return first, taps


@numba.njit(cache=True)
def _spline_integral(t):
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


@numba.njit(cache=True)
def _sum_cells(cells, first_y, taps_y, first_x, taps_x, step, stamp):
    """Fill `stamp` with sums of taps over cells, those of a pixel beginning `step` after its neighbour's."""
    ny, nx = cells.shape
    line = np.empty(nx)
    for row in range(stamp.shape[0]):
        line[:] = 0.0
        for j in range(len(taps_y)):
            y = first_y + row * step + j
            if 0 <= y < ny:
                for x in range(nx):
                    line[x] += taps_y[j] * cells[y, x]
        for column in range(stamp.shape[1]):
            at = first_x + column * step
            total = 0.0
            for i in range(max(0, -at), min(len(taps_x), nx - at)):
                total += taps_x[i] * line[at + i]
            stamp[row, column] = total
