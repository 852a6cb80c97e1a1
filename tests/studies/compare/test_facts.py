"""Words and sizes of differences, without files: arrays, records, names, pages."""

import json
import os
from itertools import permutations

import numpy as np
import pyarrow as pa
import pytest

from csstsim.catalog.table import write_parquet
from csstsim.studies.compare.compare import compare, facts
from csstsim.studies.compare.content import content_hash
from csstsim.studies.compare.facts import Difference, array_facts, only_in_one, short_repr
from csstsim.studies.compare.records import record_facts
from csstsim.studies.compare.tables import footer_facts, table_facts, unit_of
from csstsim.studies.compare.texts import page_facts, properties_facts, text_facts
from csstsim.studies.compare.varying import is_provenance, steady_page, varies


def texts(facts):
    return [fact.text for fact in facts]


def test_pieces_of_a_difference_are_added_up():
    """The first position is of the first piece that differs; the rms is over all values that differ by a number."""
    found = Difference("pixels", "DN")
    assert found.text() == ""
    for start, a, b in ((0, [1.0, 2.0], [1.0, 2.0]), (2, [3.0, 4.0], [3.0, 1.0]), (4, [5.0, np.nan], [9.0, 1.0])):
        found.add(np.array(a), np.array(b), lambda i, start=start: f"at {start + i}")
    assert found.text() == (
        "3 of 6 pixels differ, by at most 4 DN, rms 3.53553 DN, 1 of them by NaN or infinity, first at 3: 4.0 and 1.0"
    )


@pytest.mark.parametrize("order", list(permutations(range(3))))
def test_the_largest_difference_is_that_of_any_piece(order):
    found = Difference("pixels")
    for piece in order:
        found.add(np.zeros(2), np.array([0.0, (1.0, -4.0, 2.0)[piece]]), lambda i: f"at {i}")
    assert "3 of 6 pixels differ, by at most 4, rms 2.64575, first at 1" in found.text()


@pytest.mark.parametrize(("a", "b", "words"), [
    (np.array([[1, 2, 3], [4, 5, 6]]), np.array([[1, 2, 3], [4, 5, 9]]), ["1 of 6", "at most 3", "at 1, 2: 6 and 9"]),
    (np.array([[1, 2, 3]], np.uint8), np.array([[1, 9, 3]], np.int16), ["uint8 and int16"]),
    (np.array(5.0), np.array(7.0), ["1 of 1 values differs, by at most 2"]),
    (np.array(["a", "b"], object), np.array(["a", "c"], object), ["1 of 2", "first at 1: 'b' and 'c'"]),
    (np.array(["1"], object), np.array([1]), ["text and int64"]),
    (np.zeros((2, 3)), np.zeros((3, 2)), ["shape (2, 3) and (3, 2)"]), (np.zeros(0), np.zeros(0), []),
    (np.zeros((2, 3)), np.zeros((2, 3)), []),
])  # fmt: skip
@pytest.mark.parametrize("step", [1, 4, 1 << 22])
def test_arrays(a, b, words, step):
    position = lambda *index: f"at {', '.join(map(str, index))}"  # noqa: E731
    found = texts(array_facts("x", a, b, noun="values", position=position, step=step))
    assert bool(found) == bool(words) and all(word in " ".join(found) for word in words), found
    assert all(text.startswith("x: ") for text in found)
    if a.dtype != b.dtype and a.dtype.kind == "u":
        assert found[0] == "x: uint8 and int16" and "1 of 3 values differs, by at most 7" in found[1]


def test_names_of_one_side_are_listed_up_to_five():
    assert texts(only_in_one("planes", "abc", "bcd")) == ["only A has the planes a", "only B has the planes d"]
    assert texts(only_in_one("rows", range(5), [])) == ["only A has the rows 0, 1, 2, 3, 4"]
    assert texts(only_in_one("rows", [], range(7))) == ["only B has the rows 0, 1, 2, 3, 4 and 2 more"]
    assert texts(only_in_one("rows", [], [])) == []


def test_long_values_are_cut():
    assert short_repr("a" * 58) == repr("a" * 58) and short_repr("a" * 59) == f"'{'a' * 55} ..."
    assert len(short_repr("a" * 99)) == 60
    assert short_repr(np.float32(1.5)) == "1.5" and short_repr(np.int8(3)) == "3"


def test_records_name_five_values_and_count_the_rest():
    a, b = {f"k{i}": i for i in range(8)}, {f"k{i}": i + 2.5 for i in range(8)}
    found = texts(record_facts("r: ", a, b))
    assert found == [*(f"r: k{i}: {i} and {i + 2.5}, differ by 2.5" for i in range(5)), "r: and 3 more values"]
    assert len(texts(record_facts("", {k: a[k] for k in list(a)[:5]}, {k: b[k] for k in list(a)[:5]}))) == 5


def test_missing_keys_and_provenance_of_records():
    a = {"x": 1, "recipe": {"layers": 1, "psf": [1, 2]}, "gone": None, "timing": 3, "in": [{"ms": 1, "y": 0.0}]}
    b = {"x": 1, "recipe": {"layers": 2, "psf": [1, 2, 3]}, "new": [1], "stages": 4, "in": [{"ms": 2, "y": -0.0}]}
    found = list(record_facts("", a, b))
    assert [(fact.text, fact.provenance) for fact in found] == [
        ("recipe.layers: 1 and 2, differ by 1", "recipe"), ("recipe.psf: 2 and 3 values", "recipe"),
        ("gone: only A has it: None", None), ("in[0].y: 0.0 and -0.0", None), ("new: only B has it: [1]", None),
    ]  # fmt: skip
    assert not list(record_facts("", a, a)) and not list(record_facts("", {"n": np.nan}, {"n": float("nan")}))
    deep = other = 1
    for _ in range(3000):
        deep, other = [deep], [other]
    assert texts(record_facts("r: ", deep, [other, 2])) == ["r: nested too deep to be compared"]


@pytest.mark.parametrize("name", [
    "DATE", "CHECKSUM", "DATASUM", "CPU_REN", "WALL_L0", "ms", "stages", "timing", "checksum", "hats_estsize",
    "datePublished", "startTime", "endTime", "sha256", "contentSize",
])  # fmt: skip
def test_what_varies(name):
    assert varies(name) and not is_provenance(name)


@pytest.mark.parametrize("name", ["DATE-OBS", "EXPTIME", "CPU", "mag", "stage", "x", "MYDATE", "RADESYS"])
def test_what_neither_varies_nor_is_provenance(name):
    assert not varies(name) and not is_provenance(name)


@pytest.mark.parametrize("name", [
    "SIMVER", "SIMGIT", "FITSSWV", "HISTORY", "CAMPHASH", "CAMHASH", "LAYHASH", "EXPHASH", "TRUTHASH", "PSFHASH",
    "recipe", "recipes", "csstsim", "camera", "camera_digest", "universe", "digest", "truth_hash", "psf_hash",
    "version", "provenance", "hats_builder",
])  # fmt: skip
def test_what_is_provenance(name):
    assert is_provenance(name) and not varies(name)


PAGE = (
    '<a href="#times">run times</a> <h1>A</h1><section id="times">12 s\n</section><section id="gates">PASS</section>'
    '<section id="products">3 MB</section><table><tr><th>host</th><td>node7</td></tr><tr><th>report written</th>'
    "<td>now</td></tr><tr><th>campaign file</th><td>/a</td></tr><tr><th>seed</th><td>7</td></tr></table>"
    '<section id="provenance">csstsim 1</section>'
)


def test_a_page_without_what_varies():
    text, made = steady_page(PAGE)
    assert text == '<h1>A</h1><section id="gates">PASS</section><table><tr><th>seed</th><td>7</td></tr></table>'
    assert made == '<section id="provenance">csstsim 1</section>' and steady_page("<p>") == ("<p>", "")


def test_pages_and_lines(tmp_path):
    a, b = tmp_path / "a.html", tmp_path / "b.html"
    a.write_text(PAGE)
    b.write_text(PAGE.replace("12 s", "99 s").replace("node7", "x").replace("3 MB", "4 MB"))
    assert texts(page_facts(a, b)) == []
    b.write_text(PAGE.replace("csstsim 1", "csstsim 2").replace("<td>7", "<td>8"))
    first, second = page_facts(a, b)
    assert first.provenance == "provenance" and second.provenance is None
    assert second.text.startswith("1 of ") and second.text.endswith(": '<td>7' and '<td>8'")
    a.write_text("<a><b>1")
    b.write_text("<a><b>2")
    assert texts(page_facts(a, b)) == ["1 of 2 tags differs, first tag 2: '<b>1' and '<b>2'"]
    a.write_text("one\ntwo\nthree\n")
    b.write_text("one\n2\nthree\nfour\n")
    assert texts(text_facts(a, b)) == ["2 of 4 lines differ, first line 2: 'two' and '2'"]
    b.write_text("one\ntwo\n")
    assert texts(text_facts(a, b)) == ["1 of 3 lines differs, first line 3: 'three' and nothing"]
    b.write_bytes(b"one\r\ntwo\r\nthree\r\n")
    assert texts(text_facts(a, b)) == ["other ends of lines"]
    b.write_bytes(b"\xff\xfe")
    assert texts(text_facts(a, b)) == ["other bytes (14 and 2 of them)"]
    a.write_text("x=1\ny=2=3\nhats_estsize=5\n")
    b.write_text("y=2=4\nx=1\nhats_estsize=6\n")
    assert texts(properties_facts(a, b)) == ["y: '2=3' and '2=4'"]


def written(path, **columns):
    write_parquet(path, pa.table(columns), {})
    return path


def test_rows_of_two_tables_are_matched_by_their_ids(tmp_path):
    """In another order of rows nothing is matched; of other rows those of both are compared, in A's numbering."""
    a = written(tmp_path / "a.parquet", id=[5, 6, 7, 8], mag=[1.0, 2.0, 3.0, 4.0], ms=[1.0] * 4)
    b = written(tmp_path / "b.parquet", id=[6, 8, 9], mag=[2.0, 4.5, 9.0], ms=[2.0] * 3)
    assert texts(table_facts(a, b)) == [
        "4 and 3 rows", "only A has the rows of id 5, 7", "only B has the rows of id 9",
        "column mag: 1 of 2 rows differs, by at most 0.5 mag, rms 0.5 mag, first in row 3 (id 8): 4.0 and 4.5",
    ]  # fmt: skip
    twice = written(tmp_path / "c.parquet", id=[5, 5, 7], mag=[1.0, 2.0, 3.0], ms=[1.0] * 3)
    assert texts(table_facts(a, twice)) == ["4 and 3 rows; the columns are not compared"]
    moved = written(tmp_path / "d.parquet", mag=[1.0, 2.0, 3.0, 4.0], id=[5, 6, 7, 9], ms=[1.0] * 4)
    assert texts(table_facts(a, moved))[0] == "the columns are in another order"
    assert texts(table_facts(a, moved))[1].endswith("first in row 3: 8 and 9")


def test_footers_tell_rows_and_types(tmp_path):
    a = written(tmp_path / "a.parquet", id=[5, 6], mag=[1.0, 2.0])
    assert texts(footer_facts(a, a)) == []
    b = written(tmp_path / "b.parquet", id=[5, 6, 7], mag=[1, 2, 3])
    assert texts(footer_facts(a, b)) == ["of 2 and 3 rows", "columns[1]: 'mag: DOUBLE' and 'mag: INT64'"]


def test_units_of_more_columns():
    """Of names in the .cat files by our own columns; of a band by that of any."""
    wanted = {
        "yImage": "px", "pm_dec": "mas / yr", "trail_angle": "deg", "trail_x1": "px", "parallax": "mas", "av": "mag",
        "mag_NUV": "mag", "trail_start": "s", "trail_length": "arcsec", "ms": "ms", "stellarage": "Gyr", "p": "",
    }  # fmt: skip
    assert {name: unit_of(name) for name in wanted} == wanted


@pytest.mark.parametrize("change", [
    {"id": [1, 3]}, {"mag": [1.0, 2.5]}, {"mag": pa.array([1.0, 2.0], pa.float32())}, {"word": ["a", "c"]},
    {"more": [1, 2]}, {"mag": [-0.0, 2.0]},
])  # fmt: skip
def test_each_value_type_and_name_of_a_table_is_in_its_content(tmp_path, change):
    columns = {"id": [1, 2], "mag": [0.0, 2.0], "word": ["a", "b"], "ms": [1.0, 2.0]}
    one = content_hash(written(tmp_path / "a.parquet", **columns))
    assert content_hash(written(tmp_path / "b.parquet", **columns | {"ms": [3.0, 4.0]})) == one
    assert content_hash(written(tmp_path / "c.parquet", **columns | change)) != one


def test_files_of_one_size_and_date_are_read(tmp_path):
    one, other = tmp_path / "a.txt", tmp_path / "b.txt"
    for path, text in ((one, "flux 1.5\n"), (other, "flux 2.5\n")):
        path.write_text(text)
        os.utime(path, (1e9, 1e9))
    assert len(list(facts(one, other))) == 1 and not list(facts(one, one))


def test_a_product_with_two_differences_of_provenance_counts_once(tmp_path):
    """The summary names each kind, and counts the products that have any."""
    for folder, version in (("a", "1"), ("b", "2")):
        (tmp_path / folder).mkdir()
        for name in ("x", "y"):
            record = {"csstsim": version, "digest": version if name == "x" else "same", "value": 1}
            (tmp_path / folder / f"{name}.json").write_text(json.dumps(record))
    said = []
    assert compare(tmp_path / "a", tmp_path / "b", said.append) == 0
    assert said == [
        "provenance differs in 2 products, which does not count: csstsim, digest", "2 products compared, all the same"
    ]  # fmt: skip
    said.clear()
    assert compare(tmp_path / "a", tmp_path / "b", said.append, provenance=True) == 2
    assert [line.split(":")[0] for line in said[:3]] == ["x.json", "x.json", "y.json"]


def test_a_suffix_in_capitals_is_that_kind_of_file(tmp_path):
    """Its values are compared, not its lines."""
    for name, text in (("a.JSON", '{"x": 1, "y": [2]}'), ("b.JSON", '{"y": [3],\n"x": 1}')):
        (tmp_path / name).write_text(text)
    assert texts(facts(tmp_path / "a.JSON", tmp_path / "b.JSON")) == ["y[0]: 2 and 3, differ by 1"]
