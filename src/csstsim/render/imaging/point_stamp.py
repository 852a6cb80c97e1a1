"""A point's stamp: the PSF's spline density (render.psf_table) integrated over pixels at the sub-pixel position.

No transform is needed; the mixture is computed only for the cells under the stamp.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from csstsim.render.pixel_sums import pixel_sums

if TYPE_CHECKING:
    from csstsim.base.types import FloatArray
    from csstsim.render.canvas import Box
    from csstsim.render.imaging.stamper import Stamper
    from csstsim.render.psf_mixture import Mixer


def point_stamp(stamper: Stamper, i: int, node_electrons: FloatArray, bounds: Box | None) -> tuple[FloatArray, float]:
    """Return (stamp, light) of a Stamper's point i, as Stamper.stamp."""
    reach = stamper.reach[i]
    column = round(stamper.scene.x[i])
    row = round(stamper.scene.y[i])
    left = column - reach
    bottom = row - reach
    stamp = _pixels(stamper, i, node_electrons, (left, column + reach + 1, bottom, row + reach + 1))
    light = stamp.sum()
    if bounds is None:
        return stamp[:0, :0], light
    x0, x1, y0, y1 = bounds
    return stamp[y0 - bottom : y1 - bottom, x0 - left : x1 - left], light


def _pixels(stamper: Stamper, i: int, node_electrons: FloatArray, bounds: Box) -> FloatArray:
    """Return the light of a point on the pixels of `bounds`."""
    mixer = stamper.mixer
    core = stamper.core
    x = stamper.scene.x[i]
    y = stamper.scene.y[i]
    per_pixel = mixer.per_pixel
    x0, x1, y0, y1 = bounds
    stamp = np.zeros((y1 - y0, x1 - x0))
    start_x = (x0 - 0.5 - x) * per_pixel + mixer.cells / 2
    start_y = (y0 - 0.5 - y) * per_pixel + mixer.cells / 2
    columns = _cells(start_x, x1 - x0, mixer)
    rows = _cells(start_y, y1 - y0, mixer)
    if rows.start >= rows.stop or columns.start >= columns.stop:
        return stamp
    cells = mixer.mixed_cells(stamper.scene.node[i], node_electrons, rows, columns)
    if core is not None:
        cells *= core[rows, columns]
    return pixel_sums(cells, start_y - rows.start, start_x - columns.start, per_pixel, per_pixel, stamp)


def _cells(start: float, pixels: int, mixer: Mixer) -> slice:
    """Return the PSF's cells along an axis that reach into `pixels` pixels from `start` [cell] on."""
    first = max(math.floor(start) - 1, 0)
    return slice(first, min(math.floor(start) + pixels * mixer.per_pixel + 2, mixer.cells))
