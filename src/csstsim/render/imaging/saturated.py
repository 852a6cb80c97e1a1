"""Flag saturated objects: those with more light than the full well in a pixel at their position, from any source."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from csstsim.catalog.flags import SATURATED

if TYPE_CHECKING:
    from csstsim.base.types import FloatArray, IntArray
    from csstsim.catalog.table import ObjectTable
    from csstsim.instrument.chip import Window


def flag_saturated(
    truth: ObjectTable, image: FloatArray, counted: IntArray | None, window: Window, full_well: float
) -> ObjectTable:
    """Return the truth table with SATURATED where one of the 3 x 3 pixels around an object is above the full well.

    image, counted: electrons, (window.ny, window.nx), counted may be None; full_well: electrons. The light is that
    falling on the detector, before blooming and charge transfer. Objects outside the window are not flagged.
    """
    if not len(truth):
        return truth
    x = _pixel(truth["x"])
    y = _pixel(truth["y"])
    on = np.flatnonzero((x >= window.x0) & (x < window.x1) & (y >= window.y0) & (y < window.y1))
    full = np.zeros(on.size, bool)
    for shift in np.ndindex(3, 3):
        row = y[on] - window.y0 + shift[0] - 1
        column = x[on] - window.x0 + shift[1] - 1
        inside = (row >= 0) & (row < window.ny) & (column >= 0) & (column < window.nx)
        at = row[inside], column[inside]
        full[inside] |= (image[at] if counted is None else image[at] + counted[at]) > full_well
    flags = truth["flags"].copy()
    flags[on[full]] |= SATURATED
    return truth.with_columns(flags=flags)


def _pixel(position: FloatArray) -> IntArray:
    """Return the pixels of positions along an axis; of NaN one that is on no window."""
    return np.nan_to_num(np.round(position), nan=-1e9).astype(int)
