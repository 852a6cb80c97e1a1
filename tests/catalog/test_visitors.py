"""Asteroids and satellites of the embedded sky: the same objects on every chip and in every exposure."""

from dataclasses import replace

import numpy as np
import pytest

from csstsim.catalog.astrometry.ephemeris import observer
from csstsim.catalog.changing.motion import Interval, Motion
from csstsim.catalog.changing.visitors import FIRST_SATELLITE, visitors
from csstsim.catalog.light.embedded_spectra import spectra
from csstsim.catalog.table import ASTEROID, SATELLITE
from csstsim.instrument.filter import GRID
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
    predicted = Motion(moved, at).place(np.full(len(ids), 75.0 + 600.0))
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
