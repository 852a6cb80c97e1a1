"""The orders whose light may reach the pixels of the spectra that are extracted: no others need to be rendered.

The pixels are marked in tiles. Along the dispersion an order's light ends with its profile's; across, it ends where
all of its electrons in a single column would be fainter than what is rendered.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from csstsim.base.types import BoolArray, FloatArray, IntArray
from csstsim.measure.spectra.line_profile import HALF, OFFSETS, PER_PX

if TYPE_CHECKING:
    from csstsim.instrument.chip import Window

TILE = 16  # px
SAFETY = 2.0  # electrons by the model over those of the orders' table, at most


class OrderExtents(NamedTuple):
    """Where n orders may have light.

    `ends`, `heights` (n, 2): first and last column that an order may light, and its trace there [px]; `electrons` (n,);
    `light`, `size` (n, 2): of its object's components, fraction and class.
    """

    ends: FloatArray
    heights: FloatArray
    electrons: FloatArray
    light: FloatArray
    size: IntArray


def near_orders(
    orders: OrderExtents, tables: FloatArray, window: Window, boxes: FloatArray, faintest: float
) -> BoolArray:
    """Return (n,) bool: the orders that may put light of at least `faintest` electrons on a pixel in one of the boxes.

    tables: of SpectralModel, of ACROSS; boxes (m, 4): x0, x1, y0, y1 [px], half-open.
    """
    marked = _marked(boxes, window)
    reach = _reach(orders.electrons, orders.light, orders.size, tables, faintest)
    low = orders.heights.min(axis=1) - reach
    high = orders.heights.max(axis=1) + reach
    first, last = orders.ends.T
    x0, x1 = _tiles(first, last, window.x0, marked.shape[1] - 1)
    y0, y1 = _tiles(low, high, window.y0, marked.shape[0] - 1)
    return marked[y1, x1] - marked[y0, x1] - marked[y1, x0] + marked[y0, x0] > 0


def _marked(boxes: FloatArray, window: Window) -> IntArray:
    """Return int (tiles of y + 1, tiles of x + 1): how many tiles below and left of each corner touch a box."""
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


def _reach(electrons: FloatArray, light: FloatArray, size: IntArray, tables: FloatArray, faintest: float) -> IntArray:
    """Return (n,): how far from its trace an order's pixels may have `faintest` electrons [px]."""
    pixel = tables[..., PER_PX:] - tables[..., :-PER_PX]
    centre = np.abs(OFFSETS[PER_PX:] - 0.5)
    # profiles are linear between OFFSETS: a pixel is no brighter than the brighter one of the two next to it
    most = np.stack([pixel[..., centre >= d - 1 / PER_PX].max(axis=(2, 3)) for d in range(HALF)], axis=-1)
    peak = sum(light[:, k, None] * most[size[:, k], k] for k in (0, 1)) * (SAFETY * electrons[:, None])
    return 1 + (peak >= faintest).sum(axis=1)
