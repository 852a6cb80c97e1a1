"""An order of objects that does not depend on the order of rows in their table.

The order in which stamps are added determines the last bit of a pixel, and the order of two objects with the same id
determines their random numbers. Objects are therefore summed and rendered by id, and those of one id by their other
numeric columns, so the rows of a catalogue may be shuffled.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from csstsim.catalog.light.object_spectra import ROW

if TYPE_CHECKING:
    from csstsim.base.types import IntArray
    from csstsim.catalog.table import ObjectTable


def canonical_order(table: ObjectTable) -> IntArray:
    """Return (n,) rows of an ObjectTable in canonical order; rows with the same id and numbers keep their order.

    The embedded universe's rows are in this order already.
    """
    ids = table["id"]
    if (np.diff(ids) > 0).all():
        return np.arange(len(ids))
    order = np.argsort(ids, kind="stable")
    if (np.diff(ids[order]) > 0).all():
        return order
    numbers = [table[name] for name in sorted(set(table.names) - {"id", ROW}) if table[name].dtype.kind in "biuf"]
    return np.lexsort((*numbers, ids))


def back(order: IntArray) -> IntArray:
    """Return (n,) the inverse of the permutation `order`."""
    rows = np.empty(len(order), np.int64)
    rows[order] = np.arange(len(order))
    return rows


def orders_back(orders: ObjectTable, order: IntArray) -> ObjectTable:
    """Return a table of spectral orders (io.orders) of objects taken in `order`, with their original rows.

    `row` gets the original row; the table is sorted by row, then by order.
    """
    row = order[orders["row"]].astype(orders["row"].dtype)
    return orders.with_columns(row=row).take(np.lexsort((orders["order"], row)))
