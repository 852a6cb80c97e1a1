"""Galaxies that follow the smooth density: those of haloes that are too small to be drawn one by one.

Their number in a cell of redshift and sky is Poisson with mean n exp(b delta - b^2 sigma^2 / 2), so that the mean over
the sky is n. b is the mean bias of their haloes, delta the Gaussian overdensity of the shell and sigma^2 its variance.
Cells of the sky are HEALPix pixels of `ORDER`, some 13 arcsec wide. Positions in a cell are uniform.
"""

from typing import NamedTuple

import numpy as np

from csstsim.base.types import FloatArray, IntArray

ORDER = 14  # nested; 4096 pixels a brick


class FieldGalaxies(NamedTuple):
    """Indices of galaxies (n,): type, row of redshift, column of mass, pixel."""

    kind: IntArray
    row: IntArray
    column: IntArray
    pixel: IntArray


def draw_field(
    generator: np.random.Generator, mean: FloatArray, bias: FloatArray, delta: FloatArray, variance: FloatArray
) -> FieldGalaxies:
    """Return a Poisson number of galaxies.

    mean (types, rows, columns): galaxies of a pixel without structure; bias, variance (rows,); delta (rows, pixels).
    """
    kinds, rows, columns = mean.shape
    by_row = mean.transpose(1, 0, 2).reshape(rows, -1)
    weight = by_row.sum(axis=1)[:, None] * np.exp(bias[:, None] * delta - 0.5 * (bias**2 * variance)[:, None])
    cumulative = np.cumsum(weight.ravel())
    count = generator.poisson(cumulative[-1])
    cell = np.searchsorted(cumulative, generator.random(count) * cumulative[-1], side="right")
    row, pixel = np.unravel_index(np.minimum(cell, weight.size - 1), weight.shape)
    # One search for all rows: the cumulative numbers of a row continue those of the rows before
    stacked = np.cumsum(by_row.ravel())
    below = np.concatenate([[0.0], stacked[np.arange(1, rows + 1) * by_row.shape[1] - 1]])
    cell = np.searchsorted(stacked, below[row] + generator.random(count) * (below[row + 1] - below[row]), side="right")
    cell = np.clip(cell, row * by_row.shape[1], (row + 1) * by_row.shape[1] - 1)
    _, kind, column = np.unravel_index(cell, (rows, kinds, columns))
    return FieldGalaxies(kind, row, column, pixel)
