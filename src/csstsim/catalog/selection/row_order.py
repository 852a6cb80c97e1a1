"""An order of objects that does not hang on the rows of the table they came in.

Sums of stamps are of limited precision, so the order in which objects are added decides the last bit of a pixel; and
which of two objects with one id is the first decides whose random numbers are whose. Objects are therefore summed and
drawn by id, those of one id by all else that is known of them in numbers: the rows of a catalogue may be shuffled.
"""

import numpy as np

from csstsim.catalog.light.object_spectra import ROW


def canonical_order(table):
    """Return (n,) rows of an ObjectTable in canonical order; rows of one id that are equal in all numbers as they come.

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


def back(order):
    """Return (n,) the rows that put what was taken in `order` back as it was."""
    rows = np.empty(len(order), np.int64)
    rows[order] = np.arange(len(order))
    return rows


def orders_back(orders, order):
    """Return a table of spectral orders (io.orders) of objects taken in `order` for the objects as they were.

    `row` names their rows; sorted by row, then by order, as before.
    """
    row = order[orders["row"]].astype(orders["row"].dtype)
    return orders.with_columns(row=row).take(np.lexsort((orders["order"], row)))
