"""Values of a list of pointings in each unit, its messages, and the borders of a survey table's cells."""

from decimal import Decimal

import numpy as np
import pytest

from csstsim.campaign.pointing_lists.directions import boresights, position_angles
from csstsim.campaign.pointing_lists.mapping import Mapping
from csstsim.campaign.pointing_lists.messages import count_reasons, log_not_used, log_overlaps, log_refused
from csstsim.campaign.pointing_lists.quantities import parse_key
from csstsim.campaign.pointing_lists.read_list import PointingList, RefusedRow, read_list
from csstsim.campaign.pointing_lists.values import Values
from csstsim.campaign.survey_table import exposures_of

HEADER = "obsid,type,ra,dec,pa,time,exptime"


def values_of(cells, **mapping):
    """Return the Values of a list with one column a key; cells: {key: its texts}."""
    rows = [(f"line {k + 2}", list(row)) for k, row in enumerate(zip(*cells.values(), strict=True))]
    names = [f"c{k}" for k in range(len(cells))]
    columns = dict(zip(cells, names, strict=True))
    return Values(PointingList("list.csv", names, rows), Mapping(columns=columns, **mapping))


@pytest.mark.parametrize(("key", "cell", "wanted"), [
    ("ra", "33.5", 33.5), ("ra_hour", "3.5", 52.5), ("dec_rad", "-1", -57.29577951308232), ("pa_arcmin", "90", 1.5),
    ("pa_arcsec", "-1800", -0.5), ("ra_hms", "1:30:36", 22.65), ("dec_dms", "-0:30:36", -0.51),
    ("sat_x_m", "-7e6", -7e3), ("sat_z_au", "0.001", 149597.8707), ("sat_vy_m_s", "-7500", -7.5),
    ("sat_vx", "7.25", 7.25),
    ("exptime_ms", "500", 0.5),
    ("exptime_min", "2.5", 150.0), ("exptime_hour", "0.5", 1800.0), ("exptime_day", "0.25", 21600.0),
    ("moon_angle_rad", "2", 114.59155902616465), ("sun_x_au", "-1", -149597870.7),
])  # fmt: skip
def test_numbers_are_in_the_first_unit_of_their_kind(key, cell, wanted):
    values = values_of({key: [cell]})
    assert values.numbers(parse_key(key).name)[0] == pytest.approx(wanted, rel=1e-12) and not values.reasons


@pytest.mark.parametrize(("key", "good", "bad"), [
    ("ra", ("-180", "360"), ("-180.1", "360.1")), ("dec", ("-90", "90"), ("-90.1", "90.1")),
    ("gal_lon", ("-180", "360"), ("-181", "361")), ("ecl_lat", ("-90", "90"), ("91", "-91")),
    ("pa", ("-360", "360"), ("-361", "361")), ("sun_angle", ("0", "180"), ("-0.1", "180.1")),
])  # fmt: skip
def test_numbers_beyond_their_range_refuse_the_row(key, good, bad):
    values = values_of({key: [*good, *bad, "", "1_0", "x", "inf"]})
    found = values.numbers(key)
    assert np.isfinite(found).tolist() == [True, True] + [False] * 6 and set(values.reasons) == {2, 3, 4, 5, 6, 7}
    assert (
        "out of range" in values.reasons[2] and "no value" in values.reasons[4] and "not a number" in values.reasons[6]
    )
    assert "not a finite number" in values.reasons[5] and "not a finite number" in values.reasons[7]


def test_numbers_that_are_not_needed_may_be_empty():
    values = values_of({"sat_x": ["", "-5.5", ""]})
    found = values.numbers("sat_x", np.array([True, False, False]))
    assert np.isnan(found[[0, 2]]).all() and found[1] == -5.5 and set(values.reasons) == {2}


def test_words_whole_numbers_and_parts_of_the_survey():
    values = values_of({"number": ["7", "12.0", "-1", "1.5"], "deep_index": ["-1", "0", "3.0", "two"]})
    assert values.whole_numbers("number") == [7, 12, None, None] and set(values.reasons) == {2, 3}
    assert values.deep()[:3] == [False, True, True] and "not a whole number" in values.reasons[3]
    assert values_of({"deep_index": ["-1.0", "-1.", "-1"]}).deep() == [False] * 3  # as numbers of FITS become text
    words = values_of({"deep": ["YES", "0", "deep", "Wide", "1.0", "perhaps"]})
    assert words.deep() == [True, False, True, False, True, None] and list(words.reasons) == [5]


def test_days_are_of_the_years_1950_to_2099():
    """MJD 33282 and 88068 are the first and the last day of them (Meeus 1998, chapter 7)."""
    cells = ["33281.999", "33282", "88068.999", "88069"]
    for form, zero in (("mjd", 0), ("jd", Decimal("2400000.5"))):
        values = values_of({f"time_{form}": [str(Decimal(cell) + zero) for cell in cells]})
        starts = values.utc()
        assert [start[:10] for start in starts] == ["", "1950-01-01", "2099-12-31", ""]
        assert set(values.reasons) == {0, 3} and all("of the years 1950 to 2099" in values.reasons[k] for k in (0, 3))


def test_a_place_of_each_frame_is_that_of_the_icrs():
    """The galactic centre and pole (IAU 1958, Hipparcos 1.5.3), and the ecliptic's pole at 23.44 deg from the north."""
    values = values_of({"gal_lon": ["0", "0"], "gal_lat": ["0", "90"], "ecl_lon": ["90", "0"], "ecl_lat": ["90", "0"]})
    ecliptic, galactic = boresights(values)
    assert galactic.ra.deg == pytest.approx([266.40499, 192.85948], abs=1e-4)
    assert galactic.dec.deg == pytest.approx([-28.93617, 27.12825], abs=1e-4)
    assert (ecliptic.ra.deg[0], ecliptic.dec.deg[0]) == pytest.approx((270.0, 66.5607), abs=1e-3)
    angles = position_angles(ecliptic, np.array([30.0, 350.0]), Mapping(pa_sense="west", pa_zero=20.0))
    assert angles == pytest.approx([350.0, 30.0])


def test_reasons_are_counted_without_their_values():
    refused = [RefusedRow(f"line {k}", "", reason) for k, reason in enumerate([
        "column ra: out of range: 400 deg (got '400'); allowed: -180 to 360 deg",
        "column pa: not a number (got 'x')", "column ra: out of range: 500 deg (got '500'); allowed: -180 to 360 deg",
    ])]  # fmt: skip
    kinds, said = count_reasons(refused), []
    assert sorted(kinds.values()) == [1, 2]
    log_refused("a.csv", kinds, said.append)
    assert said[0] == "a.csv: 3 rows rejected" and said[1].startswith("  2  column ra: out of range")
    many = count_reasons([RefusedRow("line 1", "", f"{'a' * k}") for k in range(1, 11)])
    said.clear()
    log_refused("a.csv", many, said.append)
    assert len(said) == 10 and said[-1] == "  2  of 2 other kinds"


def test_columns_left_are_named_and_one_that_is_a_quantity_is_hinted_at():
    said = []
    given = Mapping(columns={"ra": "col2", "dec": "DEC"})
    log_not_used(given, ["note", "RA", "DEC", "PA", "Dec"], said.append)
    assert said == ["not used: note, PA, Dec (to use it: --map pa=PA)"]
    said.clear()
    log_not_used(given, ["DEC", "x"], said.append)
    assert said == []


def test_exposures_that_begin_during_a_longer_one_are_told():
    """The third begins after the second, but while the first still lasts; the last when the first has ended."""
    rows = ((1, 60, "00:00", 1000), (2, 60, "00:02", 60), (3, 61, "00:10", 60), (4, 62, "00:16:40", 60))
    text = "\n".join([HEADER, *(f"10000000{n},SCIE,{ra},0,0,2027-11-20T{at}{':00' if len(at) == 5 else ''},{s}" for
                                n, ra, at, s in rows)])  # fmt: skip
    exposures, said = exposures_of(text), []
    log_overlaps(exposures, {obsid: f"line {obsid[-1]}" for obsid in exposures}, said.append)
    assert said == [
        "1 exposure begins while the telescope points elsewhere: 100000003 (line 3) during 100000001 (line 1)"
    ]


@pytest.mark.parametrize("text", ["7 SCIE 10.5 -2.0\n8 BIAS 0 0\n", "7,SCIE,10.5,-2.0\n8,BIAS,0,0\n"])
def test_a_first_row_with_a_number_and_a_text_is_no_heading(tmp_path, text):
    path = tmp_path / "list.txt"
    path.write_text(text)
    found = read_list(path)
    assert found.names == ["col1", "col2", "col3", "col4"]
    assert found.rows == [("line 1", ["7", "SCIE", "10.5", "-2.0"]), ("line 2", ["8", "BIAS", "0", "0"])]
    assert not found.broken
