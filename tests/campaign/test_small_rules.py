"""Small rules of a campaign: names of the next exposure, costs, walls, words; each against numbers worked out here."""

import math
from datetime import datetime
from itertools import pairwise
from types import SimpleNamespace

import numpy as np
import pytest

from csstsim.base.errors import InputError
from csstsim.campaign import aiming, costs, plan, selection, sky_ranges, variants
from csstsim.campaign.aiming import after, aimed, chips_for, next_obsid, table_of
from csstsim.campaign.costs import Cost, Numbers
from csstsim.campaign.running import status
from csstsim.campaign.starter import _circle
from csstsim.campaign.survey_table import exposures_of
from csstsim.catalog.astrometry.ephemeris import observer
from csstsim.catalog.astrometry.reduction import apparent
from csstsim.optics.geometry.wcs import ChipWCS


def test_the_next_obsid_has_as_many_digits():
    assert [next_obsid(obsid) for obsid in ("000000099", "10100000001", "099999999")] == [
        "000000100", "10100000002", "100000000",
    ]  # fmt: skip


def test_exposures_follow_each_other_with_a_gap(camera):
    """Two chips and two shifts at two times: four rows each, the next a minute after the end."""
    chips, times = [camera.chips[9], camera.chips[7]], ("2027-11-20T01:20:00", "2027-12-20T01:20:00")
    shifts = ((0.0, 0.0), (30.0, -7.4))
    found = aimed(camera, 60.0, -40.0, chips, pa=20.0, times=times, shifts=shifts, exptime=90.0, obsid="000000098")
    assert list(found) == [f"{number:09d}" for number in range(98, 106)]
    starts = [datetime.fromisoformat(pointing.time) for pointing in found.values()]
    assert [(b - a).total_seconds() for a, b in pairwise(starts[:4])] == [150.0] * 3
    assert starts[4] == datetime.fromisoformat(times[1]) and {p.exptime for p in found.values()} == {90.0}
    for k, pointing in enumerate(list(found.values())[:4]):
        chip, (dx, dy) = chips[k // 2], shifts[k % 2]
        craft = observer(pointing.mjd, pointing.sat_position, pointing.sat_velocity)
        x, y = ChipWCS(chip, pointing).world_to_pixel(*apparent(60.0, -40.0, craft))
        middle = (chip.detector.nx - 1) / 2, (chip.detector.ny - 1) / 2
        off = float(x) - middle[0], float(y) - middle[1]
        assert off == pytest.approx((dx / 0.074, dy / 0.074), abs=40.0)  # but for the field distortion
    assert after(found["000000098"]) == "2027-11-20T01:22:30"


def test_a_table_of_aimed_exposures_is_read_back(camera):
    found = aimed(camera, 359.9999, 89.0, [camera.chips[9]], pa=-20.5, exptime=33.25)
    text = table_of(found, ["of mine", "twice"])
    assert text.splitlines()[:3] == ["# of mine", "# twice", "obsid,type,ra,dec,pa,time,exptime"] and text[-1] == "\n"
    [(obsid, read)] = exposures_of(text, camera.orbit).items()
    [made] = found.values()
    assert (obsid, read.type, read.exptime, read.time) == ("10100000001", "SCIE", 33.25, made.time)
    assert (read.ra, read.dec, read.pa) == pytest.approx((made.ra, made.dec, made.pa), abs=5.1e-5)
    [row] = table_of({"1" * 9: SimpleNamespace(**(vars(made) | {"ra": 359.9999999}))}).splitlines()[1:]
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
    for given, words in ((((99,),), "no such chip"), (((), ("H",)), "no such filter")):
        with pytest.raises(InputError, match=words):
            chips_for(camera, *given)


@pytest.mark.parametrize(("options", "words"), [
    ({"obsid": "12345678"}, "not an observation id"), ({"shifts": ((0.0, 3600.5),)}, "too far"),
    ({"shifts": ((math.nan, 0.0),)}, "too far"), ({"shifts": ((-3601.0, 0.0),)}, "too far"),
    ({"times": ("2027-11-20T01:20:00", "2027-11-20T01:22:29")}, "exposures overlap"),
])  # fmt: skip
def test_exposures_that_cannot_be_are_refused(camera, options, words):
    with pytest.raises(InputError, match=words):
        aimed(camera, 60.0, -40.0, [camera.chips[9]], **options)


def test_an_exposure_may_begin_when_another_ends(camera):
    times = "2027-11-20T01:22:30", "2027-11-20T01:20:00"
    assert len(aimed(camera, 60.0, -40.0, [camera.chips[9]], times=times)) == 2


def test_a_cost_is_a_sum_of_terms():
    numbers = Numbers(cpu_s={"job": 2.0, "mpix": 0.5}, memory_mb={"job": 300.0, "kobject": 10.0})
    assert numbers.cost({"job": 1, "mpix": 8.0, "brick": 5}) == Cost(6.0, 300.0)
    assert numbers.cost({"job": 1, "kobject": 2.5}) == Cost(2.0, 325.0)


def test_an_exposure_starts_once_and_holds_its_largest_chip():
    chips = {("a", 1): Cost(10.0, 500.0), ("b", 1): Cost(4.0, 90.0), ("a", 2): Cost(7.0, 800.0)}
    assert costs._exposures(chips, 3.0) == {"a": Cost(14.0, 800.0), "b": Cost(4.0, 90.0)}


COSTS = {
    "truth": {1: Cost(40.0, 1.0), 2: Cost(5.0, 1.0)}, "psf": {9: Cost(30.0, 1.0)},
    "select": {("a", 9): Cost(2.0, 1.0), ("b", 9): Cost(3.0, 1.0)}, "measure": {("a", 9): Cost(7.0, 1.0)},
    "extract": {("a", 1): Cost(11.0, 1.0)}, "chip": {("a", 9): Cost(1000.0, 1.0)}, "report": {None: Cost(1.5, 1.0)},
}  # fmt: skip


def test_the_wall_is_the_longest_chain_and_the_rest_shared_out():
    """Chain: truth 40 (beside psf), select 3, extract 11 (beside measure), report 1.5; in all 99.5 CPU s."""
    assert plan._chain(COSTS) == 55.5
    assert plan.wall(COSTS, 1) == pytest.approx(3 + 99.5) and plan.wall(COSTS, 4) == pytest.approx(3 + 55.5 + 11)


@pytest.mark.parametrize(("seconds", "words"), [
    (59.4, "59 s"), (60, "1.0 min"), (3599, "60.0 min"), (3600, "1.0 h"), (359_000, "99.7 h"), (3.6e6, "1,000 h"),
])  # fmt: skip
def test_spans_in_words(seconds, words):
    assert plan.duration(seconds) == words


def test_distances_in_words():
    assert selection._far(119.94) == "119.9'" and selection._far(120.0) == "about 2 deg"
    assert selection._far(60 * math.degrees(math.tan(math.radians(80)))) == "about 80 deg"


def test_sums_and_shares_of_the_sky():
    def sky(**parts):
        return dict.fromkeys(sky_ranges.COMPONENTS, 0.0) | parts

    levels = {
        "g": {"1": sky(zodiacal=0.5, earth=0.05), "2": sky(zodiacal=0.2, earth=0.021), "3": sky(zodiacal=0.3)},
        "r": {"1": sky(zodiacal=0.1, moon=2e-6), "2": sky(zodiacal=0.2), "3": sky(zodiacal=0.4)},
    }
    assert sky_ranges.totals(levels["g"]) == pytest.approx({"1": 0.55, "2": 0.221, "3": 0.3})
    assert set(sky_ranges.faint(levels)) == set(sky_ranges.COMPONENTS) - {"zodiacal", "earth", "moon"}
    assert sky_ranges._extremes(levels) == [
        "Least sky: obsid 2; most: obsid 1 (g).", "Least sky: obsid 1; most: obsid 3 (r).",
    ]  # fmt: skip
    shares = sky_ranges._arrays(levels["g"])
    assert sky_ranges.much_earthshine(shares) == pytest.approx(1 / 3)  # exactly a tenth is not more


def test_keys_of_a_variant_replace_those_of_the_base_one_by_one():
    data = {
        "name": "a", "psf": {"grid": 2, "beta": 3}, "window": {"x0": 1}, "seed": 4,
        "variants": {"v": {"psf": {"grid": 5}, "window": "region", "seed": 0}, "w": None},
    }  # fmt: skip
    assert variants.changed(data, "v", "a.yaml") == {
        "name": "a", "psf": {"grid": 5, "beta": 3}, "window": "region", "seed": 0,
    }  # fmt: skip
    assert variants.changed(data, "w", "a.yaml") == {k: v for k, v in data.items() if k != "variants"}
    assert data["psf"] == {"grid": 2, "beta": 3}
    with pytest.raises(InputError, match=r"no such variant \(got 'x'\); allowed: v, w"):
        variants.changed(data, "x", "a.yaml")
    for key in variants.OF_BASE:
        with pytest.raises(InputError, match=rf"variants\.v\.{key}: cannot differ"):
            variants.changed({"variants": {"v": {key: 1}}}, "v", "a.yaml")


def test_the_circle_about_objects_reaches_the_outermost():
    """At the meridian 0 and dec 60: 0.04 deg of ra are 0.02 deg."""
    table = {"ra": np.array([359.98, 0.02, 0.0]), "dec": np.array([60.0, 60.0, 60.0])}
    ra, dec, radius = _circle("a.csv", table)
    assert (min(ra, 360 - ra), dec) == pytest.approx((0, 60.0), abs=1e-5)
    assert radius == pytest.approx(60 * 0.02 * math.cos(math.radians(60)) + 0.2, abs=1e-3)
    for distance, good in ((4.79, True), (4.81, False)):
        wide = {"ra": np.array([10.0, 10.0]), "dec": np.array([0.0, 2 * distance / 60])}
        if good:
            assert _circle("a.csv", wide)[1:] == pytest.approx((distance / 60, distance + 0.2), abs=1e-5)
            continue
        with pytest.raises(InputError, match=r"got '4\.8 arcmin from their middle'\); allowed: 4\.8 arcmin"):
            _circle("a.csv", wide)


def test_a_status_in_words():
    """Of 4 frames at 10 CPU s 3 are made, of 2 tables at 100 s one: 110 s to go, at 2 CPU s a second."""
    frames = status.Kind("frames", dict.fromkeys("abcd", 10.0), {"a": 0.0, "b": 1.0, "c": 2.0})
    tables = status.Kind("tables", dict.fromkeys("ef", 100.0), {"e": 9.0})
    pace = status.Pace(60.0, 120.0, {"frames": 2, "tables": 1}, 1_000_000.0)
    found = status.Status([frames, tables], pace, 2_345_000_000, [("log", "no disk")], {("7", 9): "its amplifier"})
    assert not found.done and found.missing_cpu == 110.0 and found.left == 55.0
    assert status.lines(found, "out", 1_000_900.0) == [
        "frames: 3 of 4, 120 an hour", "tables: 1 of 2, 60 an hour", "out: 2.35 GB",
        "1.8 min of CPU time to go, estimated; at the pace of the last 1.0 min of work 55 s left",
        "declared missing: 7 chip 9: its amplifier", "failed: log: no disk",
    ]  # fmt: skip
    assert "nothing was made for 15.0 min: since 1970-01-12 13:46 UTC" in status.lines(found, "out", 1_000_901.0)
    slow = status.Status([frames, tables], None, 0, [])
    assert slow.left is None and status.summary(slow, "out", 0.0)[1].startswith(
        "1.8 min of CPU time to go, estimated; "
    )
    done = status.Status([status.Kind("frames", {"a": 1.0}, {"a": 5.0})], pace, 0, [("log", "no disk")])
    assert done.done and status.lines(done, "out", 0.0) == ["frames: 1 of 1", "out: 0 GB", "all is made"]


def test_the_default_time_and_chip_are_those_of_the_help(camera):
    [pointing] = aimed(camera, 60.0, -40.0, chips_for(camera)).values()
    assert (pointing.time, pointing.exptime, pointing.pa % 360, aiming.CHIP) == ("2027-11-20T01:20:00", 150.0, 0.0, 9)
