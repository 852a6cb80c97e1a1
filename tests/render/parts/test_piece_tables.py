"""Tables of objects in pieces: which values add up, which are one piece's, boxes, and flags of all or of any."""

import numpy as np
import pytest

from csstsim.catalog.flags import NEGATIVE_CLIPPED, OFF_CHIP, SATURATED, SKIPPED_FAINT
from csstsim.catalog.table import ObjectTable
from csstsim.render.parts.piece_tables import SHARE, gathered, orders_of

OWNER = np.array([0, 1, 1, 1, 2, 2])


def pieces():
    """One of object 0, three of object 1, of which the second and third are drawn, two of object 2, none drawn."""
    box = np.zeros((6, 4), np.int32)
    box[[0, 2, 3]] = [9, 12, 3, 5], [40, 48, 20, 25], [30, 44, 22, 29]
    flags = SKIPPED_FAINT, OFF_CHIP, SATURATED, NEGATIVE_CLIPPED, OFF_CHIP | SATURATED, OFF_CHIP
    return ObjectTable({
        "method": np.array(["stamp", "none", "photons", "stamp", "none", "none"]),
        "electrons": np.array([10.0, 20.0, 30.0, 50.0, 4.0, 0.0]),
        "drawn": np.array([9.0, 0.0, 25.0, 45.0, 0.0, 0.0]),
        "snr": np.array([1.0, 2.0, 3.0, 4.0, 5.0, 6.0], np.float32),
        "error": np.array([0.1, 0.2, 0.3, 0.4, 0.5, 0.6], np.float32),
        "ms": np.array([1.0, 2.0, 4.0, 8.0, 16.0, 32.0], np.float32),
        "stamp": np.array([5, 0, 7, 3, 0, 0], np.int32),
        "flags": np.array(flags, np.int32),
    } | dict(zip(("x0", "x1", "y0", "y1"), box.T, strict=True)))  # fmt: skip


def test_pieces_make_one_row_for_each_object():
    table = gathered(ObjectTable({"id": np.array([7, 8, 9])}), OWNER, pieces())
    assert table["id"].tolist() == [7, 8, 9]
    assert table["electrons"].tolist() == [10.0, 100.0, 4.0] and table["drawn"].tolist() == [9.0, 70.0, 0.0]
    assert table["fraction"] == pytest.approx([0.9, 0.7, 0.0])
    assert table["ms"].tolist() == [1.0, 14.0, 48.0] and table["stamp"].tolist() == [5, 7, 0]
    # of the first that was drawn, else of the first
    assert table["method"].tolist() == ["stamp", "photons", "none"]
    assert table["snr"].tolist() == [1.0, 3.0, 5.0] and table["error"] == pytest.approx([0.1, 0.3, 0.5])
    # an object is off the chip if all its pieces are; other flags are those of any piece that was drawn
    assert table["flags"].tolist() == [SKIPPED_FAINT, SATURATED | NEGATIVE_CLIPPED, OFF_CHIP]
    boxes = np.transpose([table[name] for name in ("x0", "x1", "y0", "y1")]).tolist()
    assert boxes == [[9, 12, 3, 5], [30, 48, 20, 29], [0, 0, 0, 0]]
    kinds = {name: table[name].dtype for name in ("flags", "stamp", "ms", "x0", "y1")}
    assert kinds == {"flags": np.int32, "stamp": np.int32, "ms": np.float32, "x0": np.int32, "y1": np.int32}


def test_no_objects_have_no_pieces():
    none = pieces().take(np.zeros(0, int))
    table = gathered(ObjectTable({"id": np.zeros(0, int)}), np.zeros(0, int), none)
    assert len(table) == 0 and {"flags", "x0", "fraction"} <= set(table)
    assert SHARE == "trail_share"


def test_orders_of_pieces_make_one_row_for_each_object_order_and_grating():
    """Pieces 0 and 2 are of object 4, piece 1 of object 3: sums, boxes, any piece's cut, positions of the brightest."""
    orders = ObjectTable({
        "row": np.array([0, 2, 2, 0, 1, 2], np.int32),
        "order": np.array([1, 1, 0, 1, 1, 1], np.int8),
        "grating": np.array(["L", "L", "L", "R", "L", "L"]),
        "x": np.array([10.0, 11.0, 12.0, 13.0, 14.0, 15.0]),
        "electrons": np.array([5.0, 9.0, 1.0, 2.0, 7.0, 3.0]),
        "drawn": np.array([4.0, 8.0, 1.0, 2.0, 6.0, 3.0]),
        "cut": np.array([False, False, False, True, False, True]),
        "x0": np.array([20, 10, 5, 0, 7, 30], np.int32), "x1": np.array([30, 15, 9, 0, 8, 33], np.int32),
        "y0": np.array([2, 4, 6, 0, 1, 3], np.int32), "y1": np.array([8, 9, 7, 0, 2, 4], np.int32),
    })  # fmt: skip
    table = orders_of(orders, np.array([4, 3, 4]), None)
    rows = [tuple(row) for row in zip(*(table[n].tolist() for n in ("row", "order", "grating", "x")), strict=True)]
    assert rows == [(3, 1, "L", 14.0), (4, 0, "L", 12.0), (4, 1, "L", 11.0), (4, 1, "R", 13.0)]
    assert table["electrons"].tolist() == [7.0, 1.0, 17.0, 2.0] and table["drawn"].tolist() == [6.0, 1.0, 15.0, 2.0]
    assert table["cut"].tolist() == [False, False, True, True]
    boxes = np.transpose([table[name] for name in ("x0", "x1", "y0", "y1")]).tolist()
    assert boxes == [[7, 8, 1, 2], [5, 9, 6, 7], [10, 33, 2, 9], [0, 0, 0, 0]]
    none = orders.take(np.zeros(0, int))
    assert orders_of(none, np.array([4, 3, 4]), None) is none
