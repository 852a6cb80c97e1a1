"""The canonical order of rows: by id, then by all numbers; and the way back, of tables of orders too."""

import numpy as np
import pytest

from csstsim.catalog.light.object_spectra import ROW
from csstsim.catalog.selection.row_order import back, canonical_order, orders_back
from csstsim.catalog.table import ObjectTable


def test_rising_ids_stay_and_others_are_sorted():
    assert canonical_order(ObjectTable({"id": [1, 2, 9], "mag": [3.0, 2.0, 1.0]})).tolist() == [0, 1, 2]
    assert canonical_order(ObjectTable({"id": [5, 9, 1, 7], "mag": [1.0, 2.0, 3.0, 4.0]})).tolist() == [2, 0, 3, 1]


def test_rows_of_one_id_go_by_their_numbers_in_any_order():
    """Whatever order they come in they end alike: the last column by name decides first; words and ROW do not."""
    columns = {
        "id": np.array([4, 4, 2, 4, 2]), "ra": np.array([1.0, 3.0, 5.0, 2.0, 5.0]),
        "z": np.array([0.5, 0.1, 0.7, 0.1, 0.2]), "name": np.array(["a", "b", "c", "d", "e"]),
    }  # fmt: skip
    wanted = ["e", "c", "d", "b", "a"]
    rng = np.random.default_rng(1)
    for _ in range(5):
        shuffle = rng.permutation(5)
        table = ObjectTable({name: v[shuffle] for name, v in columns.items()} | {ROW: np.arange(5)})
        assert table["name"][canonical_order(table)].tolist() == wanted


def test_rows_that_are_alike_keep_their_order():
    table = ObjectTable({"id": [3, 3, 3], "z": [1.0, 1.0, 1.0], "name": ["b", "a", "c"]})
    assert canonical_order(table).tolist() == [0, 1, 2]


@pytest.mark.parametrize("count", [0, 1, 6])
def test_the_way_back(count):
    order = np.random.default_rng(2).permutation(count)
    values = np.arange(count) * 10
    assert values[order][back(order)].tolist() == values.tolist()
    assert back(order).dtype == np.int64


def test_orders_get_the_rows_of_the_table_as_it_was():
    order = np.array([2, 0, 1])  # the first object drawn is row 2
    orders = ObjectTable({
        "row": np.array([0, 0, 1, 2, 2], np.int32), "order": np.array([1, -1, 0, 2, 1], np.int8),
        "light": np.array([20.0, 21.0, 0.0, 10.0, 11.0]),
    })  # fmt: skip
    made = orders_back(orders, order)
    assert made["row"].tolist() == [0, 1, 1, 2, 2] and made["row"].dtype == np.int32
    assert made["order"].tolist() == [0, 1, 2, -1, 1]
    assert made["light"].tolist() == [0.0, 11.0, 10.0, 21.0, 20.0]
