"""The truth table of dispersed light for a Level-0 file of a spectroscopic chip (paper, section 4.2): a row per order.

An order of less than one electron has no row if no electron of it was rendered.
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
    "cut": "its stamp extends beyond the edge of the grating's piece: `drawn` counts this piece only, `electrons` all; "
    "False where only the window cuts the spectrum: see wave_min, wave_max",
    **dict.fromkeys(("p", "q", "r", "s"), "wavelength lambda [angstrom] is at x + p + q lambda, y + r + s lambda [px]"),
    **dict.fromkeys(
        ("xoff", "yoff", "a0", "a1", "alpha0", "alpha1"), "the trace in the form of aXe: polynomials at x, y"
    ),
    "electrons": "electrons of the whole order",
    "drawn": "electrons rendered in the window",
    **dict.fromkeys(("x0", "x1", "y0", "y1"), "px, box of the rendered pixels, half-open, full frame; zeros: none"),
    "wave_min": "angstrom, where the trace in the window begins; NaN: no trace, at most a stamp's edge or a wing",
    "wave_max": "angstrom, where it ends",
    "xImage": "FITS px (centre of the first at 1), position of the object without the grating",
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
    """Write the table of orders of render.slitless.draw_dispersed, whose x and y are 0-based."""
    orders_table(orders).write(path, metadata)


def orders_table(orders: ObjectTable) -> ObjectTable:
    """Return the columns of the file as an ObjectTable, from the table of render.slitless.draw_dispersed."""
    columns = {name: orders[name] for name in orders.names if name not in ("x", "y")}
    return ObjectTable(columns | {"xImage": orders["x"] + 1.0, "yImage": orders["y"] + 1.0})


def read_orders(path: PathLike) -> ObjectTable:
    """Read the table of orders of a Level-0 file.

    Parameters
    ----------
    path : str or Path
        The parquet file.

    Returns
    -------
    ObjectTable
        One row per order of an object, with the columns of COLUMNS. x and y [px] count from 0.

    Raises
    ------
    InputError
        If a column is missing, or a position or trace is not finite.
    """
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
    """Raise InputError if an order read from `path` is not one of `gratings`, or not of one of `count` objects."""
    known = {(piece.name, number) for piece, _ in gratings.pieces for number in piece.orders}
    identities = zip(map(str, orders["grating"]), orders["order"].tolist(), strict=True)
    unknown = next((identity for identity in identities if identity not in known), None)
    if unknown is not None:
        raise InputError("no such order of this chip's gratings", file=path, key="grating, order", value=unknown)
    outside = (orders["row"] < 0) | (orders["row"] >= count)
    if outside.any():
        value = int(orders["row"][outside][0])
        raise InputError(
            "no such object in the truth table", file=path, key="row", value=value, allowed=f"0 to {count - 1}"
        )
