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


def point_stamp(stamper: Stamper, i: int, share: FloatArray, bounds: Box | None) -> tuple[FloatArray, float]:
    """Return (stamp, light) of a Stamper's point i, as Stamper.stamp."""
    reach = stamper.reach[i]
    column = round(stamper.scene.x[i])
    row = round(stamper.scene.y[i])
    whole = column - reach, column + reach + 1, row - reach, row + reach + 1
    stamp = _pixels(stamper, i, share, whole)
    light = stamp.sum()
    if bounds is None:
        return stamp[:0, :0], light
    return stamp[bounds[2] - whole[2] : bounds[3] - whole[2], bounds[0] - whole[0] : bounds[1] - whole[0]], light


def _pixels(stamper: Stamper, i: int, share: FloatArray, bounds: Box) -> FloatArray:
    """Return the light of a point on the pixels of `bounds`."""
    mixer = stamper.mixer
    core = stamper.core
    x = stamper.scene.x[i]
    y = stamper.scene.y[i]
    m, (x0, x1, y0, y1) = mixer.per_pixel, bounds
    stamp = np.zeros((y1 - y0, x1 - x0))
    start = (y0 - 0.5 - y) * m + mixer.cells / 2, (x0 - 0.5 - x) * m + mixer.cells / 2
    first = tuple(max(math.floor(s) - 1, 0) for s in start)
    last = tuple(min(math.floor(s) + k * m + 2, mixer.cells) for s, k in zip(start, stamp.shape, strict=True))
    if first[0] >= last[0] or first[1] >= last[1]:
        return stamp
    cells = mixer.mixed_cells(stamper.scene.node[i], share, first, last)
    if core is not None:
        cells *= core[first[0] : last[0], first[1] : last[1]]
    return pixel_sums(cells, start[0] - first[0], start[1] - first[1], m, m, stamp)
