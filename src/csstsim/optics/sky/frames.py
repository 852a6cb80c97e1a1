"""Compiled loops that add the sky to a frame; separate, so that code that only needs sky levels does not load them."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numba
import numpy as np

if TYPE_CHECKING:
    from csstsim.base.types import FloatArray, IntArray


@numba.njit(cache=True)
def expand(image: FloatArray, grid: FloatArray, rows: IntArray, v: FloatArray, starts: IntArray, u: FloatArray) -> None:
    """Add the bilinear expansion of `grid` (n, n) to `image`, in place; arguments: optics.sky.background.add_grid."""
    for y in range(image.shape[0]):
        line = (1 - v[y]) * grid[rows[y]] + v[y] * grid[rows[y] + 1]
        for j in range(len(starts) - 1):
            left = np.float32(line[j])
            step = np.float32(line[j + 1] - line[j])
            part = image[y, starts[j] : starts[j + 1]]
            fraction = u[starts[j] : starts[j + 1]]
            for x in range(len(part)):
                part[x] += left + step * fraction[x]


@numba.njit(cache=True)
def add_product(image: FloatArray, sky: FloatArray, response: FloatArray) -> None:
    """Add sky * response to `image`, all (ny, nx) float32, in place, without a temporary frame."""
    for y in range(image.shape[0]):
        for x in range(image.shape[1]):
            image[y, x] += sky[y, x] * response[y, x]
