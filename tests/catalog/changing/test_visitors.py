"""Asteroids and satellites of the embedded sky: the same objects on every chip and in every exposure."""

from dataclasses import replace

import healpy
import numpy as np
import pytest

from csstsim.base.units import ab_photon_density
from csstsim.catalog.astrometry.ephemeris import mjd_tt, observer
from csstsim.catalog.changing import visitors as module
from csstsim.catalog.changing.motion import Interval, Motion
from csstsim.catalog.changing.visitors import FIRST_ASTEROID, FIRST_SATELLITE, visitors
from csstsim.catalog.light.embedded_spectra import spectra
from csstsim.catalog.table import ASTEROID, SATELLITE, STAR
from csstsim.instrument.filter import GRID
from csstsim.universe.changing import asteroids, satellites
from csstsim.universe.changing.numbers import numbers_of
from csstsim.universe.parameters import load_universe


@pytest.fixture(scope="module")
def universe():
    return load_universe()


@pytest.fixture(scope="module")
def look(camera, make_pointing, universe):
    """Return a function: (visitors, interval) of an exposure at RA 180, some degrees from the ecliptic."""

    def made(seconds=0.0, kinds=("asteroids",), dec=-14.0):
        start = np.datetime64("2028-03-20T01:00:00") + np.timedelta64(round(seconds), "s")
        pointing = make_pointing(ra=180.0, dec=dec, time=str(start), sat_velocity=(0.0, 0.0, 0.0))
        craft = observer(pointing.mjd, pointing.sat_position, pointing.sat_velocity)
        interval = Interval(pointing.mjd, 150.0)
        return visitors(kinds, 3, universe, camera, pointing, craft, interval), interval

    return made


def test_an_asteroid_is_in_the_next_exposure_where_its_rate_puts_it(look):
    """Ten minutes later, from a telescope that stands: the same ids; speeds change by less than 0.1 arcsec."""
    (one, at), (other, _) = look(), look(600.0)
    ids, first, second = np.intersect1d(one["id"], other["id"], return_indices=True)
    assert len(ids) > 0.95 * len(one) > 20 and (one["obj_type"] == ASTEROID).all()
    assert (one["rate_mjd"] == at.middle).all() and np.unique(one["id"]).size == len(one)
    moved = one.take(first)
    predicted = Motion(moved, at).position(np.full(len(ids), 75.0 + 600.0))
    east = (predicted[0] - other["ra"][second]) * 3600 * np.cos(np.radians(-14.0))
    north = (predicted[1] - other["dec"][second]) * 3600
    assert np.hypot(east, north).max() < 0.1
    speed = np.hypot(one["rate_ra"], one["rate_dec"])
    assert 10 < np.median(speed) < 60
    again, _ = look()
    assert all((again[name] == one[name]).all() for name in ("id", "ra", "dec", "rate_ra", "rate_dec", "mag_r"))


def test_their_light_has_the_magnitude_v(look, universe):
    table, _ = look()
    seds = spectra(universe, table)
    assert (seds[:, GRID == 5500.0] > 0).all()
    colour = table["mag_g"] - table["mag_r"]
    assert ((colour > 0.3) & (colour < 0.8)).all()
    assert table["mag_r"].max() < 24.5 + 0.1 and (np.diff(np.unique(colour.round(3))) > 0.05).any()  # two kinds


def test_satellites_pass_during_the_exposure(look):
    seen = [look(3600.0 * k, ("satellites",)) for k in range(80)]
    count = [len(table) for table, _ in seen]
    assert sum(count) > 5  # 0.22 expected for each exposure
    for table, interval in seen:
        assert (table["obj_type"] == SATELLITE).all() and (table["id"] >= FIRST_SATELLITE).all()
        when = (table["rate_mjd"] - interval.start) * 86400
        assert ((when >= 0) & (when <= 150)).all()
        assert (table["trail_width"] > 0.3).all() and (np.hypot(table["rate_ra"], table["rate_dec"]) > 216000).all()
    none, _ = look(kinds=())
    assert len(none) == 0 and "rate_ra" in none


def test_numbers_of_ones_own_are_read_from_the_universe_folder(look, universe, tmp_path, camera, make_pointing):
    from csstsim.base.errors import InputError

    own = replace(universe, folder=tmp_path)
    (tmp_path / "satellites.yaml").write_text("rate: {source: own, confidence: E, crossed: 0.5}\n")
    pointing = make_pointing()
    craft = observer(pointing.mjd, pointing.sat_position, pointing.sat_velocity)
    with pytest.raises(InputError, match=r"satellites\.yaml"):
        visitors(("satellites",), 1, own, camera, pointing, craft, Interval(pointing.mjd, 150.0))


def test_rows_have_the_light_of_v_and_the_place_of_their_pixel(universe, camera):
    """V is an AB magnitude of mean photons within 5100-5900 A, to the knots of the spectra; the cool kind is redder."""
    columns = {
        "id": np.array([3, 4, 5]), "V": np.array([18.0, 21.5, 6.0]),
        "obj_type": np.array([ASTEROID, ASTEROID, SATELLITE]),
        "ra": np.array([10.0, 200.0, 359.9]), "dec": np.array([-30.0, 60.0, 1.0]),
        "rate_ra": np.array([30.0, -20.0, 5e5]),
        "rate_mjd": np.full(3, 61000.5), "teff": np.array([5770.0, 5250.0, 5770.0]),
    }  # fmt: skip
    table = module._table(columns, universe, camera)
    inside = (GRID >= 5100) & (GRID <= 5900)
    light = spectra(universe, table)[:, inside].mean(axis=1) / ab_photon_density(GRID[inside]).mean()
    assert -2.5 * np.log10(light) == pytest.approx(columns["V"], abs=3e-3)
    assert table["mag_g"][1] - table["mag_r"][1] > table["mag_g"][0] - table["mag_r"][0] + 0.1
    assert (
        table["_healpix_29"].tolist()
        == healpy.ang2pix(1 << 29, columns["ra"], columns["dec"], nest=True, lonlat=True).tolist()
    )
    for name in ("id", "obj_type", "ra", "dec", "rate_ra", "rate_mjd", "teff"):
        np.testing.assert_array_equal(table[name], columns[name])
    assert not table["rate_dec"].any() and not table["trail_width"].any() and not table["av"].any()
    assert (table["logg"] == np.float32(4.44)).all() and not table["feh"].any() and not table["z"].any()
    stars = table.with_columns(obj_type=np.full(3, STAR, np.int8))
    np.testing.assert_array_equal(spectra(universe, stars), spectra(universe, table))
    assert "V" not in table


def test_the_circle_about_the_boresight_holds_all_chips(camera):
    """By the corners of each chip, turned or not; and not much more."""
    radius = np.degrees(module._radius(camera)) * 3600 / camera.telescope.pixel_scale
    half = [np.hypot(c.detector.nx, c.detector.ny) / 2 for c in camera.chips.values()]
    away = [np.hypot(c.xc, c.yc) for c in camera.chips.values()]
    corners = [
        max(np.hypot(c.xc + s * c.detector.nx / 2, c.yc + t * c.detector.ny / 2) for s in (-1, 1) for t in (-1, 1))
        for c in camera.chips.values()
    ]
    margin = 0.05 * 3600 / camera.telescope.pixel_scale
    assert max(corners) + margin < radius < max(np.add(away, half)) * 1.04 + margin


def test_satellites_fly_along_their_track(universe, camera, make_pointing):
    """Rates by speed and bearing of the drawn tracks; the time, from the start of the exposure."""
    numbers = numbers_of(universe.folder, "satellites") | {"growth": 500.0}
    interval, place, radius = Interval(61000.25, 150.0), (30.0, 50.0), 0.01
    made = module._satellites(4, None, interval, place, radius, camera.telescope, numbers)
    drawn = satellites.crossing(4, 61000.25, 150.0, place, radius, camera.telescope.diameter_m, numbers)
    assert len(drawn["id"]) > 10 and made["id"].tolist() == (drawn["id"] + (1 << 52)).tolist()
    assert np.hypot(made["rate_ra"], made["rate_dec"]) / 3600 == pytest.approx(drawn["speed"])
    assert np.degrees(np.arctan2(made["rate_ra"], made["rate_dec"])) % 360 == pytest.approx(drawn["angle"])
    assert (made["rate_mjd"] - 61000.25) * 86400 == pytest.approx(drawn["time"], abs=1e-3)
    for ours, theirs in (("trail_width", "width"), ("V", "V"), ("ra", "ra"), ("dec", "dec")):
        np.testing.assert_array_equal(made[ours], drawn[theirs])
    assert (made["obj_type"] == SATELLITE).all()


def test_asteroids_are_where_they_are_seen_in_the_middle_of_the_exposure(universe, camera, make_pointing):
    """From an observer of that moment, whose light time and place are its own: 0.02 arcsec. Kinds by zone."""
    numbers = numbers_of(universe.folder, "asteroids") | {"faintest": 20.5}
    numbers["colours"] = numbers["colours"] | {"s_share": [1.0, 1.0, 0.0, 0.5, 1.0]}
    pointing = make_pointing(ra=180.0, dec=0.0, time="2028-03-20T01:00:00", sat_velocity=(0.0, 0.0, 0.0))
    interval, boresight = Interval(pointing.mjd, 600.0), (180.0, 0.0)
    first, middle = (observer(at, pointing.sat_position, (0.0, 0.0, 0.0)) for at in (interval.start, interval.middle))
    made = module._asteroids(3, first, interval, boresight, 0.03, camera.telescope, numbers)
    towards = np.array([-1.0, 0.0, 0.0])
    sun = middle.astrom["eh"] * middle.astrom["em"]
    found = asteroids.asteroids_near(3, mjd_tt(interval.middle), sun, towards, 0.03, numbers)
    both, mine, theirs = np.intersect1d(made["id"], found["id"] + FIRST_ASTEROID, return_indices=True)
    assert len(both) > 20 and len(both) >= len(made["id"]) - 1
    ra = np.degrees(np.arctan2(found["vector"][theirs, 1], found["vector"][theirs, 0])) % 360
    dec = np.degrees(np.arcsin(found["vector"][theirs, 2]))
    assert np.abs([made["ra"][mine] - ra, made["dec"][mine] - dec]).max() * 3600 < 0.02
    assert (made["rate_mjd"] == interval.middle).all()
    assert made["V"][mine] == pytest.approx(found["V"][theirs], abs=1e-4)
    cool, zone = made["teff"][mine] == 5250.0, found["zone"][theirs]
    assert (made["teff"] != 5250.0).any() and set(made["teff"]) == {5250.0, 5770.0}
    assert cool[zone == 1].all() and not cool[zone == 2].any() and 0 < cool[zone == 3].mean() < 1
