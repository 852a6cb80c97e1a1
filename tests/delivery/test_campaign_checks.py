"""Checks of what frames share, on small files: links of merged rows, counts of rows and gates, planes of masters."""

import json
from types import SimpleNamespace

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from PIL import Image

from csstsim.base.errors import InputError
from csstsim.base.healpix import brick_centre, hats_index
from csstsim.catalog.table import ObjectTable, write_parquet
from csstsim.delivery import campaign_checks
from csstsim.delivery.checked_files import CheckedFiles, MergedBrick
from csstsim.io.frames import save_frame

BRICK = 550615
FRAMES = {
    ("101", 9): SimpleNamespace(filter="r", key=("101", 9)), ("202", 7): SimpleNamespace(filter="NUV", key=("202", 7)),
}  # fmt: skip
ROWS = {("101", 9): 3, ("202", 7): 1}


def merged(folder, meta=(), **changes):
    """Write a brick of three sources with 2, 0 and 1 detections; return its faults and what was noted."""
    ra, dec = brick_centre(BRICK)
    ra, dec = ra + np.array([0.0, 1e-3, 2e-3]), np.full(3, dec)
    ra = ra[np.argsort(hats_index(ra, dec))]
    columns = {
        "_healpix_29": hats_index(ra, dec), "ra": ra, "dec": dec, "n_detections": np.array([2, 0, 1]),
        "detection_obsid": [["101", "202"], [], ["101"]], "detection_chip": [[9, 7], [], [9]],
        "detection_filter": [["r", "nuv"], [], ["r"]], "detection_number": [[0, 0], [], [2]],
    }  # fmt: skip
    columns = {name: values for name, values in (columns | changes).items() if values is not None}
    path, seen = folder / "m.parquet", CheckedFiles(measured=dict(ROWS))
    write_parquet(path, pa.table(columns), {"recipe": "1", "brick": BRICK} | dict(meta))
    return list(campaign_checks.merged(path, BRICK, "1", FRAMES, seen)), seen


def test_a_sound_brick_is_noted(tmp_path):
    assert merged(tmp_path) == ([], CheckedFiles(measured=ROWS, merged={BRICK: MergedBrick(3, "1")}))


@pytest.mark.parametrize(("changes", "fault"), [
    ({"detection_number": [[0, 1], [], [2]]}, "detections of 202_07 lead beyond the 1 rows measured there"),
    ({"detection_number": [[3, 0], [], [2]]}, "detections of 101_09 lead beyond the 3 rows measured there"),
    ({"detection_number": [[-1, 0], [], [2]]}, "detections of 101_09 lead beyond the 3 rows measured there"),
    ({"detection_number": [[2, 0], [], [2]]}, "a detection of 101_09 belongs to two sources"),
    ({"detection_filter": [["r", "r"], [], ["r"]]}, "detections of 202_07 are not in NUV"),
    ({"detection_filter": [["R", "NUV"], [], ["r"]]}, None),
    ({"detection_chip": [[7, 7], [], [7]]}, "2 detections are of 101_07, which is not among the frames"),
    ({"detection_obsid": [["101", "203"], [], ["101"]]}, "1 detections are of 203_07, which is not among the frames"),
    ({"detection_chip": [[9, 7], [9], []]}, "lists of detections are not as long"),
    ({"n_detections": np.array([2, 1, 0])}, "lists of detections are not as long"),
    ({"ra": np.array([0.0, np.nan, 0.0])}, "positions that are not finite"),
    ({"_healpix_29": np.arange(3)}, "belong to another brick"), ({"meta": {"brick": 3}}, "is of brick 3"),
    ({"meta": {"recipe": "2"}}, "recipe '2', not '1'"), ({"dec": None}, "lacks the column dec"),
    ({"detection_number": None}, "lacks the column detection_number"),
])  # fmt: skip
def test_faults_of_a_brick(tmp_path, changes, fault):
    found, _ = merged(tmp_path, **changes)
    assert len(found) == (fault is not None) and all(fault in text for text in found), found


def test_rows_are_in_the_order_of_their_index(tmp_path):
    ra, dec = brick_centre(BRICK)
    ra, dec = ra + np.array([0.0, 1e-3, 2e-3]), np.full(3, dec)
    ra = ra[np.argsort(hats_index(ra, dec))[[0, 2, 1]]]
    found, _ = merged(tmp_path, ra=ra, _healpix_29=hats_index(ra, dec))
    assert found == ["its rows are not in the order of _healpix_29"]


def test_a_brick_without_detections(tmp_path):
    empty = {name: pa.array([[], [], []], pa.list_(pa.int64())) for name in campaign_checks.LINKS}
    assert merged(tmp_path, n_detections=np.zeros(3, int), **empty)[0] == []


def test_a_truth_brick_has_its_own_objects(tmp_path, monkeypatch):
    index = np.array([7 << 42, (8 << 42) - 1])
    monkeypatch.setattr(
        "csstsim.catalog.truth_bricks.read_brick", lambda path, record: ObjectTable({"_healpix_29": index})
    )
    assert list(campaign_checks.truth_brick(tmp_path / "Npix=7.parquet", None)) == []
    assert list(campaign_checks.truth_brick(tmp_path / "Npix=8.parquet", None)) == ["has objects of another brick"]
    index[1] += 1
    assert list(campaign_checks.truth_brick(tmp_path / "Npix=7.parquet", None)) == ["has objects of another brick"]


@pytest.mark.parametrize(("names", "said"), [
    (("flat", "bad"), None), (("flat",), "flat"), (("flat", "bad", "dark"), "flat, bad, dark"), ((), "nothing"),
])  # fmt: skip
def test_masters_have_two_planes(tmp_path, names, said):
    path = tmp_path / "m.fits"
    save_frame(path, {name: np.ones((2, 3), np.float32) for name in names}, {"chip": 9})
    wanted = [f"holds {said}, not the planes flat and bad"] if said else []
    assert list(campaign_checks.masters(path, {"chip": 9})) == wanted
    with pytest.raises(InputError, match="chip: made from another recipe"):
        list(campaign_checks.masters(path, {"chip": 8}))


@pytest.mark.parametrize(("text", "good"), [
    ("Norder,Npix\n8,5\n8,12\n", True), ("Norder,Npix\n8,12\n8,5\n", False), ("Norder,Npix\n8,5\n", False),
    ("8,5\n8,12\n", False), ("Norder,Npix\n8,5\n8,12\n8,13\n", False), ("Norder,Npix\n7,5\n7,12\n", False),
])  # fmt: skip
def test_the_list_of_bricks_rises_and_is_whole(tmp_path, text, good):
    (tmp_path / "p.csv").write_text(text)
    assert list(campaign_checks.partition(tmp_path / "p.csv", {12: None, 5: None})) == (
        [] if good else ["does not list the bricks"]
    )


@pytest.mark.parametrize(("stated", "noted", "said"), [
    (7, 7, []), (8, 7, ["hats.properties counts 8 rows; the bricks have 7"]),
    (7, 3, ["dataset/_metadata counts 3 rows; the bricks have 7"]),
])  # fmt: skip
def test_a_catalogue_counts_the_rows_of_all_its_bricks(tmp_path, stated, noted, said):
    (tmp_path / "dataset").mkdir()
    (tmp_path / "hats.properties").write_text(f"#made=x\nhats_order=8\nhats_nrows={stated}\n")
    for name, rows in (("_metadata", noted), ("_common_metadata", 0)):
        pq.write_table(pa.table({"a": np.arange(rows)}), tmp_path / "dataset" / name)
    seen = CheckedFiles(merged={5: MergedBrick(3, "x"), 12: MergedBrick(4, "x")})
    assert list(campaign_checks.catalogue(tmp_path, {5: None, 12: None}, seen)) == said
    assert list(campaign_checks.catalogue(tmp_path, {5: None, 12: None, 13: None}, seen)) == []  # one is not known


@pytest.mark.parametrize(("result", "recipe", "said"), [
    ({"brick": 5, "gates": [1, 2], "recipe": "1"}, "1", []), ({"brick": 5, "gates": [1], "recipe": "m"}, None, []),
    ({"brick": 5, "gates": [1], "recipe": "1"}, None, ["made for another campaign: recipe '1', not 'm'"]),
    ({"brick": 5, "gates": [1], "recipe": "m"}, "1", ["made for another campaign: recipe 'm', not '1'"]),
    ({"brick": 6, "gates": [1], "recipe": "1"}, "1", ["is no validation of brick 5"]),
    ({"brick": 5, "gates": {}, "recipe": "1"}, "1", ["is no validation of brick 5"]),
    ([], "1", ["is no validation of brick 5"]),
])  # fmt: skip
def test_a_validation_is_of_its_brick_and_of_what_was_merged(tmp_path, result, recipe, said):
    (tmp_path / "5.json").write_text(json.dumps(result))
    seen = CheckedFiles(merged={5: MergedBrick(3, "m"), 6: MergedBrick(3, "n")})
    assert list(campaign_checks.validation(tmp_path / "5.json", 5, recipe, seen)) == said
    assert seen.gates == ({} if "is no" in "".join(said) else {5: len(result["gates"])})


GATES = [{"brick": 5}, {"brick": 5}, {"brick": 12}, {"brick": None}, {}]


@pytest.mark.parametrize(("result", "said"), [
    ({"gates": GATES, "counts": {"PASS": 4, "FAIL": 1}}, None),
    ({"gates": GATES, "counts": {"PASS": 4}}, "has 5 gates; it counts {'PASS': 4}: make the report again"),
    ({"gates": GATES}, "has 5 gates; it counts None"),
    ({"gates": GATES[1:], "counts": {"PASS": 4}}, "evaluates 2 gates; the validations have 3: make the report again"),
    ({"gates": [*GATES, {"brick": 5}], "counts": {"PASS": 6}}, "evaluates 4 gates; the validations have 3"),
    ({"gates": [1], "counts": {"PASS": 1}}, "is no verdict"), ({"gates": {}}, "is no verdict"), ([], "is no verdict"),
])  # fmt: skip
def test_a_verdict_has_the_gates_of_all_bricks(tmp_path, result, said):
    """Those of spectra have no brick."""
    (tmp_path / "v.json").write_text(json.dumps(result))
    found = list(campaign_checks.verdict(tmp_path / "v.json", {5: None, 12: None}, CheckedFiles(gates={5: 2, 12: 1})))
    assert len(found) == (said is not None) and all(text.startswith(said) for text in found), found
    part = list(campaign_checks.verdict(tmp_path / "v.json", {5: None, 12: None}, CheckedFiles(gates={5: 2})))
    assert not any("the validations have" in text for text in part)


@pytest.mark.parametrize(("end", "good"), [("</html>", True), ("</html>\n \n", True), ("</html", False), ("", False)])
def test_a_page_is_whole(tmp_path, end, good):
    (tmp_path / "p.html").write_text("<html>" + "x" * 100 + end)
    assert list(campaign_checks.page(tmp_path / "p.html")) == ([] if good else ["the page is cut short"])
    (tmp_path / "s.html").write_text(end)
    assert list(campaign_checks.page(tmp_path / "s.html")) == ([] if good else ["the page is cut short"])


def test_a_picture_is_whole(tmp_path):
    """A byte of its pixels, of its checksums, or its end: none may differ."""
    path = tmp_path / "a.png"
    Image.fromarray(np.arange(3000, dtype=np.uint8).reshape(30, 100)).save(path)
    content = path.read_bytes()
    assert list(campaign_checks.picture(path)) == []
    at = content.index(b"IDAT") + 10
    for damaged in (content[:at] + bytes([content[at] ^ 1]) + content[at + 1 :], content[: len(content) // 2], b"text"):
        path.write_bytes(damaged)
        with pytest.raises((InputError, OSError)):
            list(campaign_checks.picture(path))
