"""Checks of a frame's products, on small tables and headers: the fault of each column and number, and where it ends."""

from types import SimpleNamespace

import numpy as np
import pytest

from csstsim.catalog.table import ObjectTable
from csstsim.delivery.checked_files import CheckedFiles
from csstsim.delivery.contents import ExpectedFrame
from csstsim.delivery.frame_checks import (
    _of_frame,
    _pointing,
    _rendered,
    calibrated,
    cosmic,
    lines,
    measured,
    orders,
    other_recipe,
    spectra,
)
from csstsim.io.fits_writing import card, write_hdus
from csstsim.io.frames import save_frame
from csstsim.io.keywords import RECIPE
from csstsim.io.pointing_keywords import Boresight
from csstsim.measure.source_columns import COLUMNS
from csstsim.measure.spectra import line_columns, spectrum_columns


def expected(path, **fields):
    values = {
        "obsid": "101", "chip": 9, "filter": "r", "type": "SCIE", "level0": path / "x.fits", "recipe": None,
        "rays_recipe": None, "window": None, "measured": "yes", "extracted": "no", "cosmic": "no",
    }  # fmt: skip
    return ExpectedFrame(**values | fields)


def test_every_part_of_a_recipe_that_differs_is_named():
    ours = {"a": 1, "b": 2, "c": 3}
    assert list(other_recipe({"b": 5, "c": 3, "d": 4}, ours)) == [
        f"made for another campaign: {text}" for text in ("a None, not 1", "b 5, not 2", "d 4, not None")
    ]  # fmt: skip
    assert list(other_recipe(ours, dict(ours))) == list(other_recipe("x", None)) == list(other_recipe(None, None)) == []
    assert list(other_recipe("0", "1")) == ["made for another campaign: recipe '0', not '1'"]
    assert len(list(other_recipe(None, ours))) == len(list(other_recipe(ours, "1"))) == 1


@pytest.mark.parametrize(("name", "value", "said"), [
    ("chip", 8, "another chip than 9"), ("filter", "i", "another filter than r"), ("obsid", "102", "another obsid"),
])  # fmt: skip
def test_one_row_of_another_frame_is_enough(tmp_path, name, value, said):
    table = {"chip": np.array([9, 9, 9]), "filter": np.array(["r"] * 3), "obsid": np.array(["101"] * 3)}
    assert list(_of_frame(ObjectTable(table), expected(tmp_path))) == []
    table[name][-1] = value
    (fault,) = _of_frame(ObjectTable(table), expected(tmp_path))
    assert said in fault
    assert list(_of_frame(ObjectTable(table), expected(tmp_path, chip=None, filter=None, obsid=None))) == []
    assert list(_of_frame(ObjectTable({"id": [1]}), expected(tmp_path))) == []


@pytest.mark.parametrize(("box", "good"), [
    ((100, 200, 5, 50), True), ((99, 120, 10, 20), False), ((150, 201, 10, 20), False), ((150, 160, 4, 20), False),
    ((150, 160, 10, 51), False), ((150, 150, 10, 20), False), ((150, 160, 20, 20), False), ((160, 150, 10, 20), False),
    ((150, 160, 20, 10), False), ((0, 0, 0, 0), True),
])  # fmt: skip
def test_a_box_lies_in_the_window_from_edge_to_edge(box, good):
    """And objects of which nothing was drawn may have any."""
    frame = SimpleNamespace(window=(100, 200, 5, 50))
    table = {name: np.array([value, value, 7]) for name, value in zip(("x0", "x1", "y0", "y1"), box, strict=True)}
    table |= {"x": np.ones(3), "y": np.ones(3), "drawn": np.array([1.0, 2.0, 0.0])}
    assert list(_rendered(ObjectTable(table), frame)) == (
        [] if good else ["2 objects rendered in boxes beyond the window"]
    )
    table |= {"x": np.array([1.0, 1.0, np.nan])}
    assert not [fault for fault in _rendered(ObjectTable(table), frame) if "position" in fault]


def pointing_header(**changes):
    return {"RA_OBJ": 60.0, "DEC_OBJ": -40.0, "POS_ANG0": 20.0} | changes


def test_a_pointing_is_that_of_the_campaign_or_of_the_files_own_wcs(tmp_path):
    """Beyond 0.01 arcsec: the keyword, how far, from what."""
    linear = {"CTYPE1": "RA---TAN", "CRVAL1": 60.0, "CRVAL2": -40.0}
    known = expected(tmp_path, boresight=Boresight(60.0, -40.0, 20.0))
    for frame, off in ((known, "the campaign's"), (expected(tmp_path), "that of its WCS")):
        near = SimpleNamespace(header0=pointing_header(DEC_OBJ=-40 + 0.009 / 3600), header=linear)
        far = SimpleNamespace(header0=pointing_header(DEC_OBJ=-40 + 0.02 / 3600), header=linear)
        assert list(_pointing(frame, near)) == []
        assert list(_pointing(frame, far)) == [f"the pointing by RA_OBJ is 0.02 arcsec off {off}"]
    bare = SimpleNamespace(header0=pointing_header(RA_OBJ=0.0), header={})
    assert list(_pointing(expected(tmp_path), bare)) == []


def order_files(folder, drawn=(3.0, 4.0, 10.0), rows=(0, 0, 2), ids=(7, 7, 9), light=(7.0, 0.0, 10.0)):
    """Write orders, and beside them the truth of three objects; return their frame."""
    from support.csst import BANDS

    from csstsim.io.orders import write_orders
    from csstsim.io.truth import truth_table

    count = len(rows)
    table = ObjectTable({
        "id": np.array(ids), "row": np.array(rows, np.int32), "order": np.ones(count, np.int8),
        "grating": np.full(count, "GV"), "cut": np.zeros(count, bool), "electrons": np.full(count, 9.0),
        "drawn": np.array(drawn), **{name: np.ones(count) for name in "xypqrs"},
    })  # fmt: skip
    write_orders(folder / "x.orders.parquet", table, {"recipe": {"a": 1}})
    objects = ObjectTable.complete({"id": [7, 8, 9], "ra": [1.0] * 3, "dec": [1.0] * 3, "obj_type": [0] * 3}, BANDS)
    extra = {"drawn": np.array(light), "method": np.full(3, "photons"), "x": np.ones(3), "y": np.ones(3)}
    truth_table(objects.with_columns(**extra), SimpleNamespace(id=29, filter="GV")).write(
        folder / "x.truth.parquet", {}
    )
    return expected(folder, recipe={"a": 1})


@pytest.mark.parametrize(("changes", "fault"), [
    ({}, None), ({"drawn": (3.0, 4.9, 10.0)}, None),  # rounding of an electron
    ({"drawn": (3.0, 5.1, 10.0)}, "the orders of 1 object do not add up"),
    ({"drawn": (3.0, 2.9, 8.0)}, "the orders of 2 objects do not add up"),
    ({"light": (7.0, 1.5, 10.0)}, "the orders of 1 object do not add up"),  # of light without an order
    ({"drawn": (3.0, 4.0, 1e8), "light": (7.0, 0.0, 1e8 + 90)}, None),
    ({"drawn": (3.0, 4.0, 1e8), "light": (7.0, 0.0, 1e8 + 110)}, "the orders of 1 object do not add up"),
    ({"rows": (0, 0, 3)}, "not among the 3 of the truth"), ({"rows": (-1, 0, 2)}, "not among the 3 of the truth"),
    ({"ids": (7, 7, 8)}, "another one in the truth"),
])  # fmt: skip
def test_orders_add_up_to_their_objects(tmp_path, changes, fault):
    frame = order_files(tmp_path, **changes)
    found = list(orders(tmp_path / "x.orders.parquet", frame))
    assert len(found) == (fault is not None) and all(fault in text for text in found), found


def test_orders_of_another_campaign_and_without_a_truth(tmp_path):
    order_files(tmp_path)
    frame = expected(tmp_path, recipe={"a": 2})
    (fault,) = orders(tmp_path / "x.orders.parquet", frame)
    assert fault == "made for another campaign: a 1, not 2"
    (tmp_path / "x.truth.parquet").unlink()
    assert len(list(orders(tmp_path / "x.orders.parquet", frame))) == 1


def sources(folder, meta=(), **changes):
    """Write a table of three sources; return its path."""
    values = {name: np.zeros(3) for name in COLUMNS} | {
        "number": np.arange(3), "x": np.array([98.0, 150.0, 201.0]), "y": np.array([1.0, 20.0, 51.0]),
        "ra": np.array([0.0, 10.0, 359.9]), "dec": np.array([-90.0, 0.0, 90.0]), "chip": np.full(3, 9),
        "filter": np.full(3, "r"), "obsid": np.full(3, "101"),
    }  # fmt: skip
    values = {name: column for name, column in (values | changes).items() if column is not None}
    ObjectTable(values).write(folder / "m.parquet", {"sources": 3, "recipe": {"a": 1}} | dict(meta))
    return folder / "m.parquet"


@pytest.mark.parametrize(("changes", "fault"), [
    ({}, None), ({"x": np.array([94.4, 150.0, 150.0])}, "1 source beyond the window"),
    ({"x": np.array([94.6, 150.0, 204.4])}, None), ({"x": np.array([94.4, 150.0, 204.6])}, "2 sources beyond"),
    ({"y": np.array([-0.6, 20.0, 54.6])}, "2 sources beyond"), ({"y": np.array([-0.4, 20.0, 54.4])}, None),
    ({"x": np.array([150.0, np.nan, 150.0])}, "1 source beyond"), ({"number": np.arange(3) + 1}, "does not count"),
    ({"ra": np.array([0.0, 360.0, 1.0])}, "out of range"), ({"ra": np.array([0.0, -1e-9, 1.0])}, "out of range"),
    ({"dec": np.array([0.0, 90.1, 1.0])}, "out of range"), ({"dec": np.array([0.0, -90.1, 1.0])}, "out of range"),
    ({"meta": {"sources": 4}}, "has 3 rows; its record says 4"), ({"meta": {"recipe": {"a": 2}}}, "a 2, not 1"),
    ({"chip": np.array([9, 9, 8])}, "another chip"), ({"flags": None}, "lacks the column flags"),
])  # fmt: skip
def test_measured_sources(tmp_path, changes, fault):
    """Within 5 px of the window's edges."""
    seen, frame = CheckedFiles(), expected(tmp_path, window=(100, 200, 5, 50))
    found = list(measured(sources(tmp_path, **changes), frame, {"a": 1}, seen))
    assert len(found) == (fault is not None) and all(fault in text for text in found), found
    assert seen.measured == ({} if "flags" in changes else {("101", 9): 3})


@pytest.mark.parametrize(("check", "columns"), [(spectra, spectrum_columns.COLUMNS), (lines, line_columns.COLUMNS)])
def test_tables_of_spectra_have_all_their_columns(tmp_path, check, columns):
    path = tmp_path / "s.parquet"
    for gone in (None, next(iter(columns)), list(columns)[-1]):
        ObjectTable({name: np.zeros(2) for name in columns if name != gone}).write(path, {"recipe": {"a": 1}})
        wanted = [f"the table lacks the column {gone}"] if gone else []
        assert list(check(path, {"a": 1})) == wanted
        assert list(check(path, {"a": 2})) == ["made for another campaign: a 1, not 2", *wanted]


def test_an_image_of_cosmic_rays_holds_them_alone(tmp_path):
    plane, path = np.zeros((2, 3), np.int32), tmp_path / "c.fits"
    frame = expected(tmp_path, recipe={"a": 9}, rays_recipe={"a": 1})
    two = {"cosmic": plane, "image": plane}
    for planes, said in (({"cosmic": plane}, None), (two, "cosmic, image"), ({}, "nothing")):
        save_frame(path, planes, {"recipe": {"a": 1}})
        assert list(cosmic(path, frame)) == ([f"holds {said}, not the plane cosmic"] if said else [])
    save_frame(path, {"cosmic": plane}, {"recipe": {"a": 9}})
    assert list(cosmic(path, frame)) == ["made for another campaign: a 9, not 1"]


def test_a_calibrated_image_has_three_planes_and_the_recipe_of_its_frame(tmp_path):
    """The recipe stands in the primary header, not in those of the planes."""
    path = tmp_path / "c.fits"
    recipe = {name: f"{k}" for k, name in enumerate(RECIPE)} | {"csstsim": None}
    stated = [card(keyword, recipe[name]) for name, keyword in RECIPE.items()]
    other = [card(keyword, "other") for keyword in RECIPE.values()]

    def faults(names, primary=stated, more=b""):
        planes = [(name, other, np.zeros((2, 3), np.float32)) for name in names]
        write_hdus(path, [("", primary, None), *planes])
        path.write_bytes(path.read_bytes() + more)
        return list(calibrated(path, expected(tmp_path, recipe=recipe)))

    assert faults(["SCI", "ERR", "DQ"]) == []
    assert faults(["SCI", "DQ", "ERR"]) == ["has the extensions SCI, DQ, ERR, not SCI, ERR, DQ"]
    assert len(faults(["SCI", "ERR"])) == 2 and len(faults(["SCI", "ERR", "DQ", "MORE"])) == 2
    assert len(faults(["SCI", "ERR", "DQ"], other)) == len(RECIPE)
    changed = [card(keyword, "9" if k == 1 else recipe[name]) for k, (name, keyword) in enumerate(RECIPE.items())]
    [found] = faults(["SCI", "ERR", "DQ"], changed)
    assert found.startswith("made for another campaign: ") and "'9'" in found and "'1'" in found
