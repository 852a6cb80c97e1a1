"""`csstsim aim`: rows of a survey table that put a place on a chip, and errors that say where the nearest chip is."""

import csv
import itertools
import math
import textwrap
from datetime import datetime
from types import SimpleNamespace

import numpy as np
import pytest
import yaml
from astropy import units as u
from astropy.coordinates import SkyCoord
from click.testing import CliRunner
from support.mini_campaign import write_campaign

from csstsim.base.errors import InputError
from csstsim.campaign.aiming import (
    DEFAULT_CHIP,
    DEFAULT_TIME,
    aimed_exposures,
    chips_for,
    next_obsid,
    next_start,
    survey_table_text,
)
from csstsim.campaign.opened import OpenCampaign
from csstsim.campaign.survey_table import exposures_of, load_survey_table
from csstsim.catalog.astrometry.ephemeris import observer
from csstsim.catalog.astrometry.reduction import apparent
from csstsim.command_line.main import main
from csstsim.optics.geometry.distortion import load_distortion
from csstsim.optics.geometry.pointing_for import aim_point
from csstsim.optics.geometry.wcs import ChipWCS

ROUNDED = 0.1  # px; a table has micro-degrees


def lands(camera, chip, pointing, ra, dec):
    """Return the pixel on which ra, dec (ICRS) falls."""
    craft = observer(pointing.mjd, pointing.sat_position, pointing.sat_velocity)
    wcs = ChipWCS(chip, pointing, load_distortion(camera.folder / "distortion.fits"))
    return [float(v) for v in wcs.world_to_pixel(*apparent(ra, dec, craft))]


@pytest.mark.parametrize("place", [(150.1, 2.2), (0.0, -2.2), (359.9999, 60.0)])
def test_the_rows_put_the_place_where_the_chips_light_has_room(camera, tmp_path, place):
    chips = chips_for(camera, [6], camera.filters)
    shifts = [(0.0, 0.0), (10.0, -5.0)]
    times = ["2027-11-20T01:20:00", "2028-05-20T00:00:00"]
    found = aimed_exposures(camera, *place, chips, pa=-113.4, times=times, shifts=shifts)
    assert len(found) == 11 * 2 * 2
    (tmp_path / "table.csv").write_text(survey_table_text(found))
    read = load_survey_table(tmp_path / "table.csv")
    assert list(read) == list(found)
    starts = [p.start for p in read.values()]
    assert starts == sorted(starts) and all(a.end < b.start for a, b in itertools.pairwise(read.values()))
    for i, (pointing, chip) in enumerate(zip(read.values(), 2 * [chip for chip in chips for _ in shifts], strict=True)):
        at, _ = aim_point(camera, chip)
        wanted = [a + s / camera.telescope.pixel_scale for a, s in zip(at, shifts[i % 2], strict=True)]
        assert math.dist(lands(camera, chip, pointing, *place), wanted) < ROUNDED


@pytest.mark.parametrize("pa", [-33.0, 120.0])
def test_the_position_angle_is_that_of_the_columns_north_through_east(camera, pa):
    """A place 30 arcsec off at this angle, by astropy, lies 405 px further along y; field distortion moves 1% of it."""
    [pointing] = aimed_exposures(camera, 150.1, 2.2, [camera.chips[9]], pa=pa).values()
    here = SkyCoord(150.1, 2.2, unit="deg")
    there = here.directional_offset_by(pa * u.deg, 30 * u.arcsec)
    chip = camera.chips[9]
    ends = (lands(camera, chip, pointing, place.ra.deg, place.dec.deg) for place in (here, there))
    assert np.subtract(*ends) == pytest.approx((0.0, -30 / camera.telescope.pixel_scale), abs=4.0)


def test_the_keys_that_are_printed_select_what_was_aimed_at(tmp_path):
    """A campaign with them has each exposure on each chip that was named, and the target within each window."""
    path = tmp_path / "table.csv"
    line = ["aim", "150.1", "-2.2", "--chip", "9", "--chip", "7", "--filter", "g", "--output", str(path)]
    said = CliRunner().invoke(main, line).output
    first, keys = said.split("\n", 1)
    assert first.startswith(f"{path}: 3 exposures. ")
    file = tmp_path / "campaign.yaml"
    given = {"schema_version": 1, "name": "aimed", "seed": 1, "output": "out"}
    file.write_text(yaml.safe_dump(given | yaml.safe_load(textwrap.dedent(keys))))
    run = OpenCampaign(file)
    assert [chip.id for chip in run.chips] == [7, 8, 9]
    for obsid, number in zip(run.exposures, (9, 7, 8), strict=True):
        job = run.job(obsid, number)
        x, y = job.wcs.world_to_pixel(*apparent(150.1, -2.2, job.observer))
        radius = 60 / 0.074  # an arcmin, rounded outwards
        assert job.window.nx == pytest.approx(2 * radius, abs=4) and job.window.ny == pytest.approx(2 * radius, abs=4)
        assert float(x) - job.window.x0 == pytest.approx(radius, abs=2)
        assert float(y) - job.window.y0 == pytest.approx(radius, abs=2)


def test_the_camera_that_is_named_is_aimed(tmp_path):
    """Of chips of 128 px the place falls on the middle of such a one."""
    file = write_campaign(tmp_path, select={"types": ["SCIE"], "chips": [24]})
    line = ["aim", "60", "-40", "--chip", "24", "--instrument", str(tmp_path / "instrument")]
    (tmp_path / "table.csv").unlink()
    said = CliRunner().invoke(main, [*line, "--output", str(tmp_path / "table.csv")])
    assert said.exit_code == 0, said.output
    [job] = OpenCampaign(file).jobs
    x, y = job.wcs.world_to_pixel(*apparent(60.0, -40.0, job.observer))
    assert (float(x), float(y)) == pytest.approx((63.5, 63.5), abs=ROUNDED)


def test_a_table_that_its_reader_refuses_is_not_written(tmp_path):
    """The second obsid has a digit too many."""
    line = ["aim", "150", "2", "--obsid", "9" * 14, "--dither", "0", "0", "--dither", "5", "5"]
    for more in ([], ["--output", str(tmp_path / "t.csv")]):
        said = CliRunner().invoke(main, [*line, *more])
        assert said.exit_code == 2 and "not an observation id" in said.stderr and not said.stdout
    assert not list(tmp_path.iterdir())


def test_behind_gratings_both_orders_lie_about_the_middle_of_the_wider_grating(camera):
    for chip in camera.slitless_chips:
        gratings, nx = camera.gratings[chip.id], chip.detector.nx
        (x, y), middle = aim_point(camera, chip)
        left, right, down, up = gratings.span(x, y)
        assert abs(x + (left + right) / 2 - middle[0]) < 1.0 and abs(y + (down + up) / 2 - middle[1]) < 1.0
        wide = max((0, gratings.split), (gratings.split, nx), key=lambda part: part[1] - part[0])
        assert wide[0] + 1000 < x + left and x + right < wide[1] - 1000  # px: far from the border of the two


def test_a_filter_means_its_innermost_chip(camera):
    assert [chip.id for chip in chips_for(camera, (), ("g", "r", "i"))] == [8, 9, 7]
    assert [chip.id for chip in chips_for(camera)] == [9]
    for chip in chips_for(camera, (), camera.filters):
        others = [other for other in camera.chips.values() if other.filter == chip.filter]
        assert math.hypot(chip.xc, chip.yc) == np.hypot(*np.transpose([(o.xc, o.yc) for o in others])).min()


def test_the_command_prints_or_writes_the_table(tmp_path):
    printed = CliRunner().invoke(
        main, ["aim", "150.1", "-2.2", "--filter", "r", "--dither", "0", "0", "--dither", "-5", "3"]
    )
    assert printed.exit_code == 0
    rows = list(csv.DictReader(line for line in printed.output.splitlines() if line[0] != "#"))
    assert [row["obsid"] for row in rows] == ["10100000001", "10100000002"]
    path = tmp_path / "table.csv"
    written = CliRunner().invoke(main, ["aim", "150.1", "-2.2", "--output", str(path)])
    assert written.exit_code == 0 and "survey_table:" in written.output and len(load_survey_table(path)) == 1
    again = CliRunner().invoke(main, ["aim", "150.1", "-2.2", "--output", str(path)])
    assert again.exit_code == 2 and "exists already" in again.output


@pytest.mark.parametrize(
    ("line", "message"),
    [
        (["150", "2", "--chip", "31"], "--chip: no such chip"),
        (["150", "2", "--filter", "q"], "--filter: no such filter"),
        (["150", "99"], "out of range"),
        (["nan", "2"], "out of range"),
        (["10", "90"], "near a pole: take "),
        (["150", "2", "--time", "tomorrow"], "not an ISO UTC time"),
        (["150", "2", "--obsid", "12"], "not an observation id"),
        (["150", "2", "--exptime", "0"], "exptime above 0"),
        (["150", "2", "--exptime", "1e12"], "to 100000 [s]"),
        (["150", "2", "--chip", "8", "--time", "2027-11-20T01:20:00", "--time", "2027-11-20T01:21:00"], "not ended"),
    ],
)  # fmt: skip
def test_what_cannot_be_used_is_one_clear_error(line, message):
    result = CliRunner().invoke(main, ["aim", *line])
    assert result.exit_code == 2 and message in result.output and "Traceback" not in result.output


def test_a_region_that_touches_no_chip_names_the_nearest_and_the_distance(tmp_path, camera):
    """The boresight itself lies between the chips: by far the most usual slip."""
    select = {"types": ["SCIE"], "chips": "imaging", "region": {"ra": 60.0, "dec": -40.0, "radius": 0.01}}
    row = "10100000001,SCIE,60.0,-40.0,0,2027-11-20T01:08:00,150"
    campaign = write_campaign(tmp_path, [row], select=select)
    with pytest.raises(InputError, match=r"it misses chip \d+ \(.*\) of exposure 10100000001 by \d+\.\d'") as error:
        _ = OpenCampaign(campaign).jobs
    assert "csstsim aim" in str(error.value) and str(error.value).count("of exposure") == 3


def test_types_and_filters_that_select_nothing_say_so(tmp_path):
    with pytest.raises(InputError, match="no exposure has one of these types"):
        _ = OpenCampaign(write_campaign(tmp_path, select={"types": ["DARK"]})).jobs
    with pytest.raises(InputError, match="none of the chips is behind one of the filters"):
        _ = OpenCampaign(write_campaign(tmp_path, select={"types": ["SCIE"], "chips": [9], "filters": ["g"]})).jobs


@pytest.mark.parametrize("place", [(200.0, 10.0), None])
def test_check_does_not_call_a_scene_good_that_no_chip_sees(tmp_path, place):
    rows = "" if place is None else f"{place[0]},{place[1]},20\n"
    (tmp_path / "objects.csv").write_text("ra,dec,mag_r\n" + rows)
    catalog = {"kind": "csstsim.catalog.own_table:TableCatalog", "options": {"file": "objects.csv"}}
    result = CliRunner().invoke(main, ["check", str(write_campaign(tmp_path, catalog=catalog))])
    assert result.exit_code == 2 and "no object of the catalogue reaches any chip" in result.output


def test_the_next_obsid_has_as_many_digits():
    assert [next_obsid(obsid) for obsid in ("000000099", "10100000001", "099999999")] == [
        "000000100", "10100000002", "100000000",
    ]  # fmt: skip


def test_exposures_follow_each_other_with_a_gap(camera):
    """Two chips and two shifts at two times: four rows each, the next a minute after the end."""
    chips, times = [camera.chips[9], camera.chips[7]], ("2027-11-20T01:20:00", "2027-12-20T01:20:00")
    shifts = ((0.0, 0.0), (30.0, -7.4))
    more = {"exptime": 90.0, "obsid": "000000098"}
    found = aimed_exposures(camera, 60.0, -40.0, chips, pa=20.0, times=times, shifts=shifts, **more)
    assert list(found) == [f"{number:09d}" for number in range(98, 106)]
    starts = [datetime.fromisoformat(pointing.time) for pointing in found.values()]
    assert [(b - a).total_seconds() for a, b in itertools.pairwise(starts[:4])] == [150.0] * 3
    assert starts[4] == datetime.fromisoformat(times[1]) and {p.exptime for p in found.values()} == {90.0}
    for k, pointing in enumerate(list(found.values())[:4]):
        chip, (dx, dy) = chips[k // 2], shifts[k % 2]
        craft = observer(pointing.mjd, pointing.sat_position, pointing.sat_velocity)
        x, y = ChipWCS(chip, pointing).world_to_pixel(*apparent(60.0, -40.0, craft))
        middle = (chip.detector.nx - 1) / 2, (chip.detector.ny - 1) / 2
        off = float(x) - middle[0], float(y) - middle[1]
        assert off == pytest.approx((dx / 0.074, dy / 0.074), abs=40.0)  # but for the field distortion
    assert next_start(found["000000098"]) == "2027-11-20T01:22:30"


def test_a_table_of_aimed_exposures_is_read_back(camera):
    found = aimed_exposures(camera, 359.9999, 89.0, [camera.chips[9]], pa=-20.5, exptime=33.25)
    text = survey_table_text(found, ["of mine", "twice"])
    assert text.splitlines()[:3] == ["# of mine", "# twice", "obsid,type,ra,dec,pa,time,exptime"] and text[-1] == "\n"
    [(obsid, read)] = exposures_of(text, camera.orbit).items()
    [made] = found.values()
    assert (obsid, read.type, read.exptime, read.time) == ("10100000001", "SCIE", 33.25, made.time)
    assert (read.ra, read.dec, read.pa) == pytest.approx((made.ra, made.dec, made.pa), abs=5.1e-5)
    [row] = survey_table_text({"1" * 9: SimpleNamespace(**(vars(made) | {"ra": 359.9999999}))}).splitlines()[1:]
    assert row.split(",")[2] == "0.000000"


def test_chips_are_those_numbered_and_the_innermost_of_each_filter(camera):
    assert [chip.id for chip in chips_for(camera)] == [9]
    assert [chip.id for chip in chips_for(camera, (29, 8))] == [29, 8]
    near = {
        name: min((math.hypot(c.xc, c.yc), c.id) for c in camera.chips.values() if c.filter == name)[1]
        for name in ("y", "GI")
    }
    assert [chip.id for chip in chips_for(camera, (), ("y", "GI"))] == [near["y"], near["GI"]]
    assert [chip.id for chip in chips_for(camera, (8,), ("GI",))] == [8, near["GI"]]
    for given, words in ((((99,),), "chip: no such chip"), (((), ("H",)), "filter: no such filter")):
        for prefix in ("--", ""):
            with pytest.raises(InputError, match=f"^{prefix}{words}"):
                chips_for(camera, *given, prefix=prefix)


def test_a_filter_in_front_of_no_chip_is_refused(camera):
    without = SimpleNamespace(
        filters=camera.filters, chips={k: chip for k, chip in camera.chips.items() if chip.filter != "g"}
    )
    with pytest.raises(InputError, match=r"no such filter \(got 'g'\); allowed: NUV, u, r, i"):
        chips_for(without, filters=("g",))


@pytest.mark.parametrize(("options", "words"), [
    ({"obsid": "12345678"}, "not an observation id"), ({"shifts": ((0.0, 3600.5),)}, "out of range"),
    ({"shifts": ((math.nan, 0.0),)}, "out of range"), ({"shifts": ((-3601.0, 0.0),)}, "out of range"),
    ({"times": ("2027-11-20T01:20:00", "2027-11-20T01:22:29")}, "exposures overlap"),
])  # fmt: skip
def test_exposures_that_cannot_be_are_refused(camera, options, words):
    with pytest.raises(InputError, match=words):
        aimed_exposures(camera, 60.0, -40.0, [camera.chips[9]], **options)


def test_an_exposure_may_begin_when_another_ends(camera):
    times = "2027-11-20T01:22:30", "2027-11-20T01:20:00"
    assert len(aimed_exposures(camera, 60.0, -40.0, [camera.chips[9]], times=times)) == 2


def test_the_default_time_and_chip_are_those_of_the_help(camera):
    [pointing] = aimed_exposures(camera, 60.0, -40.0, chips_for(camera)).values()
    assert (pointing.time, pointing.exptime, pointing.pa % 360, DEFAULT_CHIP) == ("2027-11-20T01:20:00", 150.0, 0.0, 9)
    said = " ".join(CliRunner().invoke(main, ["aim", "--help"]).output.split())
    assert f"[default: {DEFAULT_TIME}]" in said and f"[default: {DEFAULT_CHIP}]" in said


def test_the_sun_and_the_earth_are_one_line_beside_the_table(caplog, tmp_path):
    """SUNANGL0 is 0.874 deg there; the table is made as any other."""
    dither = ["--dither", "0", "0", "--dither", "5", "5"]
    result = CliRunner().invoke(main, ["aim", "236", "-19", "--filter", "r", *dither])
    assert result.exit_code == 0 and len(list(csv.DictReader(result.stdout.splitlines()[1:]))) == 2
    [record] = caplog.records
    assert (record.name, record.levelname) == ("csstsim", "WARNING")
    said = record.getMessage()
    assert "2 of 2; obsid 10100000001: angle to the Sun 0.9 deg (limit: 50), angle from the Earth's limb -1" in said
    assert said.endswith("(limit: 0); none of the next 3 hours is better: try another --time")
    caplog.clear()
    for line in (["236", "-19", "--time", "2027-05-20T01:00:00"], ["60", "-40"]):
        assert CliRunner().invoke(main, ["aim", *line, "--output", str(tmp_path / line[0])]).exit_code == 0
    assert not caplog.records


def test_a_clear_time_is_named(caplog):
    """Nine exposures end towards the Earth; an hour later all are clear, and so says the command with that time."""
    words = ["aim", "60.1172", "-40.033", "--chip", "8", "--chip", "9", "--chip", "7"]
    words += ["--dither", "0", "0", "--dither", "10", "5", "--dither", "-8", "12"]
    assert CliRunner().invoke(main, words).exit_code == 0
    time = caplog.records[0].getMessage().rpartition("try --time ")[2]
    assert time == "2027-11-20T02:25:00"
    caplog.clear()
    assert CliRunner().invoke(main, [*words, "--time", time]).exit_code == 0 and not caplog.records


def test_the_last_hour_of_the_ephemeris_has_no_clear_time_after_it(caplog):
    words = ["aim", "281", "-23", "--time", "2099-12-31T23:50:00"]
    assert CliRunner().invoke(main, words).exit_code == 0
    assert caplog.records[0].getMessage().endswith("try another --time")
