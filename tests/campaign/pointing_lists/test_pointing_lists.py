"""`csstsim import-pointings`: lists in four formats row by row as astropy says, and broken lists with their reasons."""

import csv

import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import GCRS, CartesianRepresentation, SkyCoord, get_body
from astropy.io import fits
from astropy.table import Table
from astropy.time import Time
from click.testing import CliRunner
from support.pointing_lists import ABOVE, BROKEN, DAY, FORMATS, GOOD, HEAD, STATE, exposures, write

from csstsim.base.errors import InputError
from csstsim.base.shipped import SHIPPED
from csstsim.campaign.pointing_lists.convert import convert
from csstsim.campaign.pointing_lists.mapping import Mapping
from csstsim.campaign.pointing_lists.quantities import parse_key, unit_of
from csstsim.campaign.pointing_lists.read_list import PointingList
from csstsim.campaign.survey_table import load_survey_table
from csstsim.command_line.main import main
from csstsim.instrument.camera import load_telescope

COUNT = 200  # benchmarks/import_pointings.py has a thousand
PLACE_MAS, PA_DEG, TIME_S, STATE_M = 0.01, 1e-6, 2e-6, 1e-3  # places have 9 decimals, angles 7, times 6, states 9
REDUCTION_MAS = 1.0  # astropy's reduction and ours of the same star


def run(file, output, *arguments):
    """Import; return (exit code, what was said)."""
    said = CliRunner().invoke(main, ["import-pointings", str(file), "--output", str(output), *map(str, arguments)])
    assert said.exception is None or isinstance(said.exception, SystemExit), said.exception
    return said.exit_code, said.output


@pytest.fixture(scope="module")
def truth():
    return exposures(COUNT)


@pytest.mark.parametrize("kind", FORMATS)
def test_rows_are_what_astropy_says(tmp_path, truth, kind):
    file, arguments = write(kind, truth, tmp_path)
    code, said = run(file, tmp_path / "table.csv", *arguments)
    assert code == 0, said
    table = load_survey_table(tmp_path / "table.csv")
    rows = list(table.values())
    assert len(rows) == COUNT and [int(obsid) for obsid in table] == truth["obsid"].tolist()
    there = SkyCoord([p.ra for p in rows], [p.dec for p in rows], unit="deg")
    assert there.separation(SkyCoord(truth["ra"], truth["dec"], unit="deg")).mas.max() < PLACE_MAS
    turn = np.array([p.pa for p in rows]) - truth["pa"]
    assert np.abs((turn + 180.0) % 360.0 - 180.0).max() < PA_DEG
    assert np.abs((Time([p.time for p in rows], scale="utc") - truth["time"]).sec).max() < TIME_S
    assert [p.exptime for p in rows] == pytest.approx(truth["exptime"].tolist(), rel=1e-7)
    deep = truth["deep"].tolist() if kind != "ecliptic ECSV" else [False] * COUNT
    assert [p.survey == "DEEP" for p in rows] == deep and {p.type for p in rows} == {"SCIE"}
    if kind == "sexagesimal CSV":
        orbit = load_telescope(SHIPPED / "instrument" / "telescope.yaml").orbit
        assert all(p.sat_position == orbit.state(p.time)[0] for p in rows)
        return
    assert np.abs(np.array([p.sat_position for p in rows]) - truth["position"]).max() < STATE_M / 1e3
    assert np.abs(np.array([p.sat_velocity for p in rows]) - truth["velocity"]).max() < STATE_M / 1e3


def test_the_mapping_that_was_kept_gives_the_same_table(tmp_path, truth):
    file, arguments = write("FITS", truth[:20], tmp_path)
    assert run(file, tmp_path / "one.csv", *arguments)[0] == 0
    assert run(file, tmp_path / "two.csv", "--mapping", tmp_path / "one.mapping.yaml")[0] == 0
    one, two = ((tmp_path / name).read_text().splitlines()[1:] for name in ("one.csv", "two.csv"))
    assert one == two and len(one) == 21
    assert (tmp_path / "one.mapping.yaml").read_text() == (tmp_path / "two.mapping.yaml").read_text()


def test_sun_and_moon_are_seen_from_the_spacecraft(tmp_path, truth):
    """astropy's positions of both, geocentric; the Moon's parallax is up to a degree, light time and aberration 20"."""
    file, arguments = write("strategy list", truth[:200], tmp_path)
    code, said = run(file, tmp_path / "table.csv", *arguments, "--tolerance", 0.02)
    assert code == 0, said
    text = file.read_text().splitlines()
    cells = [line.split() for line in text]
    for row in cells[:50]:  # the Moon on the other side of the sky
        row[12:15] = [f"{-float(value):.3f}" for value in row[12:15]]
    file.write_text("\n".join("  ".join(row) for row in cells))
    code, said = run(file, tmp_path / "moon.csv", *arguments, "--tolerance", 0.02)
    assert code == 1 and "50 rows rejected" in said and "from the Moon" in said, said


def test_icrs_directions_are_seen_from_the_spacecraft(tmp_path, truth):
    """astropy's GCRS of a moving observer is the independent reduction; an angle is that to a point near by."""
    truth = truth[3:200]
    lines = ["observationId,fieldRA,fieldDec,observationStartMJD,visitExposureTime,filter,rotSkyPos"]
    for k, row in enumerate(truth):
        lines.append(f"{k},{row['ra']:.12f},{row['dec']:.12f},{row['time'].mjd:.12f},30.0,r,{row['pa']:.9f}")
    (tmp_path / "visits.csv").write_text("\n".join(lines))
    code, said = run(tmp_path / "visits.csv", tmp_path / "table.csv", "--like", "opsim", "--first-obsid", "10150000000")
    assert code == 0, said
    table = load_survey_table(tmp_path / "table.csv")
    assert list(table) == [str(10150000000 + k) for k in range(len(truth))]
    rows = list(table.values())
    here = SkyCoord(truth["ra"], truth["dec"], unit="deg")
    tip = here.directional_offset_by(truth["pa"] * u.deg, 0.01 * u.deg)
    for p, star, end in zip(rows, here, tip, strict=True):
        place = CartesianRepresentation(p.sat_position * u.km)
        speed = CartesianRepresentation(p.sat_velocity * u.km / u.s)
        frame = GCRS(obstime=Time(p.time, scale="utc"), obsgeoloc=place, obsgeovel=speed)
        seen, end = star.transform_to(frame), end.transform_to(frame)
        assert seen.separation(SkyCoord(p.ra, p.dec, unit="deg", frame=frame)).mas < REDUCTION_MAS
        angle = seen.position_angle(end).deg - p.pa
        assert abs((angle + 180.0) % 360.0 - 180.0) < 1e-5  # 0.4" of a turn: 1 mas at the tip is 3e-5 rad off it
    aberration = here.separation(SkyCoord([p.ra for p in rows], [p.dec for p in rows], unit="deg")).arcsec
    assert 15 < aberration.max() < 27


@pytest.mark.parametrize("what", BROKEN)
def test_a_broken_row_is_refused_alone_with_its_reason(tmp_path, what):
    head, good, bad, reason = BROKEN[what]
    (tmp_path / "list.csv").write_text(f"{head}\n{good}\n{bad}\n")
    maps = ["--map", "time_mjd=mjd"] if "mjd" in head else []
    code, said = run(tmp_path / "list.csv", tmp_path / "out" / "table.csv", *maps)
    assert code == 1, said
    assert len(load_survey_table(tmp_path / "out" / "table.csv")) == 1
    _, [place, told, row] = csv.reader((tmp_path / "out" / "table.rejected.csv").read_text().splitlines())
    assert place == "line 3" and reason in told, told
    assert row.replace('"', "") == bad.replace('"', "")
    assert "1 exposure of 2 rows" in said and "1 row rejected" in said


@pytest.mark.parametrize(
    ("text", "arguments", "reason"),
    [
        ("", (), "the list is empty"),
        ("# words\n", (), "the list is empty"),
        (f"{HEAD}\n", (), "the list is empty: no row"),
        (f"{HEAD}\n{GOOD}\n", (), "list.csv: time: not mapped: use --map, or --set for all rows; allowed: the list's"),
        (f"{HEAD}\n{GOOD}\n", ("--map", "time=MJD"), "list.csv (got 'MJD'); allowed: ra, dec, pa, mjd, exptime"),
        (f"{HEAD}\n{GOOD}\n", ("--map", "time=MJD"), "error: --map time: no such column in"),
        (f"{HEAD}\n{GOOD}\n", ("--map", "time_mjd=col9"), "list.csv (got 'col9')"),
        (f"{HEAD}\n{GOOD}\n", ("--map", "epoch=mjd"), "error: --map epoch: unknown quantity (got 'epoch'); all"),
        (f"{HEAD}\n{GOOD}\n", ("--map", "ra_km=ra"), "--map ra_km: unknown unit (got 'km'); allowed: ra_deg, ra_"),
        (f"{HEAD}\n{GOOD}\n", ("--map", "time_mjd_gps=mjd"), "unknown unit (got 'mjd_gps')"),
        (f"{HEAD}\n{GOOD}\n", ("--map", "ra=ra", "--map", "ra_hour=ra", "--map", "time_mjd=mjd"),
         "ra: given twice, by --map ra and --map ra_hour"),
        (f"{HEAD}\n{GOOD}\n", ("--map", "exptime=exptime", "--set", "exptime=150"),
         "exptime: given twice, by --map exptime and --set exptime"),
        (f"{HEAD}\n{GOOD}\n", ("--map", "ra"), "--map: not KEY=NAME (got 'ra')"),
        (f"{HEAD}\n{GOOD}\n", ("--map", "ra=ra", "--map", "ra=dec"), "--map: given twice (got 'ra')"),
        (f"{HEAD}\n{GOOD}\n", ("--set", "pa=1", "--set", "pa=2"), "--set: given twice (got 'pa')"),
        (f"{HEAD}\n{GOOD}\n", ("--like", "hst"), "no such list (got 'hst'); allowed: csst, opsim"),
        (f"{HEAD}\n{GOOD}\n", ("--mapping", "/nowhere.yaml"), "/nowhere.yaml: cannot read the file"),
        (f"{HEAD}\n{GOOD}\n", ("--pa-zero", "nan"), "pa_zero"),
        (f"{HEAD}\n{GOOD}\n", ("--first-obsid", "12"), "first_obsid"),
        (f"ra,{HEAD}\n1,{GOOD}\n", ("--map", "time_mjd=mjd"), "list.csv has this column twice (got 'ra')"),
        (HEAD.replace("dec", "ecl_lat") + f"\n{GOOD}\n", ("--map", "time_mjd=mjd"),
         "no direction is mapped: use --map; allowed: ra and dec; ecl_lon and ecl_lat; gal_lon and gal_lat (the li"),
        (f"{HEAD},sat_x\n{GOOD},7000\n", ("--map", "time_mjd=mjd"), "all of these or none (got 'no sat_y')"),
        (f"ra_hour,{HEAD[3:]}\n{GOOD}\n", ("--map", "ra_deg=ra_hour", "--map", "time_mjd=mjd"),
         "two units of ra: the column's name says hour, the mapping deg"),
        (f"{HEAD}\n{GOOD.replace('-40', '-140')}\n", ("--map", "time_mjd=mjd"), "no row can be used"),
        ("\x00\xff", (), "not a line of CSV"),
    ],
)  # fmt: skip
def test_a_list_that_is_broken_as_a_whole_is_refused(tmp_path, text, arguments, reason):
    (tmp_path / "list.csv").write_text(text)
    code, said = run(tmp_path / "list.csv", tmp_path / "table.csv", *arguments)
    assert code == 2 and reason in said and said.splitlines()[-1].startswith("csstsim: error:"), said
    assert not (tmp_path / "table.csv").exists() and not (tmp_path / "table.mapping.yaml").exists()


def test_damaged_and_absent_files(tmp_path, truth):
    file, arguments = write("FITS", truth[:50], tmp_path)
    content = file.read_bytes()
    for name, spoiled in (("cut.fits", content[: len(content) // 2]), ("image.fits", None), ("latin.csv", b"ra\xe9\n")):
        if spoiled is None:
            fits.PrimaryHDU(np.zeros((3, 3))).writeto(tmp_path / name)
        else:
            (tmp_path / name).write_bytes(spoiled)
        assert run(tmp_path / name, tmp_path / "table.csv", *arguments)[0] == 2
    assert run(tmp_path / "absent.csv", tmp_path / "table.csv")[0] == 2
    assert not list(tmp_path.glob("table*"))


def test_no_file_is_overwritten(tmp_path):
    (tmp_path / "list.csv").write_text(f"{HEAD}\n{GOOD}\n")
    (tmp_path / "table.rejected.csv").write_text("kept")
    code, said = run(tmp_path / "list.csv", tmp_path / "table.csv", "--map", "time_mjd=mjd")
    assert code == 2 and "exists already" in said and (tmp_path / "table.rejected.csv").read_text() == "kept"


def listed(folder, rows, head=HEAD, name="list.csv"):
    (folder / name).write_text("\n".join([head, *rows]) + "\n")
    return folder / name


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        (
            ("--map", "time_mjd=JD"),
            "column JD: out of range; allowed: a time as mjd of the years 1950 to 2099; or map time_jd",
        ),
        (("--map", "time_iso=JD"), "column JD: not a time; allowed: YYYY-MM-DDThh:mm:ss[.ffffff]"),
        (("--map", "time_jd=JD", "--set", "type=FOO"), "--set type: unknown exposure type; allowed: SCIE"),
        (("--map", "time_jd=JD", "--map", "obsid=deep"), "column deep: not an observation id; allowed: 9 to 14 digits"),
    ],
)
def test_of_a_list_without_a_row_that_can_be_used_the_reasons_are_counted(tmp_path, arguments, reason):
    rows = [f"60,{-40 if k else 95},10,2461729.625,150,0" for k in range(20)]
    file = listed(tmp_path, rows, "ra,DEJ2000,pa,JD,exptime,deep")
    code, said = run(file, tmp_path / "t.csv", "--map", "dec=DEJ2000", *arguments)
    head, most, other, error = said.splitlines()
    assert code == 2 and head == f"{tmp_path / 't.rejected.csv'}: 20 rows rejected"
    assert most.startswith(f"  19  {reason}"), said
    assert other == "  1  column DEJ2000: out of range; allowed: -90 to 90 deg"
    assert f"no row can be used; 19 of 20 rows: {reason}" in error


def test_a_state_underground_of_all_rows_is_named_by_its_option(tmp_path):
    sets = [part for name in STATE[1:].split(",") for part in ("--set", f"{name.removesuffix('_km')}=1")]
    code, said = run(listed(tmp_path, [GOOD, GOOD]), tmp_path / "t.csv", "--map", "time_mjd=mjd", *sets)
    assert code == 2 and "2 of 2 rows: --set sat_x: distance from the Earth's centre [km] out of range" in said, said


def test_a_count_that_leaves_the_obsids_is_the_first_obsids_fault(tmp_path):
    arguments = "--map", "time_mjd=mjd", "--first-obsid", 99999999999999
    code, said = run(listed(tmp_path, [GOOD, GOOD]), tmp_path / "t.csv", *arguments)
    assert code == 1 and "--first-obsid and the number of the row: not an observation id" in said, said


def test_an_import_that_left_no_table_does_not_block_the_next(tmp_path):
    file, output = listed(tmp_path, [GOOD]), tmp_path / "table.csv"
    assert run(file, output, "--map", "time_jd=mjd")[0] == 2
    assert run(file, output, "--map", "time_unix=mjd", "--map", "pa=exptime")[0] == 0
    assert not (tmp_path / "table.rejected.csv").exists()
    code, said = run(file, output, "--map", "time_mjd=mjd")
    assert code == 2 and "table.csv: --output: exists already" in said
    output.unlink()
    assert run(file, output, "--mapping", tmp_path / "table.mapping.yaml", "--map", "time_mjd=mjd")[0] == 0
    assert "time_mjd" in (tmp_path / "table.mapping.yaml").read_text()


def test_a_mapping_of_ones_own_is_not_overwritten(tmp_path):
    own = tmp_path / "table.mapping.yaml"
    own.write_text("columns: {time_mjd: mjd}\n")
    code, said = run(listed(tmp_path, [GOOD]), tmp_path / "table.csv", "--mapping", own)
    assert code == 2 and "table.mapping.yaml: --output: exists already" in said
    assert own.read_text() == "columns: {time_mjd: mjd}\n"


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("columns: {time_mjd: mjd, dec: DECJ2000}", "m.yaml: columns.dec: no such column in"),
        ("columns: {time_mjd: mjd, decl: dec}", "m.yaml: columns.decl: unknown quantity (got 'decl')"),
        ("columns: {exptime: exptime}\nvalues: {exptime: 3}",
         "m.yaml: exptime: given twice, by columns.exptime and values.exptime"),
        ("columns: {time_mjd: mjd}\nvalues: {type: FOO}", "m.yaml: values.type: unknown exposure type"),
    ],
)  # fmt: skip
def test_faults_of_a_mapping_name_its_file_and_key(tmp_path, text, reason):
    (tmp_path / "m.yaml").write_text(text)
    code, said = run(listed(tmp_path, [GOOD]), tmp_path / "t.csv", "--mapping", tmp_path / "m.yaml")
    assert code == 2 and reason in said, said


def test_a_folder_in_which_no_file_can_be_made(tmp_path):
    code, said = run(listed(tmp_path, [GOOD]), "/proc/u.csv", "--map", "time_mjd=mjd")
    assert code == 2 and "error: /proc/u.mapping.yaml: --output: cannot be written" in said, said


def test_columns_that_are_not_used_are_said(tmp_path):
    file = listed(tmp_path, [GOOD + ",1,2"], HEAD + ",DEEP,x")
    code, said = run(file, tmp_path / "t.csv", "--map", "time_mjd=col4")
    assert code == 0 and "\nnot used: DEEP, x (to use it: --map deep=DEEP)\n" in said, said
    file = listed(tmp_path, [GOOD + ",0" * 12], HEAD + "".join(f",c{k}" for k in range(12)))
    assert (
        "not used: c0, c1, c2, c3, c4, c5, c6, c7 and 4 more\n"
        in run(file, tmp_path / "u.csv", "--map", "time_mjd=mjd")[1]
    )
    assert "not used" not in run(listed(tmp_path, [GOOD]), tmp_path / "v.csv", "--map", "time_mjd=mjd")[1]


def test_columns_named_as_of_a_catalogue_hint_at_directions(tmp_path):
    maps = "--map", "time_mjd=mjd", "--map", "ra=RAJ2000", "--map", "dec=dec_icrs"
    file = listed(tmp_path, [GOOD], "RAJ2000,dec_icrs,pa,mjd,exptime")
    assert "RAJ2000 and dec_icrs are used as apparent" in run(file, tmp_path / "t.csv", *maps)[1]
    for k, said in enumerate(("icrs", "apparent")):  # who says so need not be asked
        code, told = run(file, tmp_path / f"{k}.csv", *maps, "--directions", said)
        assert code == 0 and "apparent" not in told
    assert "apparent" not in run(listed(tmp_path, [GOOD]), tmp_path / "v.csv", "--map", "time_mjd=mjd")[1]


def test_refused_rows_are_in_the_order_of_the_list(tmp_path):
    """By number of the line, whatever the reason: rows of another length, and rows out of range."""
    rows = [f"60,{95 if k in (9, 1) else -40},10,{DAY},150" + (",7" if k in (0, 12) else "") for k in range(14)]
    code, said = run(listed(tmp_path, rows), tmp_path / "t.csv", "--map", "time_mjd=mjd")
    told = [line.split(",")[0] for line in (tmp_path / "t.rejected.csv").read_text().splitlines()[1:]]
    assert code == 1 and "10 exposures of 14 rows" in said and told == ["line 2", "line 3", "line 11", "line 14"]


def test_the_last_comment_that_fits_names_the_columns(tmp_path):
    """Not an earlier one of as many words, nor one of numbers or of another count."""
    lines = ["# one two three four five", f"# {' '.join(HEAD.split(','))}", "# 1 2 3 4 5", "# end of head"]
    p = one(tmp_path, "\n".join([*lines, " ".join(GOOD.split(","))]), "--map", "time_mjd=mjd")
    assert (p.ra, p.dec, p.exptime) == tuple(float(GOOD.split(",")[k]) for k in (0, 1, 4))


def test_exposures_with_the_earth_in_the_way_are_named(tmp_path):
    x, y, z = load_telescope(SHIPPED / "instrument" / "telescope.yaml").orbit.state("2027-11-20T03:00:00")[0]
    ra, dec = np.degrees([np.arctan2(y, x), np.arctan2(z, np.hypot(x, y))])
    rows = [f"{a},{d},10,{DAY},150" for a, d in ((ra, dec), ((ra + 180) % 360, -dec))]
    code, said = run(listed(tmp_path, rows), tmp_path / "t.csv", "--map", "time_mjd=mjd")
    assert code == 0 and "The Earth blocks 1 exposure: 10100000002. " in said and "sat_x ... sat_vz" in said, said


@pytest.mark.parametrize("order", [1, -1])
def test_exposures_that_overlap_at_different_places_are_named_by_row(tmp_path, order):
    """150 s each: the second begins in the first at another place, the third in the first at its place."""
    day = float(DAY)
    times = [(10.0, 0.0), (20.0, 60.0), (10.0, 120.0), (30.0, 280.0)]
    rows = [f"{ra},2,10,{day + seconds / 86400:.9f},150" for ra, seconds in times][::order]
    code, said = run(listed(tmp_path, rows), tmp_path / "t.csv", "--map", "time_mjd=mjd")
    [line] = [line for line in said.splitlines() if "points elsewhere" in line]
    first, second = ("line 2", "line 3") if order == 1 else ("line 5", "line 4")
    assert code == 0 and line.startswith("2 exposures begin") and f"({second}) during" in line and first in line, said


def test_a_quantity_named_by_a_form_of_time_is_proposed(tmp_path):
    code, said = run(listed(tmp_path, [f"1,2,10,{DAY},150"]), tmp_path / "t.csv", "--map", "jd=mjd")
    assert code == 2 and "did you mean time_jd?" in said


def one(tmp_path, text, *arguments, name="list.csv"):
    """Import a list of one row; return its Pointing."""
    (tmp_path / name).write_text(text)
    code, said = run(tmp_path / name, tmp_path / "table.csv", *arguments)
    assert code == 0, said
    [pointing] = load_survey_table(tmp_path / "table.csv").values()
    return pointing


@pytest.mark.parametrize("delimiter", [",", ";", "\t", "|", "   "])
def test_delimiters_names_in_a_comment_and_byte_order_mark(tmp_path, delimiter):
    names, cells = HEAD.replace("mjd", "start_mjd").split(","), GOOD.split(",")
    lines = ["\ufeff# one of many", "# " + delimiter.join(names), delimiter.join(cells), ""]
    assert one(tmp_path, "\r\n".join(lines), "--map", "time=start_mjd").time == "2027-11-20T03:00:00"


def test_empty_cells_at_the_ends_of_a_row_with_tabs_are_cells(tmp_path):
    """Blanks about the others are not part of them."""
    names, cells = HEAD.replace(",", "\t"), GOOD.replace(",", " \t ")
    p = one(tmp_path, f"first\t{names}\tlast\n\t{cells}\t\n", "--map", "time_mjd=mjd")
    assert (p.ra, p.dec, p.exptime) == tuple(float(GOOD.split(",")[k]) for k in (0, 1, 4))


@pytest.mark.parametrize(
    ("key", "value", "time"),
    [
        ("time_jd", "2461729.625", "2027-11-20T03:00:00"),
        ("time_mjd_tai", "61729.125", "2027-11-20T02:59:23"),  # TAI - UTC = 37 s since 2017
        ("time_unix", "1826679600", "2027-11-20T03:00:00"),
        ("time", "2027-11-20 03:00Z", "2027-11-20T03:00:00"),
        ("time_tai", "2027-11-20T03:00:37", "2027-11-20T03:00:00"),  # a scale alone is one of ISO times
        ("time_iso_tt", "2027-11-20T03:01:09.184", "2027-11-20T03:00:00"),  # TT - TAI = 32.184 s
        ("time", "2027-11-20T03:00:00.1234567", "2027-11-20T03:00:00.123457"),
        ("time_mjd", "61729.999999999999", "2027-11-21T00:00:00"),
    ],
)
def test_times(tmp_path, key, value, time):
    assert one(tmp_path, f"ra,dec,pa,t,exptime\n0,0,0,{value},150\n", "--map", f"{key}=t").time == time


@pytest.mark.parametrize(
    ("ra", "wanted"), [("-0.5", 359.5), ("360", 0.0), ("-180", 180.0), ("359.99999999999", 0.0), ("-1e-13", 0.0)]
)
def test_right_ascension_is_wrapped_and_never_360(tmp_path, ra, wanted):
    assert one(tmp_path, f"ra,dec,pa,mjd,exptime\n{ra},90,0,{DAY},1\n", "--map", "time_mjd=mjd").ra == wanted


@pytest.mark.parametrize(
    ("sense", "zero", "given", "wanted"),
    [("east", 0, 30, 30), ("west", 0, 30, 330), ("west", 90, 30, 60), ("east", -90, 30, 300)],
)
def test_senses_of_the_position_angle(tmp_path, sense, zero, given, wanted):
    row = f"ra,dec,pa,mjd,exptime\n10,20,{given},{DAY},1\n"
    p = one(tmp_path, row, "--map", "time_mjd=mjd", "--pa-sense", sense, "--pa-zero", zero)
    assert p.pa == pytest.approx(wanted, abs=PA_DEG)


def test_values_of_all_rows_and_galactic_north(tmp_path):
    """At the galactic centre the galactic north pole is at position angle 31.40 deg (e.g. Reid & Brunthaler 2004)."""
    arguments = "--map", "time_mjd=mjd", "--set", "pa=0", "--set", "exptime_min=5", "--set", "deep=yes"
    p = one(tmp_path, f"gal_lon gal_lat mjd\n0 0 {DAY}\n", *arguments, "--pa-north", "galactic")
    assert (p.ra, p.dec) == pytest.approx((266.405, -28.936), abs=1e-3)
    assert (360.0 - p.pa) == pytest.approx(58.6, abs=0.05) and p.exptime == 300.0 and p.survey == "DEEP"


def test_a_row_without_a_state_among_others_has_the_model_orbits(tmp_path):
    (tmp_path / "list.csv").write_text(f"{HEAD}{STATE}\n{ABOVE}\n{GOOD},,,,,,\n")
    assert run(tmp_path / "list.csv", tmp_path / "table.csv", "--map", "time_mjd=mjd")[0] == 0
    first, second = load_survey_table(tmp_path / "table.csv").values()
    assert first.sat_position == pytest.approx((2596.6, 4497.4, 4357.5))
    orbit = load_telescope(SHIPPED / "instrument" / "telescope.yaml").orbit
    assert second.sat_position == orbit.state(second.time)[0]


def test_units_are_said_in_three_places_that_must_agree():
    ra, time = parse_key("ra"), parse_key("time")
    assert (
        unit_of(ra, "x", None) == "deg"
        and unit_of(ra, "x", u.hourangle) == "hour"
        and unit_of(ra, "x_rad", None) == "rad"
    )
    assert unit_of(parse_key("ra_hour"), "x", u.hourangle) == "hour" and unit_of(time, "MJD", None) == "mjd_utc"
    assert (
        unit_of(parse_key("time_jd_tt"), "MJD", u.day) == "jd_tt"
        and unit_of(parse_key("sat_vx"), "sat_vx_km_s", None) == "km_s"
    )
    for key, column, stated in (
        (ra, "x_hour", u.deg),
        (ra, "x", u.km),
        (parse_key("ra_deg"), "x", u.rad),
        (time, "t", u.deg),
    ):
        with pytest.raises(InputError, match="unit"):
            unit_of(key, column, stated)


def test_masked_and_whole_numbers_of_fits(tmp_path):
    table = Table({"ra": [10, 20], "dec": [-1.5, 2.5], "pa": [0, 0], "exptime": [150, 150], "MJD": [61729.0, 61730.0]})
    table = Table(table, masked=True)
    table["exptime"].mask[1] = True
    table.write(tmp_path / "list.fits")
    code, _ = run(tmp_path / "list.fits", tmp_path / "table.csv", "--map", "time=MJD")
    assert code == 1 and len(load_survey_table(tmp_path / "table.csv")) == 1
    assert "row 2,column exptime: no value" in (tmp_path / "table.rejected.csv").read_text()


ORBIT = load_telescope(SHIPPED / "instrument" / "telescope.yaml").orbit
PLAIN = {"ra": "60", "dec": "-40", "pa": "10", "time": "2027-11-20T03:00:00", "exptime": "150"}


def converted(rows, **conventions):
    """Return the Converted of rows {key: text}, over PLAIN, of one list whose columns are called as their keys."""
    rows = [PLAIN | row for row in rows]
    names = list(rows[0])
    cells = [(f"line {k + 2}", [row[name] for name in names]) for k, row in enumerate(rows)]
    mapping = Mapping(columns={name: name for name in names}, **conventions)
    return convert(PointingList("list.csv", names, cells), mapping, ORBIT)


def test_cells_have_their_digits_and_stated_numbers_count_from_the_first_obsid():
    found = converted(
        [{"number": "0", "ra": "359.9999999999", "pa": "-10.25"}, {"number": "37", "exptime": "33.25"}],
        first_obsid="000000123",
    )  # fmt: skip
    assert not found.reasons and list(found.rows) == [0, 1]
    assert found.rows[0] == {
        "obsid": "000000123", "type": "SCIE", "ra": "0.000000000", "dec": "-40.000000000", "pa": "349.7500000",
        "time": "2027-11-20T03:00:00", "exptime": "150",
    }  # fmt: skip
    assert (found.rows[1]["obsid"], found.rows[1]["exptime"]) == ("000000160", "33.25")
    assert [row["obsid"] for row in converted([{}, {}]).rows.values()] == ["10100000001", "10100000002"]
    typed = converted([{"type": "dark", "deep": "no"}, {"type": "Scie", "deep": "yes"}]).rows
    assert [(row["type"], row["survey"]) for row in typed.values()] == [("DARK", "WIDE"), ("SCIE", "DEEP")]


@pytest.mark.parametrize(("tolerance", "refused"), [(2.0, [2]), (0.5, [1, 2]), (4.0, [])])
def test_a_second_direction_may_be_off_by_the_tolerance(tolerance, refused):
    """Galactic places of the row's own, of one a degree and of one three degrees to the north."""
    places = [SkyCoord(60.0, dec, unit="deg").galactic for dec in (-40.0, -39.0, -37.0)]
    rows = [{"gal_lon": f"{place.l.deg:.9f}", "gal_lat": f"{place.b.deg:.9f}"} for place in places]
    found = converted(rows, tolerance=tolerance)
    assert list(found.reasons) == refused and list(found.rows) == [k for k in range(3) if k not in refused]
    for row in refused:
        apart = {1: 1, 2: 3}[row]
        assert found.reasons[row] == (f"two directions, {apart} deg from each other; allowed: up to {tolerance:g} deg")
    assert all(row["dec"] == "-40.000000000" for row in found.rows.values())  # the first frame counts


def test_the_earth_in_the_way_of_the_model_orbit_is_noted_of_science_exposures_alone():
    """Towards the zenith of the model orbit, towards the nadir, and a dark there."""
    x, y, z = ORBIT.state(PLAIN["time"])[0]
    ra, dec = np.degrees([np.arctan2(y, x), np.arctan2(z, np.hypot(x, y))])
    up, down = {"ra": f"{ra % 360}", "dec": f"{dec}"}, {"ra": f"{(ra + 180) % 360}", "dec": f"{-dec}"}
    found = converted([up | {"type": "SCIE"}, down | {"type": "SCIE"}, down | {"type": "DARK"}])
    assert found.blocked == ["10100000002"] and len(found.rows) == 3 and not found.reasons


@pytest.mark.parametrize("body", ["sun", "moon"])
def test_the_angle_of_a_body_is_that_of_its_place_seen_from_the_spacecraft(body):
    """astropy's place of it, 10 deg off or 0.5; both ways of stating it are compared, within a degree."""
    rows = []
    names, state = STATE[1:].replace("_km", "").split(","), ABOVE.split(",")[5:]
    craft = dict(zip(names, state, strict=True))
    seen = get_body(body, Time(PLAIN["time"])).cartesian.xyz.to_value(u.km)
    away = seen - np.array([2596.6, 4497.4, 4357.5])
    boresight = SkyCoord(60, 40, unit="deg", frame=GCRS())
    there = SkyCoord(CartesianRepresentation(away * u.km), frame=GCRS()).separation(boresight).deg
    for off in (0.0, 0.5, -0.5, 1.5, -1.5):
        rows.append({"dec": "40", f"{body}_angle": f"{there + off:.6f}"} | craft)
    assert list(converted(rows).reasons) == [3, 4]
    rows = []
    for shift in (0.0, 0.9, 3.0):  # in units of a degree of the distance, along the boresight
        moved = seen + np.radians(shift) * np.linalg.norm(away) * boresight.cartesian.xyz.value
        place = {f"{body}_{axis}": f"{value:.3f}" for axis, value in zip("xyz", moved, strict=True)}
        rows.append({"dec": "40"} | place | craft)
    refused = converted(rows, tolerance=1.0).reasons
    assert list(refused) == [2] and f"from the {body.capitalize()}" in refused[2]
