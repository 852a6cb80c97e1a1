"""The survey table's reader, row by row, and the shipped tables."""

import importlib
import time
from itertools import pairwise

import numpy as np
import pytest
from support.mini import INSTRUMENT

from csstsim.base.errors import InputError
from csstsim.campaign.survey_table import exposures_of, load_survey_table
from csstsim.optics.geometry.wcs import ChipWCS

TABLES = INSTRUMENT.parents[1] / "survey_tables"
HEADER = "obsid,type,ra,dec,pa,time,exptime"
ROW = "10100000001,SCIE,60.0,-40.0,-113.4333,2027-11-20T01:08:00,150"
STATE = ",sat_x,sat_y,sat_z,sat_vx,sat_vy,sat_vz"
SHIPPED = {"demo": 15, "rich_field": 15, "calibration": 11, "w1": 226, "w2": 228, "w3": 261, "w4": 266, "w5": 240}
SHIPPED |= {"benchmark_pack": 20}
SHIPPED |= {f"{name}_straylight": count for name, count in SHIPPED.items() if name.startswith("w")}
RICH = (300.0920, -59.8671)
FIELDS = {
    "w1": (30, -48),
    "w2": (170, -23),
    "w3": (180, 60),
    "w4": (240, 30),
    "w5": (300, -60),
    "demo": (60, -40),
    "rich_field": (300, -60),
    "benchmark_pack": (300, -60),
}


@pytest.fixture(scope="module")
def maker():
    return importlib.import_module("make_tables")


def _table(tmp_path, *lines):
    path = tmp_path / "table.csv"
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


def test_reads_a_row(tmp_path, camera):
    [(obsid, p)] = load_survey_table(_table(tmp_path, HEADER, ROW)).items()
    assert (obsid, p.type, p.ra, p.dec, p.pa, p.exptime) == ("10100000001", "SCIE", 60.0, -40.0, -113.4333, 150.0)
    assert (p.sat_position, p.sat_velocity) == camera.orbit.state("2027-11-20T01:08:00")


def test_comments_blanks_order_and_spreadsheet_quirks(tmp_path):
    """Comments, blank lines, a BOM, CRLF, quoted cells and spaces change nothing."""
    path = tmp_path / "table.csv"
    text = '\ufeff# made by hand\r\n\r\ntime, obsid,"type",dec,ra,exptime,pa\r\n# row\r\n'
    text += '2027-11-20T01:08:00Z,10100000001,"SCIE", -90,0,150,0\r\n'
    text += "2027-11-20T02:08:00,10100000002,BIAS,90,359.999,0,360\r\n"
    path.write_bytes(text.encode())
    first, second = load_survey_table(path).values()
    assert (first.dec, first.ra, first.exptime) == (-90.0, 0.0, 150.0)
    assert (second.type, second.exptime, second.dec) == ("BIAS", 0.0, 90.0)


def test_spacecraft_state_per_row(tmp_path, camera):
    state = ",-2068.3,-5970.3,-2453.7,5.27,-3.58,4.26"
    rows = (ROW + state, ROW.replace("00001", "00002") + ",,,,,,")
    given, modelled = load_survey_table(_table(tmp_path, HEADER + STATE, *rows)).values()
    assert given.sat_position == (-2068.3, -5970.3, -2453.7) and given.sat_velocity == (5.27, -3.58, 4.26)
    assert modelled.sat_position == camera.orbit.state(modelled.time)[0]


def _cell(column, value):
    cells = dict(zip(HEADER.split(","), ROW.split(","), strict=True)) | {column: value}
    return ",".join(cells.values())


@pytest.mark.parametrize(
    ("row", "words"),
    [
        (_cell("dec", "91"), ["column dec", "'91'", "-90 to 90"]),
        (_cell("dec", "nan"), ["column dec", "'nan'", "out of range"]),
        (_cell("dec", "north"), ["column dec", "'north'", "not a number"]),
        (_cell("dec", ""), ["column dec", "not a number"]),
        (_cell("ra", "360"), ["column ra", "'360'", "0 <= ra < 360"]),
        (_cell("ra", "-0.1"), ["column ra", "'-0.1'"]),
        (_cell("ra", "inf"), ["column ra", "'inf'"]),
        (_cell("pa", "361"), ["column pa", "'361'"]),
        (_cell("time", "2027-02-30T00:00:00"), ["column time", "2027-02-30", "YYYY-MM-DD"]),
        (_cell("time", "61000.5"), ["column time", "'61000.5'"]),
        (_cell("time", "2027-11-20"), ["column time", "'2027-11-20'"]),
        (_cell("time", "9999-12-31T23:59:59"), ["column time", "9999", "1950 to 2099"]),
        (_cell("time", "0001-01-01T00:00:00"), ["column time", "0001", "1950 to 2099"]),
        (_cell("exptime", "5e-324"), ["column exptime", "5e-324", "0.001 to 100000 s"]),
        (_cell("exptime", "inf"), ["column exptime", "inf", "100000 s"]),
        (_cell("ra", "60\0"), ["not a line of CSV", "NUL"]),
        (_cell("ra", "6" * 200_000), ["not a line of CSV", "field larger"]),
        (_cell("exptime", "-1"), ["column exptime", "'-1'"]),
        (_cell("exptime", "0"), ["column exptime", "'0'", "BIAS only"]),
        (_cell("exptime", "NaN"), ["column exptime", "'NaN'"]),
        (_cell("type", "WIDE"), ["column type", "'WIDE'", "SCIE, BIAS, DARK, FLAT"]),
        (_cell("type", "scie"), ["column type", "'scie'"]),
        (_cell("obsid", "101"), ["column obsid", "'101'", "9 to 14 digits"]),
        (_cell("obsid", "123456789012345"), ["column obsid", "9 to 14 digits"]),
        (_cell("obsid", "1010000000a"), ["column obsid", "'1010000000a'"]),
        (_cell("obsid", "1.01e10"), ["column obsid", "'1.01e10'"]),
        (_cell("obsid", "\u0661" * 11), ["column obsid", "digits"]),
        (ROW + ",9", ["8 cells under 7 columns"]),
        (ROW.rsplit(",", 1)[0], ["6 cells under 7 columns"]),
    ],
)
def test_each_fault_names_line_column_value_and_allowed(tmp_path, row, words):
    """The bad row stands third among comments, on line 5 of the file."""
    good = ROW.replace("00001", "00002"), ROW.replace("00001", "00003")
    path = _table(tmp_path, "# comment", HEADER, good[0], "", row, good[1])
    with pytest.raises(InputError) as caught:
        load_survey_table(path)
    message = str(caught.value)
    assert message.startswith(f"{path}: line 5") and "\n" not in message
    for word in words:
        assert word in message, message


@pytest.mark.parametrize(
    ("lines", "message"),
    [
        ((HEADER.replace(",pa", ""), ROW), r"line 1: column is missing \(got 'pa'\)"),
        ((HEADER + ",filter", ROW + ",g"), r"line 1: unknown column \(got 'filter'\); allowed: obsid, type"),
        ((HEADER + ",ra", ROW + ",3"), r"line 1: the column is given twice \(got 'ra'\)"),
        ((HEADER + ",sat_x,sat_y", ROW + ",1,2"), r"all six columns or none; missing \(got 'sat_z'\)"),
        ((HEADER, ROW, "# x", ROW), r"line 4, column obsid: duplicate of line 2 \(got '10100000001'\)"),
        ((HEADER + STATE, ROW + ",7000,0,0,0,7.6,"), r"line 2, column sat_vz: .*all six values or none"),
        ((HEADER + STATE, ROW + ",7e6,0,0,0,7.6,0"), r"column sat_x: out of range \(got '7e6'\)"),
        (
            (HEADER + STATE, ROW + ",7,0,0,0,7.6,0"),
            r"column sat_x: distance from the Earth's centre \[km\] out of range \(got 7.0\)",
        ),
        ((HEADER + STATE, ROW + ",7000,0,0,0,7600,0"), r"column sat_vx: speed \[km/s\] out of range \(got 7600.0\)"),
        ((HEADER + STATE, ROW + ",7000,0,0,0,nan,0"), r"column sat_vy: out of range \(got 'nan'\)"),
        ((HEADER,), "the table is empty: a header and no exposure"),
        (("# only words", ""), "the table is empty: no header line"),
    ],
)
def test_faults_of_the_table(tmp_path, lines, message):
    with pytest.raises(InputError, match=message):
        load_survey_table(_table(tmp_path, *lines))


def test_unreadable_files(tmp_path):
    with pytest.raises(InputError, match="No such file"):
        load_survey_table(tmp_path / "absent.csv")
    with pytest.raises(InputError, match="is a folder"):
        load_survey_table(tmp_path)
    (tmp_path / "latin.csv").write_bytes(b"# caf\xe9\n")
    with pytest.raises(InputError, match=r"latin.csv: cannot read the file: not UTF-8 text"):
        load_survey_table(tmp_path / "latin.csv")


def test_three_thousand_rows_in_a_second(tmp_path):
    rows = [ROW.replace("10100000001", f"{10100000001 + i}") for i in range(3000)]
    path = _table(tmp_path, HEADER, *rows)
    start = time.process_time()
    assert len(load_survey_table(path)) == 3000
    assert time.process_time() - start < 1.0


@pytest.mark.parametrize("name", SHIPPED)
def test_shipped_tables_load(name):
    """The paper's numbers of exposures (Table 2), 11 digits, exposures at least their readout apart."""
    pointings = load_survey_table(TABLES / f"{name}.csv")
    assert len(pointings) == SHIPPED[name]
    assert all(len(obsid) == 11 for obsid in pointings)
    gaps = [(b.start - a.end).total_seconds() for a, b in pairwise(pointings.values())]
    assert min(gaps) >= 40
    if name != "calibration":
        assert all(obsid.startswith("101") and p.exptime == 150 for obsid, p in pointings.items())


@pytest.mark.slow
def test_script_makes_the_shipped_bytes(tmp_path, maker, camera):
    maker.make_all(tmp_path, camera)
    made = sorted(path.name for path in tmp_path.iterdir())
    assert made == sorted(path.name for path in TABLES.glob("*.csv"))
    for name in made:
        assert (tmp_path / name).read_bytes() == (TABLES / name).read_bytes(), name


@pytest.mark.parametrize("name", FIELDS)
def test_the_sky_allows_the_exposures(name):
    """At each exposure's start and end: Sun over 50 deg away and Moon over 40 (astropy), Earth's limb over 50."""
    from astropy.coordinates import SkyCoord, get_body
    from astropy.time import Time

    pointings = load_survey_table(TABLES / f"{name}.csv").values()
    times = Time([p.mjd + 75 / 86400 for p in pointings], format="mjd", scale="tdb")
    field = SkyCoord(*FIELDS[name], unit="deg", frame="gcrs")
    for body, limit in (("sun", 50), ("moon", 40)):
        there = get_body(body, times)
        there = SkyCoord(there.ra, there.dec, frame="gcrs")
        assert field.separation(there).deg.min() > limit, body
    position = np.array([p.sat_position for p in pointings])
    target = field.cartesian.xyz.value
    zenith = np.degrees(np.arccos(position @ target / np.linalg.norm(position, axis=1)))
    limb = 180 - np.degrees(np.arcsin(6378.137 / 6778.137)) - zenith
    assert limb.min() > 50


@pytest.mark.thorough
@pytest.mark.parametrize("name", ["w1", "w5", "w5_straylight"])
def test_fields_are_covered_by_every_filter(name, maker, camera):
    """At least 99.9% of 1000 points of the 5 deg2 circle in all ten filters, 80% twice."""
    counts = maker.covered(camera, load_survey_table(TABLES / f"{name}.csv"), *FIELDS[name[:2]], samples=1000)
    assert set(counts) == set(camera.filters)
    for band, n in counts.items():
        assert (n > 0).mean() >= 0.999, band
        assert (n > 1).mean() >= 0.80, band


@pytest.mark.parametrize(
    ("name", "target"),
    [("demo", (60.1172, -40.0330)), ("rich_field", RICH), ("benchmark_pack", RICH)],
)
def test_one_target_is_brought_to_each_imaging_band_twice(camera, name, target):
    """Within 200 px of a chip's centre (1 px), in two position angles 90 deg apart."""
    seen = {}
    for p in load_survey_table(TABLES / f"{name}.csv").values():
        for chip in camera.imaging_chips:
            x, y = ChipWCS(chip, p).world_to_pixel(*target)
            if np.hypot(x - 4607.5, y - 4615.5) < 201:
                seen.setdefault(chip.filter, []).append(p.pa)
    assert set(seen) == {"NUV", "u", "g", "r", "i", "z", "y"}
    for band, angles in seen.items():
        assert sorted(angles) == pytest.approx([-113.4333, -23.4333]), band


CRAFT = {"sat_x": "0", "sat_y": "0", "sat_z": "7000", "sat_vx": "0", "sat_vy": "12", "sat_vz": "0"}


def one(**cells):
    values = {"obsid": "101000001", "type": "SCIE", "ra": "1", "dec": "2", "pa": "3", "time": "2027-11-20T01:08:00",
              "exptime": "150"} | cells  # fmt: skip
    [found] = exposures_of("\n".join([",".join(values), ",".join(values.values())])).values()
    return found


@pytest.mark.parametrize(("good", "bad"), [
    ({"ra": "0"}, {"ra": "-0.000001"}), ({"ra": "359.999999"}, {"ra": "360"}), ({"dec": "-90"}, {"dec": "-90.0001"}),
    ({"pa": "-360"}, {"pa": "-360.01"}), ({"pa": "360"}, {"pa": "360.01"}),
    ({"exptime": "0.001"}, {"exptime": "0.00099"}),
    ({"exptime": "100000"}, {"exptime": "100001"}),
    ({"exptime": "0", "type": "BIAS"}, {"exptime": "0", "type": "DARK"}),
    ({"time": "1950-01-01T00:00:00"}, {"time": "1949-12-31T23:59:59"}), ({"obsid": "1" * 14}, {"obsid": "1" * 15}),
    ({"time": "2099-12-31T23:59:59"}, {"time": "2100-01-01T00:00:00"}), (CRAFT, CRAFT | {"sat_vx": "0.1"}),
    (CRAFT | {"sat_z": "50000"}, CRAFT | {"sat_z": "49999", "sat_x": "400"}),
    (CRAFT | {"sat_z": "-6378.2"}, CRAFT | {"sat_z": "-6378.1"}), (CRAFT, CRAFT | {"sat_vz": ""}),
    ({"survey": "DEEP"}, {"survey": "deep"}), ({"survey": ""}, {"survey": "DEEP", "type": "FLAT"}),
])  # fmt: skip
def test_the_borders_of_cells(good, bad):
    one(**good)
    with pytest.raises(InputError):
        one(**bad)


def test_a_row_is_read_into_its_fields():
    found = one(**CRAFT, survey="DEEP", ra="11.5", dec="-22.25", pa="-33", exptime="44")
    assert (found.type, found.ra, found.dec, found.pa, found.exptime) == ("SCIE", 11.5, -22.25, -33.0, 44.0)
    assert (found.sat_position, found.sat_velocity) == ((0.0, 0.0, 7000.0), (0.0, 12.0, 0.0))
    assert found.survey == "DEEP" and one().survey == one(survey="").survey == "WIDE"
