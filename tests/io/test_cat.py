"""The truth as text: what it holds, that strangers read it, and that the mission's own forms of it are read."""

import warnings
from types import SimpleNamespace

import numpy as np
import pytest
from astropy.table import Table
from support.csst import BANDS

from csstsim.base.errors import InputError
from csstsim.catalog.table import ObjectTable
from csstsim.io.cat import cat_lines, read_cat, write_cat
from csstsim.io.truth import CAT_COLUMNS, truth_table

CHIP = SimpleNamespace(id=9, filter="r")
NUMBERS = [name for name in CAT_COLUMNS if name not in ("filter", "obj_type")]


def truth(count):
    rng = np.random.default_rng(7)
    kind = np.arange(count) % 3
    columns = {
        "id": 2**40 + np.arange(count), "obj_type": kind, "ra": rng.uniform(0, 360, count),
        "dec": rng.uniform(-90, 90, count), "z": rng.random(count), "kappa": 0.1 * rng.random(count),
        "gamma1": 0.05 * rng.random(count), "size_disk": np.where(kind == 1, 0.3, 0.0), "parallax": rng.random(count),
        "bulgemass": np.where(kind == 1, 1e9, np.nan), "teff": np.where(kind == 0, 5800.0, 0.0),
    }  # fmt: skip
    table = ObjectTable.complete(columns, BANDS)
    positions = {"x": rng.uniform(-500, 9700, count), "y": rng.uniform(-500, 9700, count)}
    sky = {"ra_orig": table["ra"], "dec_orig": table["dec"], "mag": rng.uniform(15, 30, count).astype(np.float32)}
    return truth_table(table.with_columns(**positions, **sky), CHIP)


@pytest.mark.parametrize("count", [0, 1, 2, 25_001])
def test_a_stranger_reads_it_with_two_lines_of_astropy(tmp_path, count):
    table, path = truth(count), tmp_path / "a.cat"
    write_cat(path, table)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = Table.read(path, format="ascii" if count else "ascii.commented_header")  # nothing to guess by
    assert found.colnames == list(CAT_COLUMNS) and len(found) == count
    if count:
        assert set(found["obj_type"]) <= {"star", "galaxy", "quasar"} and set(found["filter"]) == {"r"}
        for name in NUMBERS:
            wanted = table[name].astype(float)
            tolerance = {"xImage": 1e-5, "yImage": 1e-5}.get(name, 1e-10 if "ra" in name or "dec" in name else 1e-6)
            np.testing.assert_allclose(found[name].astype(float), wanted, rtol=1e-7, atol=tolerance, err_msg=name)
        assert (found["obj_ID"] == table["obj_ID"]).all()


@pytest.mark.parametrize("count", [0, 1, 30])
def test_round_trip(tmp_path, count):
    table, path = truth(count), tmp_path / "a.cat"
    write_cat(path, table)
    found = read_cat(path)
    assert set(found.names) == set(CAT_COLUMNS.values()) and len(found) == count
    np.testing.assert_allclose(found["x"], table["xImage"] - 1.0, atol=1e-5)
    assert (found["obj_type"] == table["obj_type"]).all() and found["obj_type"].dtype == np.int8
    assert found["id"].dtype == np.int64 or not count
    np.testing.assert_allclose(found["mag"], table["mag"], atol=1e-6)
    assert np.isnan(found["bulgemass"]).sum() == np.isnan(table["bulgemass"]).sum()
    # Once more: the text is the same
    again = {own_name: found[own_name] for own_name in found} | {"x": found["x"] + 1.0, "y": found["y"] + 1.0}
    renamed = ObjectTable({name: again[own_name] for name, own_name in CAT_COLUMNS.items()})
    if count:
        assert "".join(cat_lines(renamed)).split() == path.read_text().split()


FOREIGN = """# Cycle 9
# obj_ID  ra dec mag obj_type size extra
# nothing more
  17   60.0 -40.0 21.5   {star} 0.0 a

  1.8e1 60.1 -40.1 nan {galaxy} 0.4 b
  19 60.2 -40.2 20.0 {quasar} -99 c
"""


@pytest.mark.parametrize(
    "words, understood",
    [
        (("star", "galaxy", "quasar"), ""), (("STAR", "gal", "QSO"), ""), (("0", "1", "2"), "0 star"),
        (("1", "0", "2"), "0 galaxy"), (("1.0", "0.0", "2.0"), "0 galaxy"),
    ],
)  # fmt: skip
def test_other_forms(tmp_path, words, understood):
    (tmp_path / "a.cat").write_text(FOREIGN.format(**dict(zip(("star", "galaxy", "quasar"), words, strict=True))))
    table = read_cat(tmp_path / "a.cat")
    assert list(table["obj_type"]) == [0, 1, 2] and list(table["id"]) == [17, 18, 19]
    assert table.meta["types"].startswith(understood) and list(table["extra"]) == ["a", "b", "c"]
    assert "x" not in table and np.isnan(table["mag"][1])


@pytest.mark.parametrize(
    "text, words",
    [
        ("", "no heading"), ("1 2 3\n", "no heading"), ("# ra dec\n1 2 3\n", "no heading"),
        ("# ra ra\n1 2\n", "ra: column given twice"), ("# ra dec\n1 2\n1 2 3\n", "line 3 has 3 words, not the 2"),
        ("# ra dec\n1 2\n1 x\n", "dec: line 3: must be a number, not 'x'"),
        ("# ra obj_type\n1 planet\n", "obj_type: line 2: unknown type"), ("# ra obj_type\n1 7\n", "unknown type"),
        ("# ra obj_type\n1 nan\n", "unknown type"),
    ],
)  # fmt: skip
def test_faults_name_the_line(tmp_path, text, words):
    (tmp_path / "a.cat").write_text(text)
    with pytest.raises(InputError) as caught:
        read_cat(tmp_path / "a.cat")
    assert "a.cat" in str(caught.value) and "np.str_" not in str(caught.value)
    assert all(word in str(caught.value) for word in words.split(", not ")), str(caught.value)


def test_the_text_of_a_row_is_what_it_was():
    """By hand: the order of the columns, their digits, a word for the type."""
    values = dict.fromkeys(CAT_COLUMNS, np.array([np.nan]))
    values |= {
        "obj_ID": np.array([2**53 + 1]), "ID_chip": np.array([9]), "filter": np.array(["r"]),
        "xImage": np.array([1.0000049]), "yImage": np.array([9216.123456]), "ra": np.array([359.99999999994]),
        "dec": np.array([-0.00000000006]), "obj_type": np.array([2]), "mag": np.array([20.1234564]),
        "galType": np.array([-1]), "z": np.array([0.123456789]), "size": np.array([1e-9]),
    }  # fmt: skip
    head, row = "".join(cat_lines(ObjectTable(values))).splitlines()
    assert head == "# " + " ".join(CAT_COLUMNS)
    found = dict(zip(CAT_COLUMNS, row.split(" "), strict=True))
    exact = "obj_ID", "ID_chip", "filter", "xImage", "yImage", "ra", "dec", "z", "mag"
    assert [found.pop(name) for name in exact] == [
        "9007199254740993", "9", "r", "1.00000", "9216.12346", "359.9999999999", "-0.0000000001", "0.12345679",
        "20.123456",
    ]  # fmt: skip
    assert [found.pop(name) for name in ("obj_type", "galType", "size")] == ["quasar", "-1", "1e-09"]
    assert set(found.values()) == {"nan"}


def test_types_beyond_those_that_are_known_are_numbers():
    values = {name: np.zeros(4) for name in CAT_COLUMNS} | {"obj_type": np.array([3, 4, 5, -1])}
    at = list(CAT_COLUMNS).index("obj_type")
    rows = "".join(cat_lines(ObjectTable(values))).splitlines()[1:]
    assert [row.split()[at] for row in rows] == ["asteroid", "satellite", "5", "-1"]


def test_both_axes_count_from_0_when_read(tmp_path):
    (tmp_path / "a.cat").write_text("# xImage yImage pm_ra RV\n1.5 20.25 3 4\n")
    table = read_cat(tmp_path / "a.cat")
    assert {name: table[name].tolist() for name in table} == {"x": [0.5], "y": [19.25], "pmra": [3.0], "rv": [4.0]}


@pytest.mark.parametrize(("text", "names", "first"), [
    ("# a file of 3\n# ra dec\n1 2\n", ["ra", "dec"], [1.0]),
    ("# ra dec\n\n# one\n1 2\n# dec ra\n3 4\n", ["ra", "dec"], [1.0, 3.0]),  # remarks between the rows
    ("# ra z\n# ra dec\n1 2\n", ["ra", "dec"], [1.0]),  # the last of those that fit
    ("## ra dec\n", ["ra", "dec"], []),
])  # fmt: skip
def test_which_remark_is_the_heading(tmp_path, text, names, first):
    (tmp_path / "a.cat").write_text(text)
    table = read_cat(tmp_path / "a.cat")
    assert list(table) == names and table["ra"].tolist() == first


def test_numbers_of_ids_are_exact_and_others_of_ours_are_refused_by_their_line(tmp_path):
    (tmp_path / "a.cat").write_text(f"# obj_ID galType\n{2**53 + 1} -1\n\n{2**62} 1\n")
    assert read_cat(tmp_path / "a.cat")["id"].tolist() == [2**53 + 1, 2**62]
    (tmp_path / "a.cat").write_text("# ra z\n1 2\n\n# a remark\n1 2\n1 north\n")
    with pytest.raises(InputError, match=r"z: line 6: must be a number.*'north'"):
        read_cat(tmp_path / "a.cat")
    (tmp_path / "a.cat").write_text("# ra obj_type\n1 star\n\n2 planet\n")
    with pytest.raises(InputError, match=r"line 4: unknown type \(got 'planet'\); allowed: star, galaxy, quasar"):
        read_cat(tmp_path / "a.cat")


@pytest.mark.parametrize(("sizes", "types"), [
    ((0.3, 0.4, 0.0), [1, 1, 0]), ((0.3, np.nan, 0.5), [0, 0, 1]), ((np.nan, np.nan, np.nan), [0, 0, 1]),
    ((-99, -99, 0.1), [0, 0, 1]),
])  # fmt: skip
def test_those_with_sizes_are_the_galaxies(tmp_path, sizes, types):
    """Of equally many on both sides our own numbers count; a size that is not known is none."""
    rows = "\n".join(f"{kind} {size}" for kind, size in zip((0, 0, 1), sizes, strict=True))
    (tmp_path / "a.cat").write_text(f"# obj_type size\n{rows}\n")
    assert read_cat(tmp_path / "a.cat")["obj_type"].tolist() == types
