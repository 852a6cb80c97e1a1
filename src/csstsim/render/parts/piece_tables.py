"""Tables of what was rendered of objects in several pieces, of a trail or by components: one row for each object."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from csstsim.render.drawn_table import NONE

if TYPE_CHECKING:
    from csstsim.base.types import FloatArray, IntArray
    from csstsim.catalog.table import ObjectTable

SHARE = "trail_share"  # column of the pieces: their fraction of the object's electrons


def gathered(objects: ObjectTable, owner: IntArray, drawn: ObjectTable) -> ObjectTable:
    """Return the table of `objects` with what was rendered of their pieces (render.drawn_table), a row for each."""
    count = len(objects)
    ends = np.r_[np.flatnonzero(np.r_[True, owner[1:] != owner[:-1]]), len(owner)] if count else np.zeros(1, int)
    starts = ends[:-1]
    lit = drawn["method"] != NONE
    chosen = starts.copy()  # the first piece that was rendered
    rows = np.flatnonzero(lit)
    chosen[owner[rows[::-1]]] = rows[::-1]
    sums = {name: np.bincount(owner, drawn[name], count) for name in ("electrons", "drawn", "ms")}
    fraction = np.divide(sums["drawn"], sums["electrons"], out=np.zeros(count), where=sums["electrons"] > 0)
    flags = np.bitwise_and.reduceat(drawn["flags"], starts) if count else drawn["flags"]  # OFF_CHIP: all of it
    some = np.zeros(count, flags.dtype)
    np.bitwise_or.at(some, owner[lit], drawn["flags"][lit])
    of_piece = {name: drawn[name][chosen] for name in ("method", "snr", "error")}
    stamp = np.zeros(count, drawn["stamp"].dtype)
    np.maximum.at(stamp, owner, drawn["stamp"])
    return objects.with_columns(
        flags=flags | some,
        electrons=sums["electrons"],
        drawn=sums["drawn"],
        fraction=fraction,
        method=of_piece["method"],
        snr=of_piece["snr"],
        error=of_piece["error"],
        stamp=stamp,
        **_boxes(drawn, owner, count),
        ms=sums["ms"].astype(drawn["ms"].dtype),
    )


def orders_of(orders: ObjectTable, row: IntArray, light: FloatArray) -> ObjectTable:
    """Return the table of orders of pieces with one row for each object, order and grating, that of the largest flux.

    row (m,): the object of each piece; light (m,). Electrons are sums, the box encloses all, `cut` is any piece's.
    """
    if not len(orders):
        return orders
    piece = orders["row"].astype(int)
    mine = row[piece]
    names = np.unique(orders["grating"], return_inverse=True)[1]
    key = np.stack([mine, orders["order"].astype(int), names])
    _, group = np.unique(key, axis=1, return_inverse=True)
    group = group.ravel()
    count = int(group.max()) + 1
    order = np.lexsort((np.arange(len(group)), -orders["electrons"], group))
    best = order[np.r_[True, np.diff(group[order]) != 0]]
    merged = orders.take(best)
    sums = {name: np.bincount(group, orders[name], count) for name in ("electrons", "drawn")}
    any_cut = np.bincount(group, orders["cut"], count) > 0
    box = _boxes(orders, group, count)
    merged = merged.with_columns(row=mine[best].astype(np.int32), cut=any_cut, **sums, **box)
    return merged.take(np.lexsort((merged["order"], merged["row"])))


def _boxes(table: ObjectTable, group: IntArray, count: int) -> dict[str, IntArray]:
    """Return columns (count,) x0, x1, y0, y1 of the boxes that enclose those of each group of rows; zeros: none."""
    box: dict[str, IntArray] = {}
    there = table["x1"] > table["x0"]
    for low, high in (("x0", "x1"), ("y0", "y1")):
        first = np.full(count, np.iinfo(np.int32).max, np.int32)
        last = np.zeros(count, np.int32)
        np.minimum.at(first, group[there], table[low][there])
        np.maximum.at(last, group[there], table[high][there])
        box |= {low: np.where(last > 0, first, 0).astype(np.int32), high: last}
    return box
