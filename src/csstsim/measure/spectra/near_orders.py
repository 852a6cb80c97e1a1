"""The orders whose light may reach the pixels of the extracted spectra: no others need to be rendered.

The pixels are marked in tiles. Along the dispersion, the light of an order ends where its profile ends. Across, it ends
where a pixel would have less than the minimum rendered flux even with all electrons of the order in one column.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from csstsim.base.types import BoolArray, FloatArray, IntArray
from csstsim.measure.spectra.line_profile import HALF, OFFSETS, PER_PX

if TYPE_CHECKING:
    from csstsim.instrument.chip import Window

TILE = 16  # px
SAFETY = 2.0  # maximum ratio of the electrons of the model to those of the orders' table


class OrderExtents(NamedTuple):
    """The pixels that n orders may reach.

    `ends`, `heights` (n, 2): first and last column, and rows of the trace there [px]; `electrons` (n,); `fraction`,
    `size` (n, 2): of the object's components, fraction of the flux and class of size.
    """

    ends: FloatArray
    heights: FloatArray
    electrons: FloatArray
    fraction: FloatArray
    size: IntArray


def near_orders(
    orders: OrderExtents, tables: FloatArray, window: Window, boxes: FloatArray, faintest: float
) -> BoolArray:
    """Return (n,) bool: the orders that may have at least `faintest` electrons in a pixel of one of the boxes.

    tables: of SpectralModel, of ACROSS; boxes (m, 4): x0, x1, y0, y1 [px], half-open.
    """
    marked = _marked(boxes, window)
    reach = _reach(orders.electrons, orders.fraction, orders.size, tables, faintest)
    low = orders.heights.min(axis=1) - reach
    high = orders.heights.max(axis=1) + reach
    first, last = orders.ends.T
    x0, x1 = _tiles(first, last, window.x0, marked.shape[1] - 1)
    y0, y1 = _tiles(low, high, window.y0, marked.shape[0] - 1)
    return marked[y1, x1] - marked[y0, x1] - marked[y1, x0] + marked[y0, x0] > 0


def _marked(boxes: FloatArray, window: Window) -> IntArray:
    """Return int (tiles of y + 1, tiles of x + 1): number of tiles below and left of each corner that touch a box."""
    touched = np.zeros((-(-window.ny // TILE) + 1, -(-window.nx // TILE) + 1), np.int64)
    left, right, low, high = boxes.T
    x0, x1 = _tiles(left, right - 1, window.x0, touched.shape[1] - 1)
    y0, y1 = _tiles(low, high - 1, window.y0, touched.shape[0] - 1)
    for i0, i1, j0, j1 in zip(x0, x1, y0, y1, strict=True):
        touched[j0 + 1 : j1 + 1, i0 + 1 : i1 + 1] = 1
    return touched.cumsum(axis=0).cumsum(axis=1)


def _tiles(first: FloatArray, last: FloatArray, start: int, count: int) -> tuple[IntArray, IntArray]:
    """Return (first tile, tile after the last one) of pixels from `first` to `last`, of `count` tiles from `start`."""
    low = np.floor((np.asarray(first, float) - start) / TILE)
    high = np.floor((np.asarray(last, float) - start) / TILE)
    return np.clip(low, 0, count).astype(int), np.clip(high + 1, 0, count).astype(int)


def _reach(
    electrons: FloatArray, fraction: FloatArray, size: IntArray, tables: FloatArray, faintest: float
) -> IntArray:
    """Return (n,): the maximum distance from the trace [px] at which a pixel may have `faintest` electrons."""
    pixel = tables[..., PER_PX:] - tables[..., :-PER_PX]
    centre = np.abs(OFFSETS[PER_PX:] - 0.5)
    # profiles are linear between OFFSETS: a pixel is not brighter than the brighter of the two steps next to it
    brightest = np.stack([pixel[..., centre >= d - 1 / PER_PX].max(axis=(2, 3)) for d in range(HALF)], axis=-1)
    peak = sum(fraction[:, k, None] * brightest[size[:, k], k] for k in (0, 1)) * (SAFETY * electrons[:, None])
    return 1 + (peak >= faintest).sum(axis=1)
