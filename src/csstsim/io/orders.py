"""The truth table of dispersed light for a Level-0 file of a spectroscopic chip (paper, section 4.2): a row per order.

Orders of less than one electron, of which none was drawn, have no row.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from csstsim.base.errors import InputError
from csstsim.base.types import PathLike
from csstsim.catalog.table import ObjectTable, check_numbers

if TYPE_CHECKING:
    from csstsim.instrument.grating import Gratings

COLUMNS = {
    "id": "the object",
    "row": "its row in the truth table",
    "order": "-2 to 2",
    "grating": "GI1 ...",
    "cut": "its stamp reaches beyond the piece's edge: `electrons` is of all its light, `drawn` of this piece's",
    **dict.fromkeys(("p", "q", "r", "s"), "lambda [angstrom] lands at x + p + q lambda, y + r + s lambda [px]"),
    **dict.fromkeys(("xoff", "yoff", "a0", "a1", "alpha0", "alpha1"), "the trace as aXe has it: polynomials at x, y"),
    "electrons": "electrons of the whole order",
    "drawn": "electrons put on the window",
    **dict.fromkeys(("x0", "x1", "y0", "y1"), "px, box of what was drawn, half-open, full frame; zeros: nothing"),
    "wave_min": "angstrom, where the trace on the window begins; NaN: nothing, at most a stamp's edge or a wing",
    "wave_max": "angstrom, where it ends",
    "xImage": "FITS px (centre of the first at 1), where its light would fall without the grating",
    "yImage": "the same",
}
TYPES = {  # of those that are not float64
    "id": np.int64,
    "order": np.int8,
    "grating": np.str_,
    "cut": np.bool_,
    "wave_min": np.float32,
    "wave_max": np.float32,
    **dict.fromkeys(("row", "x0", "x1", "y0", "y1"), np.int32),
}
_NEEDED = ("id", "row", "order", "grating", "cut", "xImage", "yImage", "p", "q", "r", "s", "electrons", "drawn")


def write_orders(path: PathLike, orders: ObjectTable, metadata: Mapping[str, Any]) -> None:
    """Write the table of orders, x and y 0-based as render.slitless.draw_dispersed gives them."""
    orders_table(orders).write(path, metadata)


def orders_table(orders: ObjectTable) -> ObjectTable:
    """Return the columns of the file as an ObjectTable, from what render.slitless.draw_dispersed gives."""
    columns = {name: orders[name] for name in orders.names if name not in ("x", "y")}
    return ObjectTable(columns | {"xImage": orders["x"] + 1.0, "yImage": orders["y"] + 1.0})


def read_orders(path: PathLike) -> ObjectTable:
    """Return the table of orders with 0-based x, y. Raises InputError, also for a place that is not finite."""
    table = ObjectTable.read(path)
    missing = [name for name in _NEEDED if name not in table]
    if missing:
        raise InputError("required column is missing", file=path, key=missing[0])
    check_numbers(path, table, set(_NEEDED) - {"grating"})
    for name in ("xImage", "yImage", "p", "q", "r", "s"):
        if not np.isfinite(table[name]).all():
            raise InputError("not finite", file=path, key=name)
    columns = {name: table[name] for name in table.names if name not in ("xImage", "yImage")}
    return ObjectTable(columns | {"x": table["xImage"] - 1.0, "y": table["yImage"] - 1.0}, table.meta)


def check_orders(path: PathLike, orders: ObjectTable, count: int, gratings: Gratings) -> None:
    """Raise InputError if the orders read from `path` are not of `count` objects and instrument.grating.Gratings."""
    known = {(piece.name, number) for piece, _ in gratings.pieces for number in piece.orders}
    places = zip(map(str, orders["grating"]), orders["order"].tolist(), strict=True)
    strange = next((place for place in places if place not in known), None)
    if strange is not None:
        raise InputError("no such order of this chip's gratings", file=path, key="grating, order", value=strange)
    outside = (orders["row"] < 0) | (orders["row"] >= count)
    if outside.any():
        value = int(orders["row"][outside][0])
        raise InputError(
            "no such object in the truth table", file=path, key="row", value=value, allowed=f"0 to {count - 1}"
        )
