"""What `check` and `plan` note: what `select` lists in vain, and exposures near the Sun or towards the Earth."""

import math

import numpy as np
import pytest
from astropy import units as u
from astropy.coordinates import SkyCoord, get_body
from astropy.time import Time
from click.testing import CliRunner
from make_tables import SUN_MIN
from support.mini_campaign import HEADER, write_campaign
from year_of_visits import LIMITS

from csstsim.base.units import EARTH_RADIUS_KM
from csstsim.campaign import notes
from csstsim.campaign.opened import OpenCampaign
from csstsim.campaign.survey_table import exposures_of
from csstsim.catalog.astrometry.reduction import icrs
from csstsim.command_line.main import main
from csstsim.instrument.camera import load_camera

SECOND = "10100000002"
TIME = "2027-11-20T01:20:00"
NEAR_SUN = f"20100000001,SCIE,236.0,-19.0,0,{TIME},150"  # 0.9 deg from the Sun, behind the Earth
AT_EARTH = f"20100000002,SCIE,180.0,60.0,0,{TIME},150"  # 91 deg from the Sun
CLEAR = f"20100000003,SCIE,60.0,-40.0,0,{TIME},150"


def pointings(camera, *rows):
    return exposures_of("\n".join([HEADER, *rows]) + "\n", camera.orbit)


def test_the_angles_are_those_of_astropy_and_of_the_orbit(camera):
    """The nearer end counts, here of an exposure of 20 minutes; the text has one decimal."""
    row = NEAR_SUN.replace(",150", ",1200")
    [pointing] = pointings(camera, row).values()
    time = Time(TIME) + [0, 1200] * u.s
    sun = get_body("sun", time)
    sun = SkyCoord(sun.ra, sun.dec)  # directions alone
    to_sun = sun.separation(SkyCoord(236.0, -19.0, unit="deg")).deg.min()
    ends = [np.array(camera.orbit.state(at.isot).position) for at in time]
    boresight = SkyCoord(236.0, -19.0, unit="deg").cartesian.xyz.value
    limb = min(
        np.degrees(np.arccos(-boresight @ end / np.linalg.norm(end)) - math.asin(EARTH_RADIUS_KM / np.linalg.norm(end)))
        for end in ends
    )
    said = notes.pointing_fault(pointing, camera.telescope)
    sun_said, limb_said = (float(part.split(" deg")[0].split()[-1]) for part in said.split(", "))
    assert (sun_said, limb_said) == pytest.approx((to_sun, limb), abs=0.06)
    assert said.endswith("(limit: 0)") and "(limit: 50)" in said


def test_either_end_of_an_exposure_may_violate_a_limit(camera, monkeypatch):
    [pointing] = pointings(camera, CLEAR).values()
    good = {"sun_angle_start": 50.0, "sun_angle_end": 50.0, "limb_angle_start": 0.0, "limb_angle_end": 0.0}
    for name in (None, *good):
        angles = good | ({name: good[name] - 0.04} if name else {})
        monkeypatch.setattr(notes, "angles_at_ends", lambda _, angles=angles: angles)
        said = notes.pointing_fault(pointing, camera.telescope)
        assert said == {
            None: "", "s": "angle to the Sun 50.0 deg (limit: 50)",
            "l": "angle from the Earth's limb -0.0 deg (limit: 0)",
        }[name and name[0]]  # fmt: skip


def test_exposures_are_counted_and_the_first_is_named(camera):
    said = notes.pointing_note(pointings(camera, CLEAR, AT_EARTH, NEAR_SUN), camera.telescope)
    assert said.startswith("exposures too near the Sun or towards the Earth: 2 of 3; obsid 20100000002: angle from the")
    assert "Sun" not in said.partition("obsid")[2]
    assert not notes.pointing_note(pointings(camera, CLEAR), camera.telescope)


def test_the_limit_is_the_cameras_and_that_of_the_shipped_tables(camera):
    assert camera.telescope.sun_angle_min == SUN_MIN == LIMITS["sun"]
    exposures = pointings(camera, NEAR_SUN)
    other = load_camera({"telescope.sun_angle_min": 0.5}).telescope
    assert "Earth" in notes.pointing_fault(exposures["20100000001"], other)
    assert "Sun" not in notes.pointing_fault(exposures["20100000001"], other)


def region(chip, tmp_path, **changes):
    """Return the campaign of a region on the middle of a chip in the first of three exposures, and on no other chip."""
    rows = [
        "10100000001,SCIE,60.15,-40.0,-113.4333,2027-11-20T01:08:00,150",
        "10100000002,SCIE,70.0,-40.0,20.0,2027-11-20T01:12:00,150",
        "10300000001,BIAS,0,0,0,2027-11-20T02:00:00,0",
    ]
    run = OpenCampaign(write_campaign(tmp_path, rows, select={"types": ["SCIE"], "chips": [chip]}))
    job = run.job("10100000001", chip)
    ra, dec = (float(v) for v in icrs(*job.wcs.pixel_to_world(63.5, 63.5), job.observer))
    changes = {"region": {"ra": ra, "dec": dec, "radius": 0.01}} | changes
    return write_campaign(tmp_path, rows, select=changes)


@pytest.mark.parametrize(("select", "lines"), [
    ({"types": ["SCIE"], "chips": [9]}, []),
    ({"types": ["SCIE"], "chips": [29, 9]}, ["chip 29: no selected exposure has the region on it"]),
    ({"chips": [29, 9, 30]}, ["chips 29, 30: no selected exposure has the region on it"]),  # bias frames of all
    ({"types": ["BIAS"], "chips": [29, 9]}, []),
    ({"types": ["SCIE"], "chips": "all"}, []),
    ({"types": ["SCIE"], "chips": [29, 9], "filters": ["r"]}, ["chip 29: not behind one of select.filters"]),
    ({"types": ["SCIE"], "chips": [29, 9], "missing": {f"1010000000{n}_29": "dead" for n in (1, 2)}}, []),
    ({"types": ["SCIE"], "chips": [9], "obsids": ["10100000001", SECOND]},
     ["exposure 10100000002: the region is on none of the selected chips"]),
    ({"types": ["SCIE"], "chips": [9], "obsids": ["10100000001", "10300000001"]},
     ["exposure 10300000001: not of one of select.types"]),
    ({"types": ["SCIE"], "chips": [9], "obsids": ["10100000001", SECOND],
      "missing": {f"{SECOND}_09": "no data"}}, []),
])  # fmt: skip
def test_what_is_listed_and_selects_nothing_is_said(tmp_path, select, lines):
    assert notes.selection_notes(OpenCampaign(region(9, tmp_path, **select))) == lines


def test_many_names_are_counted():
    assert notes._line("chip", range(1, 6), "off") == ["chips 1, 2, 3, 4, 5: off"]
    assert notes._line("chip", range(1, 9), "off") == ["chips 1, 2, 3, 4, 5 and 3 more: off"]
    assert notes._line("chip", [], "off") == []


def test_exposures_without_jobs_are_not_counted(tmp_path):
    """Of the three, the region is on one; the Sun is near in none that are made."""
    file = region(9, tmp_path, types=["SCIE"], chips=[9])
    table = file.parent / "table.csv"
    table.write_text(table.read_text() + NEAR_SUN + "\n")
    assert notes.notes(OpenCampaign(file)) == []


def test_check_says_them_and_ends_well(tmp_path):
    rows = [CLEAR, NEAR_SUN]
    file = write_campaign(tmp_path, rows, select={"types": ["SCIE"], "chips": [9]})
    done = CliRunner().invoke(main, ["check", str(file)])
    good, line = done.output.splitlines()
    assert done.exit_code == 0 and good == f"{file}: good; 2 chips of 2 exposures"
    said = f"{file}: note: exposures too near the Sun or towards the Earth: 1 of 2; obsid 20100000001: "
    assert line.startswith(said)
