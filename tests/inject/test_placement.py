"""Places for objects: grids, free pixels, blends, second epochs; the command."""

import numpy as np
import pytest
from astropy import units as u
from astropy.coordinates import SkyCoord
from astropy.table import Table
from astropy.time import Time
from click.testing import CliRunner
from inject.test_foreign import write_image

from csstsim.base.errors import InputError
from csstsim.catalog.object_table import read_table
from csstsim.command_line.main import main
from csstsim.inject.others.frame import read_foreign
from csstsim.inject.placement import beside, free_pixels, grid, later, random

ARCSEC = 1 / 3600


def test_a_grid_is_square_and_in_the_middle():
    x, y = grid((100, 60), 20, edge=10)
    assert len(x) == 4 * 2
    assert set(np.diff(np.unique(x))) == set(np.diff(np.unique(y))) == {20.0}
    assert x.min() + x.max() == 59 and y.min() + y.max() == 99 and x.min() >= 10
    assert [len(v) for v in grid((21, 21), 500)] == [1, 1]
    for shape, spacing in (((100, 100), 0.5), ((100, 100), np.nan), ((15, 100), 10)):
        with pytest.raises(InputError):
            grid(shape, spacing)


def test_free_pixels_are_away_from_bright_bad_and_unknown_ones():
    image, bad = np.random.default_rng(1).normal(size=(100, 120)), np.zeros((100, 120), bool)
    image = np.clip(image, -4, 4)
    image[50, 60], image[30, 30], bad[70, 90] = 100.0, np.nan, True
    free = free_pixels(image, bad, reach=3, edge=10)
    for y, x in ((50, 60), (30, 30), (70, 90)):
        assert not free[y - 3 : y + 4, x - 3 : x + 4].any() and free[y, x + 4] and free[y - 4, x]
    assert free.sum() == 80 * 100 - 3 * 49 and not free[9].any() and not free[:, 110].any()
    assert not free_pixels(np.full((50, 50), np.nan)).any()


def test_random_places_are_free_apart_and_repeatable():
    free = np.zeros((200, 200), bool)
    free[50:150, 20:120] = True
    x, y = random(free, 60, 3, apart=8)
    assert free[np.rint(y).astype(int), np.rint(x).astype(int)].all()
    apart = np.hypot(x[:, None] - x, y[:, None] - y)[np.triu_indices(60, 1)]
    assert apart.min() >= 8 and np.array_equal(random(free, 60, 3, apart=8), (x, y))
    assert not np.array_equal(random(free, 60, 4, apart=8), (x, y)) and random(free, 0, 1).shape == (2, 0)
    many = random(free, 20_000, 1)
    assert many.mean(axis=1) == pytest.approx((69.5, 99.5), abs=5 * 100 / np.sqrt(12 * 20_000))
    for count, apart in ((60, 50.0), (1, 0.0)):
        with pytest.raises(InputError, match="room for"):
            random(free if count > 1 else ~np.ones((9, 9), bool), count, 1, apart)


@pytest.mark.parametrize("dec", [0.0, 60.0, 89.9999, -90.0])
def test_blends_stand_at_their_distances(dec):
    ra, dec = np.array([0.0, 359.99999]), np.full(2, dec)
    lon, lat = beside(ra, dec, 40, 0.5, 2.0, seed=1)
    apart = SkyCoord(lon, lat, unit="deg").separation(SkyCoord(np.tile(ra, 20), np.tile(dec, 20), unit="deg")).arcsec
    assert apart.min() > 0.5 - 1e-6 and apart.max() < 2.0 + 1e-6 and 1.0 < apart.mean() < 1.5
    for given in ((ra, dec, 3, 2.0, 1.0, 1), (ra[:0], dec[:0], 3, 0.5, 1.0, 1)):
        with pytest.raises(InputError):
            beside(*given)


def test_a_second_epoch_is_astropys():
    table = {
        "ra": np.array([10.0, 359.9999]),
        "dec": np.array([80.0, -5.0]),
        "pmra": np.array([900.0, np.nan]),
        "pmdec": np.array([-400.0, 0.0]),
    }
    moved = later(table, 10.0)
    motion = {"pm_ra_cosdec": 900 * u.mas / u.yr, "pm_dec": -400 * u.mas / u.yr}
    there = SkyCoord(
        10 * u.deg, 80 * u.deg, distance=100 * u.pc, radial_velocity=0 * u.km / u.s, obstime=Time("J2000"), **motion
    )
    wanted = there.apply_space_motion(dt=10 * u.yr)
    assert SkyCoord(moved["ra"][0], moved["dec"][0], unit="deg").separation(wanted).mas < 0.1
    assert moved["ra"][1] == pytest.approx(359.9999) and table["ra"][0] == 10.0


def test_the_command(tmp_path):
    frame, kinds = write_image(tmp_path), tmp_path / "kinds.csv"
    Table({"mag": [20.0, 21.0, 22.0], "type": ["star", "galaxy", "galaxy"], "size": [0.0, 0.3, 0.3]}).write(kinds)

    def run(name, *more, code=0):
        call = ["place", frame, kinds, "--output", tmp_path / name, *more]
        result = CliRunner().invoke(main, [str(a) for a in call], catch_exceptions=False)
        assert result.exit_code == code, result.output
        return result.output

    assert "3 objects" in run("grid.csv", "--grid", 60)
    made = read_table(tmp_path / "grid.csv")
    x, _ = read_foreign(frame).wcs.pixels(made["ra"], made["dec"])
    assert np.diff(x) == pytest.approx([60, 60], abs=1e-4) and list(made["mag"]) == [20.0, 21.0, 22.0]
    run("near.fits", "--beside", tmp_path / "grid.csv", "--distance", 1, 1)
    near = read_table(tmp_path / "near.fits")
    apart = SkyCoord(near["ra"], near["dec"], unit="deg").separation(SkyCoord(made["ra"], made["dec"], unit="deg"))
    assert apart.arcsec == pytest.approx([1, 1, 1], abs=1e-6)
    assert "too small for 3 objects" in run("no.csv", "--grid", 190, code=2) and not (tmp_path / "no.csv").exists()
    assert "cannot be the table" in run("grid.csv", code=2)
    assert "--distance goes with --beside" in run("no.csv", "--distance", 1, 2, code=2)
    for row, key in (("x,2.2", "ra, row 1"), ("nan,2.2", "ra, row 1"), ("500,2", "ra, row 1"), ("5,200", "dec, row 1")):
        (tmp_path / "off.csv").write_text(f"ra,dec\n{row}\n")
        assert key in run("no.csv", "--beside", tmp_path / "off.csv", "--distance", 1, 1, code=2)
