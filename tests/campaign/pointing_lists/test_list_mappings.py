"""Mappings of lists of pointings: what is added to them, what replaces what, what they must have, and their file."""

from pathlib import Path

import pytest
import yaml

from csstsim.base.errors import InputError
from csstsim.campaign.pointing_lists.mapping import HEAD, LISTS, Mapping, known_lists, load_mapping
from csstsim.campaign.pointing_lists.quantities import parse_key
from csstsim.campaign.pointing_lists.read_list import PointingList

WHOLE = {"ra": "A", "dec": "B", "pa": "C", "time_mjd": "D", "exptime": "E"}


def listed(*names):
    return PointingList(Path("list.csv"), list(names), [("line 2", ["1"] * len(names))])


def test_columns_that_are_called_as_a_quantity_are_taken_if_it_has_none_yet():
    given = Mapping(columns={"ra_hour": "RA"}, values={"exptime": 150})
    found = given.completed(["ra", "dec_rad", "note", "exptime", "dec", "pa", "PA"])
    assert found.columns == {"ra_hour": "RA", "dec_rad": "dec_rad", "pa": "pa"} and found.values == {"exptime": "150"}
    assert given.columns == {"ra_hour": "RA"}


def test_what_is_said_replaces_the_same_quantity_in_any_unit_and_nothing_else():
    given = Mapping(columns={"ra_hour": "RA", "dec": "DEC"}, values={"pa": "0", "exptime_min": "2"}, pa_zero=5.0)
    found = given.changed({"exptime": "EXP", "ra_rad": "X"}, {"pa_arcmin": "90"}, {"pa_sense": "west"})
    assert found.columns == {"dec": "DEC", "exptime": "EXP", "ra_rad": "X"} and found.values == {"pa_arcmin": "90"}
    assert (found.pa_sense, found.pa_zero, found.pa_north, found.directions) == ("west", 5.0, "equator", "apparent")
    sources = found.keys()
    assert sources["ra"] == (parse_key("ra_rad"), "X", None, (None, "--map ra_rad"))
    assert sources["pa"] == (parse_key("pa_arcmin"), None, "90", (None, "--set pa_arcmin"))
    assert sources["dec"].origin == (None, "columns.dec")


def test_values_of_a_file_may_be_numbers_and_truths():
    assert Mapping(values={"deep": True, "exptime": 2.5, "number": 0}).values == {
        "deep": "true", "exptime": "2.5", "number": "0",
    }  # fmt: skip


@pytest.mark.parametrize(("columns", "said"), [
    ({"pa": None}, "list.csv: pa: not mapped"), ({"time_mjd": None}, "list.csv: time: not mapped"),
    ({"exptime": None}, "list.csv: exptime: not mapped"), ({"dec": None}, "no direction is mapped"),
    ({"ecl_lon": "A"}, r"ecl_lon, ecl_lat: all of these or none \(got 'no ecl_lat'\)"),
    ({"gal_lat": "A"}, "no gal_lon"), ({"sat_x": "A", "sat_vz": "A"}, "no sat_y"), ({"moon_z": "A"}, "no moon_x"),
    ({"sun_x": "A", "sun_y": "A"}, "no sun_z"),
    ({"obsid": "A", "number": "A"}, "number: obsid and number exclude each"),
    ({"deep": "A", "deep_index": "A"}, "deep_index: deep and deep_index exclude each"), ({"ra": "Z"}, "'Z'"),
])  # fmt: skip
def test_what_a_survey_table_needs_must_be_mapped(columns, said):
    table = listed(*"ABCDE")
    Mapping(columns=WHOLE).check(table)
    changed = {key: name for key, name in (WHOLE | columns).items() if name}
    with pytest.raises(InputError, match=said):
        Mapping(columns=changed).check(table)


def test_any_pair_of_coordinates_will_do_and_the_whole_of_a_group():
    rest = {key: name for key, name in WHOLE.items() if key not in ("ra", "dec")}
    for pair in (("ecl_lon", "ecl_lat"), ("gal_lon", "gal_lat")):
        Mapping(columns=rest | dict(zip(pair, "AB", strict=True))).check(listed(*"ABCDE"))
    group = "sat_x", "sat_y", "sat_z", "sat_vx", "sat_vy", "sat_vz"
    Mapping(columns=WHOLE | dict.fromkeys(group, "A"), values={f"sun_{axis}": "1" for axis in "xyz"}).check(
        listed(*"ABCDE")
    )


def test_a_file_comes_back_and_its_errors_name_it(tmp_path):
    given = Mapping(columns=WHOLE, values={"deep": "yes"}, pa_sense="west", pa_zero=-90.0, pa_north="galactic",
                    directions="icrs", first_obsid="000000001", tolerance=0.25)  # fmt: skip
    file = tmp_path / "m.yaml"
    file.write_text(given.text())
    assert given.text().startswith(HEAD) and load_mapping(file).model_dump() == given.model_dump()
    assert load_mapping(file).keys()["ra"].origin == (file, "columns.ra")
    file.write_text(yaml.safe_dump({"columns": {"ra": "A", "ra_hour": "B"}}))
    with pytest.raises(InputError, match=r"m\.yaml: ra: given twice, by columns\.ra and columns\.ra_hour"):
        load_mapping(file)
    for key, value in (("tolerance", 0), ("tolerance", 181), ("pa_zero", 361), ("first_obsid", "12345678"), ("x", 1)):
        file.write_text(yaml.safe_dump({key: value}))
        with pytest.raises(InputError, match=rf"m\.yaml: {key}"):
            load_mapping(file)


def test_the_lists_that_are_known():
    assert known_lists() == ["csst", "opsim"]
    for name in known_lists():
        assert load_mapping(LISTS / f"{name}.yaml").keys().keys() >= {"pa", "time", "exptime"}


@pytest.mark.parametrize(("name", "index"), [("b", 1), ("col1", 0), ("col3", 2)])
def test_columns_are_found_by_name_or_number(name, index):
    assert listed("a", "b", "c").column(name) == index
    for wrong in ("col4", "col0", "colx", "A"):
        with pytest.raises(InputError, match=rf"no such column in list\.csv \(got '{wrong}'\); allowed: a, b, c"):
            listed("a", "b", "c").column(wrong)
    assert listed("col2", "b").column("col2") == 0  # a name comes first
    with pytest.raises(InputError, match=r"m: k: list\.csv has this column twice"):
        listed("a", "a").column("a", ("m", "k"))
