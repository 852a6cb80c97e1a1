"""The table of orders on disk: FITS pixels in the file, 0-based ones in memory, all else unchanged."""

import numpy as np
import pytest

from csstsim.base.errors import InputError
from csstsim.catalog.table import ObjectTable
from csstsim.io.orders import check_orders, orders_table, read_orders, write_orders


@pytest.fixture
def orders():
    return ObjectTable({
        "id": np.array([7, 7, 9]), "row": np.arange(3, dtype=np.int32), "order": np.array([-2, 1, 0], np.int8),
        "grating": np.array(["GV6", "GV6", "GV5"]), "cut": np.array([False, True, False]),
        "x": np.array([0.0, -1500.25, 9215.5]), "y": np.array([1.5, 0.0, 9231.0]), "p": np.array([1.0, 2.0, 3.0]),
        "q": np.full(3, 0.14), "r": np.zeros(3), "s": np.full(3, 1e-3), "electrons": np.full(3, 9.0),
        "drawn": np.full(3, 8.0),
        "wave_min": np.array([3790.5, 4000.0, 5000.0], np.float32),
    })  # fmt: skip


def test_fits_pixels_on_disk_and_back(orders, tmp_path):
    path = tmp_path / "orders.parquet"
    write_orders(path, orders, {"recipe": "abc"})
    on_disk = ObjectTable.read(path)
    assert on_disk["xImage"].tolist() == [1.0, -1499.25, 9216.5] and "x" not in on_disk
    back = read_orders(path)
    assert back.meta == {"recipe": "abc"}
    assert set(back.names) == set(orders.names)
    for name in orders:
        assert back[name].tolist() == orders[name].tolist()
        if name != "grating":
            assert back[name].dtype == orders[name].dtype


def test_no_rows_and_no_file(orders, tmp_path):
    path = tmp_path / "orders.parquet"
    write_orders(path, orders.take(np.zeros(0, int)), {})
    assert len(read_orders(path)) == 0 and set(read_orders(path).names) == set(orders.names)
    with pytest.raises(InputError, match=r"nothing\.parquet"):
        read_orders(tmp_path / "nothing.parquet")


@pytest.mark.parametrize("name", ["q", "row", "xImage"])
def test_a_column_is_missing(orders, tmp_path, name):
    path = tmp_path / "orders.parquet"
    write_orders(path, orders, {})
    table = ObjectTable.read(path)
    ObjectTable({other: table[other] for other in table.names if other != name}).write(path, {})
    with pytest.raises(InputError, match=f"{name}.*required column is missing"):
        read_orders(path)


def test_a_place_is_not_a_number(orders, tmp_path):
    path = tmp_path / "orders.parquet"
    write_orders(path, orders.with_columns(p=np.array([1.0, np.nan, 3.0])), {})
    with pytest.raises(InputError, match="p: not finite"):
        read_orders(path)


@pytest.mark.parametrize("change", [{"row": 3}, {"row": -1}, {"grating": "XX9"}, {"order": 7}])
def test_orders_of_another_chip_or_table(orders, camera, change):
    gratings = camera.gratings[29]
    good = orders.with_columns(grating=np.full(3, gratings.left.name))
    check_orders("orders.parquet", good, 3, gratings)
    ((name, value),) = change.items()
    bad = good.with_columns(**{name: np.array([good[name][0], value, good[name][2]])})
    with pytest.raises(InputError, match=r"orders\.parquet.*no such"):
        check_orders("orders.parquet", bad, 3, gratings)


def test_a_row_beyond_the_table_is_named(orders, camera):
    gratings = camera.gratings[29]
    good = orders.with_columns(grating=np.full(3, gratings.left.name))
    with pytest.raises(InputError, match=r"row: no such object.*got 2\); allowed: 0 to 1"):
        check_orders("orders.parquet", good, 2, gratings)
    with pytest.raises(InputError, match=r"grating, order: .*'XX9', 1"):
        check_orders("o", good.with_columns(grating=np.array([good["grating"][0], "XX9", "YY9"])), 3, gratings)
    check_orders("orders.parquet", good.with_columns(grating=np.full(3, gratings.right.name)), 3, gratings)


@pytest.mark.parametrize("name", ["x", "y", "p", "q", "r", "s"])
@pytest.mark.parametrize("value", [np.nan, -np.inf])
def test_no_place_may_be_infinite(orders, tmp_path, name, value):
    path = tmp_path / "orders.parquet"
    write_orders(path, orders.with_columns(**{name: np.array([1.0, 2.0, value])}), {})
    with pytest.raises(InputError, match={"x": "xImage", "y": "yImage"}.get(name, name) + ": not finite"):
        read_orders(path)


def test_rows_are_on_disk_from_1_in_both_axes(orders, tmp_path):
    write_orders(tmp_path / "o.parquet", orders, {})
    table = ObjectTable.read(tmp_path / "o.parquet")
    assert table["yImage"].tolist() == [2.5, 1.0, 9232.0] and "y" not in table


@pytest.mark.parametrize("name", ["id", "order", "grating", "cut", "yImage", "p", "r", "s", "electrons", "drawn"])
def test_every_column_that_readers_use_is_missed(orders, tmp_path, name):
    table = orders_table(orders)
    ObjectTable({other: table[other] for other in table if other != name}).write(tmp_path / "o.parquet", {})
    with pytest.raises(InputError, match=f"o.parquet: {name}: required column is missing"):
        read_orders(tmp_path / "o.parquet")
