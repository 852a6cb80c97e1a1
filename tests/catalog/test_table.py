"""ObjectTable and MockObject: columns, rows, files."""

import numpy as np
import pytest
from csst import BANDS

from csstsim.base.errors import InputError
from csstsim.catalog.mock_object import MockObject, MockObjects
from csstsim.catalog.table import ObjectTable, columns_with


@pytest.fixture
def table():
    return ObjectTable.complete(
        {"id": [1, 2, 3], "obj_type": [0, 1, 2], "ra": [10.0, 20.0, np.nan], "note": ["a", "b", "c"]}, BANDS
    )


def test_complete_fills_every_column_in_its_type(table):
    assert table.names == (*columns_with(BANDS), "note") and len(table) == 3 and "z" in table
    for name, (dtype, _, _) in columns_with(BANDS).items():
        assert table[name].dtype == dtype and table[name].shape == (3,)
    assert np.isnan(table["mag_g"]).all() and not table["flags"].any()


def test_empty_table_has_all_columns():
    empty = ObjectTable.complete({}, BANDS)
    assert len(empty) == 0 and not empty and empty.names == tuple(columns_with(BANDS))
    assert ObjectTable.concat([]) == ObjectTable.complete({}, ()) and ObjectTable.concat([empty, empty]) == empty


def test_bad_columns_are_refused():
    with pytest.raises(ValueError, match="different length"):
        ObjectTable({"a": [1], "b": [1, 2]})
    with pytest.raises(InputError, match="ra: does not fit"):
        ObjectTable.complete({"ra": ["north"]}, BANDS)


def test_take_and_concat(table):
    mask, index = table.take(table["obj_type"] > 0), table.take([1, 2])
    assert mask == index and list(mask["id"]) == [2, 3]
    assert ObjectTable.concat([table.take([0]), mask]) == table
    assert table.take(np.array([], int)).names == table.names
    assert table.take([0]) != table.take([1])


def test_with_columns_does_not_touch_the_original(table):
    more = table.with_columns(ra=np.zeros(3))
    assert not more["ra"].any() and table["ra"][0] == 10.0


@pytest.mark.parametrize("dtype", ["i1", "i8", "u2", "f4", "f8", "?", "U3"])
@pytest.mark.parametrize("count", [4, 0])
def test_columns_of_any_memory_are_written_as_they_are(tmp_path, dtype, count):
    values = np.arange(12).astype(dtype)
    columns = {"whole": values[:4], "strided": values[::3], "reversed": values[3::-1]}
    columns["repeated"] = np.broadcast_to(values[5], 4)
    columns = {name: column[:count] for name, column in columns.items()}
    ObjectTable(columns, {}).write(tmp_path / "t.parquet")
    back = ObjectTable.read(tmp_path / "t.parquet")
    for name, expected in columns.items():
        np.testing.assert_array_equal(back[name], expected)
        assert dtype == "U3" or back[name].dtype == dtype


@pytest.mark.parametrize("rows", [[0, 1, 2], [1], []])
def test_file_round_trip(table, tmp_path, rows):
    part = table.take(np.array(rows, int))
    part.write(tmp_path / "t.parquet", {"seed": 1, "nested": {"a": [1, 2]}})
    back = ObjectTable.read(tmp_path / "t.parquet")
    assert back.meta == {"seed": 1, "nested": {"a": [1, 2]}}
    assert list(back["note"]) == list(part["note"])
    assert back.take(slice(None)).with_columns(note=part["note"]) == part
    assert ObjectTable.read(tmp_path / "t.parquet", columns=["ra", "id"]).names == ("ra", "id")


def test_no_flipped_bit_passes_unseen(table, tmp_path):
    """120 random bits of the file: each flip is refused or does not matter."""
    path, rng = tmp_path / "t.parquet", np.random.default_rng(1)
    table.write(path, {"seed": 1})
    whole, refused = path.read_bytes(), 0
    expected = ObjectTable.read(path)
    for place in rng.integers(0, len(whole), 120):
        damaged = bytearray(whole)
        damaged[place] ^= 1 << rng.integers(8)
        path.write_bytes(damaged)
        try:
            found = ObjectTable.read(path)
            assert found == expected and found.meta == expected.meta
        except InputError:
            refused += 1
    assert refused > 60


def test_column_that_is_not_there(table, tmp_path):
    table.write(tmp_path / "t.parquet")
    with pytest.raises(InputError, match=r"t\.parquet: nosuch: the table lacks"):
        ObjectTable.read(tmp_path / "t.parquet", columns=["nosuch"])


def test_mock_object_from_keywords():
    obj = MockObject(id=4, type="galaxy", ra=1.0, dec=-2.0, spectrum="x.fits")
    assert (obj.type, obj.position, obj.spectrum) == ("galaxy", (1.0, -2.0), "x.fits")
    assert obj.bulge_frac == 0.0  # a column's default
    assert obj.values == {"id": 4, "ra": 1.0, "dec": -2.0, "spectrum": "x.fits", "obj_type": 1}
    with pytest.raises(AttributeError, match="no 'colour'; it has dec, id"):
        _ = obj.colour
    assert MockObject(obj_type=-1).type == "unknown"
    with pytest.raises(InputError, match="allowed: star, galaxy, quasar"):
        MockObject(type="comet")


def test_mock_object_is_a_view_of_a_row(table):
    objs = MockObjects(table)
    assert len(objs) == 3 and [obj.id for obj in objs] == [1, 2, 3] and objs[-1].type == "quasar"
    table["z"][1] = 0.5
    assert objs[1].z == 0.5 and [obj.id for obj in objs[1:]] == [2, 3]
    with pytest.raises(IndexError):
        objs[3]
