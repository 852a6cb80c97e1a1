"""Smooth maps over a chip: values on a coarse grid with bilinear interpolation.

The grid always spans the chip's active pixels, so a window has the same pixel values as the whole chip.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numba
import numpy as np

from csstsim.base.types import FloatArray, IntArray

if TYPE_CHECKING:
    from csstsim.instrument.chip import Chip, Window


def grid_pixels(chip: Chip, nodes: int) -> tuple[FloatArray, FloatArray]:
    """Return x, y (nodes, nodes): pixel positions of a chip's grid, rows along x, first and last on pixel centres."""
    detector = chip.detector
    return np.meshgrid(np.linspace(0, detector.nx - 1, nodes), np.linspace(0, detector.ny - 1, nodes))


def expand(grid: FloatArray, chip: Chip, window: Window) -> FloatArray:
    """Return the bilinear map (window.ny, window.nx), float32, of a chip's grid (nodes, nodes)."""
    detector = chip.detector
    nodes = len(grid)
    u = np.arange(window.x0, window.x1) * ((nodes - 1) / max(detector.nx - 1, 1))
    v = np.arange(window.y0, window.y1) * ((nodes - 1) / max(detector.ny - 1, 1))
    out = np.empty(window.shape, np.float32)
    _bilinear(np.asarray(grid, dtype=float), u, v, out)
    return out


def pick(grid: FloatArray, chip: Chip, x: IntArray, y: IntArray) -> FloatArray:
    """Return (n,) float32: the values of `expand` at single pixels of the chip, columns x and rows y (int, (n,))."""
    detector = chip.detector
    last = len(grid) - 2
    u = x * ((last + 1) / max(detector.nx - 1, 1))
    v = y * ((last + 1) / max(detector.ny - 1, 1))
    column, row = (np.minimum(node.astype(np.int64), last) for node in (u, v))
    part = (u - column).astype(np.float32)
    t = v - row
    grid = np.asarray(grid, float)
    here, next_ = (((1 - t) * grid[row, k] + t * grid[row + 1, k]).astype(np.float32) for k in (column, column + 1))
    return here + (next_ - here) * part


@numba.njit(cache=True)
def _bilinear(grid: FloatArray, u: FloatArray, v: FloatArray, out: FloatArray) -> None:
    last = len(grid) - 2
    columns = np.minimum(u.astype(np.int64), last)
    part = (u - columns).astype(np.float32)
    first = np.searchsorted(columns, np.arange(last + 2))  # first pixel of each cell
    for y in range(len(v)):
        row = min(int(v[y]), last)
        t = v[y] - row
        line = ((1 - t) * grid[row] + t * grid[row + 1]).astype(np.float32)
        for j in range(last + 1):
            here = line[j]
            rise = line[j + 1] - line[j]
            for x in range(first[j], first[j + 1]):
                out[y, x] = here + rise * part[x]
