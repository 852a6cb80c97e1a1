"""ObjectTable and MockObject: columns, rows, files."""

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from support.csst import BANDS

from csstsim.base.errors import InputError
from csstsim.catalog import table as module
from csstsim.catalog.mock_object import MockObject, MockObjects
from csstsim.catalog.table import COLUMNS, OPTIONAL, TYPES, ObjectTable, columns_with, footer, lensed


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


def test_types_and_who_is_behind_a_lens():
    assert TYPES == ("star", "galaxy", "quasar", "asteroid", "satellite")
    assert lensed([0, 1, 2, 3, 4, -1]).tolist() == [False, True, True, False, False, False]


def test_what_stands_for_a_value_that_is_not_given():
    """Defaults decide what is drawn: unknown masses and magnitudes are no numbers, all else is zero or none."""
    zero = set(COLUMNS) - {"ra", "dec", "stellarmass", "bulgemass", "diskmass", "veldisp", "sfr", "metallicity",
                           "stellarage", "halomass", "satellite", "gal_type", "host"}  # fmt: skip
    table = ObjectTable.complete({"id": [0, 1]}, BANDS)
    for name in set(columns_with(BANDS)) - {"id"}:
        if name in zero:
            assert not table[name].any(), name
        else:
            value = -1 if name in ("satellite", "gal_type", "host") else np.nan
            np.testing.assert_array_equal(table[name], [value, value], err_msg=name)
    defaults = {name: default for name, (_, default, _) in OPTIONAL.items()}
    assert (defaults["n_disk"], defaults["n_bulge"], defaults["part_of"]) == (1.0, 4.0, -1)
    assert not any(defaults[name] for name in set(OPTIONAL) - {"n_disk", "n_bulge", "part_of"})
    obj = MockObject(id=1)
    assert (obj.n_bulge, obj.part_of, obj.image_file, obj.type) == (4.0, -1, "", "star")
    assert np.isnan(obj.mag_of_any_band) and np.isnan(obj.ra) and obj.host == -1
    with pytest.raises(AttributeError, match="mag_norm"):
        _ = obj.mag_norm
    assert repr(MockObject(id=4, type="quasar", ra=1.0, dec=-2.0)) == "MockObject(quasar 4 at ra=1.0, dec=-2.0)"


def test_a_table_is_shown_by_its_rows_and_columns():
    assert repr(ObjectTable({"id": [1, 2], "ra": [1.0, 2.0]})) == "<ObjectTable: 2 rows; id, ra>"
    assert repr(ObjectTable({"id": [1]})) == "<ObjectTable: 1 row; id>"


def test_magnitudes_stand_after_the_redshift():
    names = list(columns_with(("a", "b")))
    assert names[names.index("z") :][:4] == ["z", "mag_a", "mag_b", "teff"] and len(names) == len(COLUMNS) + 2


def test_scalars_fill_columns_and_optional_ones_have_their_type():
    columns = {"id": [1, 2, 3], "kappa": 0.5, "n_disk": 2, "note": "x", "knots": [1.0, 2.0, 3.0]}
    full = ObjectTable.complete(columns, BANDS)
    assert full["kappa"].tolist() == [0.5] * 3 and full["kappa"].dtype == np.float32
    assert full["n_disk"].dtype == np.float32 and full["knots"].dtype == np.int32 and full["note"].tolist() == ["x"] * 3
    slim = ObjectTable.complete({"id": [1, 2, 3], "kappa": 0.5}, BANDS, compact=True)
    assert slim["kappa"].tolist() == [0.5] * 3 and slim["kappa"].strides == (0,) and full["kappa"].strides == (4,)


@pytest.mark.parametrize("name, value", [
    ("id", 1.5), ("id", np.nan), ("id", 2.0**64), ("obj_type", 300), ("host", np.inf), ("knots", 2.5), ("flags", 2**40),
])  # fmt: skip
def test_whole_numbers_are_not_changed(name, value):
    with pytest.raises(InputError, match=f"{name}: does not fit the column"):
        ObjectTable.complete({"id": [1], name: [value]}, BANDS)
    assert ObjectTable.complete({"id": [3.0], "obj_type": [2.0]}, BANDS)["obj_type"].tolist() == [2]


def test_a_table_in_parts(monkeypatch, table):
    """Two rows a part, the last one shorter; nothing is one empty part."""
    monkeypatch.setattr(module, "ROWS", 2)
    parts = list(table.parts())
    assert [(first, part["id"].tolist()) for first, part in parts] == [(0, [1, 2]), (2, [3])]
    assert [(first, len(part)) for first, part in table.take(slice(0, 0)).parts()] == [(0, 0)]


def test_meta_goes_with_rows_columns_and_the_first_of_several(table, tmp_path):
    first, second = ObjectTable({"a": [1]}, {"k": 1}), ObjectTable({"a": [2]}, {"k": 2})
    joined = ObjectTable.concat([first, second])
    assert joined.meta == {"k": 1} and joined["a"].tolist() == [1, 2]
    assert first.take([0]).meta == first.with_columns(b=[3]).meta == {"k": 1}
    first.write(tmp_path / "own.parquet")
    second.write(tmp_path / "other.parquet", {"k": 3})
    assert [ObjectTable.read(tmp_path / f"{name}.parquet").meta["k"] for name in ("own", "other")] == [1, 3]
    assert footer(tmp_path / "own.parquet").num_rows == 1
    (tmp_path / "text.parquet").write_text("text")
    with pytest.raises(InputError, match=r"text\.parquet: not a readable parquet file"):
        footer(tmp_path / "text.parquet")


def test_tables_that_differ_in_type_name_or_order_are_not_equal():
    one = ObjectTable({"a": np.array([1, 2]), "b": np.array([1.0, np.nan])})
    assert one == ObjectTable({"a": np.array([1, 2]), "b": np.array([1.0, np.nan])})
    for other in ({"b": one["b"], "a": one["a"]}, {"a": one["a"].astype(np.int32), "b": one["b"]}, {"a": one["a"]},
                  {"a": one["a"], "b": np.array([1.0, 2.0])}):  # fmt: skip
        assert one != ObjectTable(other)
    assert one != 3


@pytest.mark.parametrize("name", ["ra", "mag_x"])
def test_words_where_numbers_are_due_are_refused_by_name(tmp_path, name):
    ObjectTable({"id": np.array([1, 2]), name: np.array(["a", "b"])}).write(tmp_path / "t.parquet")
    with pytest.raises(InputError, match=f"{name}: must be numbers"):
        ObjectTable.read(tmp_path / "t.parquet")


def test_some_columns_are_checked_and_others_may_be_damaged(tmp_path):
    """A column that does not have its checksum is seen when it is read; metadata are always checked."""
    path = tmp_path / "t.parquet"
    ObjectTable({"a": np.arange(3), "b": np.arange(3.0)}, {"k": 1}).write(path)
    arrow = pq.read_table(path)
    about = arrow.schema.metadata
    pq.write_table(arrow.set_column(1, "b", pa.array([0.0, 1.0, 2.5])).replace_schema_metadata(about), path)
    assert ObjectTable.read(path, ["a"])["a"].tolist() == [0, 1, 2]
    for columns in (None, ["a", "b"]):
        with pytest.raises(InputError, match="damaged: a column does not have its recorded checksum"):
            ObjectTable.read(path, columns)
    pq.write_table(arrow.replace_schema_metadata(about | {b"csstsim": b'{"k": 2}'}), path)
    with pytest.raises(InputError, match="damaged"):
        ObjectTable.read(path, ["a"])
    pq.write_table(arrow.replace_schema_metadata(about | {b"csstsim": b"{"}), path)
    with pytest.raises(InputError, match="damaged: its metadata cannot be read"):
        ObjectTable.read(path)


def test_truths_and_lists_come_back(tmp_path):
    columns = {"odd": np.arange(11) % 2 == 1, "word": np.array([f"w{k}é" for k in range(11)])}
    lists = np.empty(11, object)
    lists[:] = [[float(k)] * (k % 3) for k in range(11)]
    ObjectTable(columns | {"list": lists}).write(tmp_path / "t.parquet")
    back = ObjectTable.read(tmp_path / "t.parquet")
    assert back["odd"].tolist() == columns["odd"].tolist() and back["word"].tolist() == columns["word"].tolist()
    assert [list(value) for value in back["list"]] == [list(value) for value in lists]


def test_who_reads_a_file_keeps_it_while_it_is_written_anew(tmp_path):
    """A file that was opened before is the one from before to its end; no other file is left in the folder."""
    path = tmp_path / "t.parquet"
    ObjectTable({"a": np.arange(5)}, {"k": 1}).write(path)
    content = path.read_bytes()
    with open(path, "rb") as before:
        ObjectTable({"a": np.arange(9)}, {"k": 2}).write(path)
        assert before.read() == content
    assert len(ObjectTable.read(path)) == 9 and [file.name for file in tmp_path.iterdir()] == ["t.parquet"]


def test_a_table_of_more_rows_than_a_row_group_comes_back(tmp_path):
    count = (1 << 20) + 5
    columns = {"a": np.arange(count) % 7 == 0, "b": np.arange(count, dtype=np.int32)}
    ObjectTable(columns).write(tmp_path / "t.parquet")
    assert footer(tmp_path / "t.parquet").num_row_groups == 2
    back = ObjectTable.read(tmp_path / "t.parquet")
    for name, values in columns.items():
        np.testing.assert_array_equal(back[name], values)
