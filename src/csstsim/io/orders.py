"""The truth of dispersed light beside a Level-0 file of a spectroscopic chip: a row for each object and order.

| column | what it is |
|---|---|
| id, row | the object, and its row in the truth table (io.truth) |
| order, grating | -2 to 2, GI1 ... |
| cut | its stamp reaches beyond the piece's edge: `electrons` is of all its light, `drawn` of this piece's |
| xImage, yImage | where its light would fall without the grating, FITS pixels (centre of the first at 1) |
| p, q, r, s | light of lambda [angstrom] lands at x + p + q lambda, y + r + s lambda [px] |
| xoff, yoff, a0, a1, alpha0, alpha1 | the same as aXe has it (instrument.axe): the trace's polynomials at x, y |
| electrons, drawn | of the whole order; put on the window |
| x0, x1, y0, y1 | box of what was drawn, half-open, a numpy slice of the full frame; zeros: nothing |
| wave_min, wave_max | angstrom, what of the trace lands on the window; NaN: nothing, at most a stamp's edge or a wing |

An order of less than an electron, none of which was drawn, has no row.
"""

from csstsim.catalog.table import ObjectTable


def write_orders(path, orders, metadata):
    """Write the table of orders, x and y 0-based as render.draw_dispersed gives them."""
    columns = {name: orders[name] for name in orders.names if name not in ("x", "y")}
    ObjectTable(columns | {"xImage": orders["x"] + 1.0, "yImage": orders["y"] + 1.0}).write(path, metadata)


def read_orders(path):
    """Return the table of orders with 0-based x, y. Raises InputError."""
    table = ObjectTable.read(path)
    columns = {name: table[name] for name in table.names if name not in ("xImage", "yImage")}
    return ObjectTable(columns | {"x": table["xImage"] - 1.0, "y": table["yImage"] - 1.0}, table.meta)
