"""Places for objects: grids, free pixels, blends, second epochs; the command."""

from types import SimpleNamespace

import numpy as np
import pytest
from astropy import units as u
from astropy.coordinates import SkyCoord
from astropy.io import fits
from astropy.table import Table
from astropy.time import Time
from click.testing import CliRunner
from inject.others.test_foreign import write_image
from scipy.spatial import cKDTree

from csstsim.base.errors import InputError
from csstsim.catalog.object_table import read_table
from csstsim.command_line.main import main
from csstsim.inject import placement
from csstsim.inject.others.frame import read_foreign
from csstsim.inject.place import place
from csstsim.inject.placement import (
    Placement,
    _later_members,
    free_pixels,
    grid,
    later,
    near_objects,
    random_positions,
)

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


def test_random_positions_are_free_separated_and_repeatable():
    free = np.zeros((200, 200), bool)
    free[50:150, 20:120] = True
    x, y = random_positions(free, 60, 3, min_separation=8)
    assert free[np.rint(y).astype(int), np.rint(x).astype(int)].all()
    apart = np.hypot(x[:, None] - x, y[:, None] - y)[np.triu_indices(60, 1)]
    assert apart.min() >= 8 and np.array_equal(random_positions(free, 60, 3, min_separation=8), (x, y))
    assert not np.array_equal(random_positions(free, 60, 4, min_separation=8), (x, y)) and random_positions(
        free, 0, 1
    ).shape == (2, 0)
    many = random_positions(free, 20_000, 1)
    assert many.mean(axis=1) == pytest.approx((69.5, 99.5), abs=5 * 100 / np.sqrt(12 * 20_000))
    for area, count, apart, said in ((free, 12, 50.0, "[3-9] objects fit, away"), (free[:9, :9], 1, 0.0, "0 objects")):
        with pytest.raises(InputError, match=f"count: only {said}"):
            random_positions(area, count, 1, apart)


@pytest.mark.parametrize(("count", "apart", "most"), [(200_000, 300.0, 3), (60, 50.0, 28), (18, 101.0, 10)])
def test_what_no_lattice_holds_is_refused_at_once(count, apart, most):
    """No more circles than the densest lattice has in the frame, with a margin of half of one: area / (0.866 d^2)."""
    free = np.ones((200, 200), bool)
    with pytest.raises(InputError, match=rf"min_separation: .* cannot all fit: {most} objects at most"):
        random_positions(free, count, 1, apart)


def test_crowded_positions_in_blocks_keep_their_distance(monkeypatch):
    """Few pairs are made at once; 60% of a random packing that is full (0.547 of the area)."""
    free = np.ones((300, 300), bool)
    monkeypatch.setattr(placement, "_PAIRS", 0.2)  # blocks of 21, 72 at least
    count = int(0.6 * 0.547 * 300**2 / (np.pi * 2.5**2))
    x, y = random_positions(free, count, 5, 5.0)
    assert len(x) == count and cKDTree(np.column_stack([x, y])).query_pairs(5.0) == set()


@pytest.mark.parametrize("dec", [0.0, 60.0, 89.9999, -90.0])
def test_blends_stand_at_their_distances(dec):
    ra, dec = np.array([0.0, 359.99999]), np.full(2, dec)
    lon, lat = near_objects(ra, dec, 40, 0.5, 2.0, seed=1)
    apart = SkyCoord(lon, lat, unit="deg").separation(SkyCoord(np.tile(ra, 20), np.tile(dec, 20), unit="deg")).arcsec
    assert apart.min() > 0.5 - 1e-6 and apart.max() < 2.0 + 1e-6 and 1.0 < apart.mean() < 1.5
    for given in ((ra, dec, 3, 2.0, 1.0, 1), (ra[:0], dec[:0], 3, 0.5, 1.0, 1)):
        with pytest.raises(InputError):
            near_objects(*given)


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
    run("near.fits", "--near", tmp_path / "grid.csv", "--distance", 1, 1)
    near = read_table(tmp_path / "near.fits")
    apart = SkyCoord(near["ra"], near["dec"], unit="deg").separation(SkyCoord(made["ra"], made["dec"], unit="deg"))
    assert apart.arcsec == pytest.approx([1, 1, 1], abs=1e-6)
    assert "too small for 3 objects" in run("no.csv", "--grid", 190, code=2) and not (tmp_path / "no.csv").exists()
    assert "cannot be the table" in run("grid.csv", code=2)
    assert "--distance goes with --near" in run("no.csv", "--distance", 1, 2, code=2)
    for row, key in (("x,2.2", "ra, row 1"), ("nan,2.2", "ra, row 1"), ("500,2", "ra, row 1"), ("5,200", "dec, row 1")):
        (tmp_path / "off.csv").write_text(f"ra,dec\n{row}\n")
        assert key in run("no.csv", "--near", tmp_path / "off.csv", "--distance", 1, 1, code=2)


def test_a_grid_has_its_own_border_and_row_order():
    """80 px inside the default border of 10: three positions of 30 px, 5 px further in; x runs first."""
    x, y = grid((81, 101), 30)
    assert x.tolist() == [20.0, 50.0, 80.0] * 3 and y.tolist() == [10.0] * 3 + [40.0] * 3 + [70.0] * 3


@pytest.mark.parametrize(("value", "taken"), [(4.9, False), (5.1, True), (-50.0, False)])
def test_a_bright_pixel_is_five_robust_sigmas_above_the_median(value, taken):
    """A third each lies at 98, 100 and 102: the scatter is 1.4826 times 2. A dark pixel is no object."""
    image = 98 + 2.0 * (np.add.outer(np.arange(61), np.arange(81)) % 3)
    image[30, 40] = 100 + value * 1.4826 * 2
    free = free_pixels(image)
    wanted = np.zeros(image.shape, bool)
    wanted[10:51, 10:71] = True
    wanted[22:39, 32:49] &= not taken
    assert np.array_equal(free, wanted)


def test_of_positions_too_close_the_earlier_one_stays():
    """The second is too close to the first and goes, so the third, close to the second alone, stays."""
    assert _later_members(np.array([[1, 2], [0, 1], [2, 5], [4, 3]])) == [1, 3, 5]
    assert _later_members(np.zeros((0, 2), int)) == []


def test_objects_are_next_to_given_ones_in_turn_and_in_all_directions():
    """Evenly spread in distance and angle, to five sigma; the seed decides."""
    ra, dec = np.array([10.0, 200.0, 300.0]), np.array([60.0, -30.0, 0.0])
    n = 6000
    lon, lat = near_objects(ra, dec, n, 1.0, 3.0, seed=2)
    to = np.arange(n) % 3
    east, north = ((lon - ra[to]) * np.cos(np.radians(dec[to])) * 3600, (lat - dec[to]) * 3600)
    away = np.hypot(east, north)
    assert away.min() >= 1.0 - 1e-3 and away.max() <= 3.0 + 1e-3
    assert away.mean() == pytest.approx(2.0, abs=5 * 2 / np.sqrt(12 * n))
    for part in (east, north):
        assert (part / away).mean() == pytest.approx(0, abs=5 * np.sqrt(0.5 / n))
        assert ((part / away) ** 2).mean() == pytest.approx(0.5, abs=5 * np.sqrt(0.125 / n))
    assert (east / away * north / away).mean() == pytest.approx(0, abs=5 * np.sqrt(0.125 / n))
    assert not np.array_equal(near_objects(ra, dec, 9, 1.0, 3.0, seed=3)[0], lon[:9])


def test_stars_without_one_motion_move_along_the_other():
    """1000 mas a year for 3.6 years: a thousandth of a degree north; the table given stays."""
    table = {"ra": np.array([10.0]), "dec": np.array([20.0]), "pmdec": np.array([1000.0]), "mag": np.array([3.0])}
    moved = later(table, 3.6)
    assert (moved["ra"][0], moved["dec"][0]) == pytest.approx((10.0, 20.001), abs=1e-9) and moved["mag"][0] == 3.0
    assert table["dec"][0] == 20.0 and "pmra" not in moved


def test_positions_in_a_window_are_those_of_the_chip(monkeypatch):
    """Pixels of the image begin at the window's corner; charge of a raw frame, rates and flags of a calibrated one."""
    from csstsim.inject import place as module

    window = SimpleNamespace(x0=1000, y0=20)
    job = SimpleNamespace(window=window, observer="o", wcs=SimpleNamespace(pixel_to_world=lambda x, y: (x / 8, y / 4)))
    monkeypatch.setattr(module, "icrs", lambda ra, dec, observer: (ra + 1, dec - 1, observer)[:2])
    monkeypatch.setattr(module, "job_of", lambda frame, log, **given: ("run", job))
    monkeypatch.setattr(module, "kind_of", lambda frame: "level0")
    monkeypatch.setattr(module, "charge_in", lambda run, file: (run, file))
    monkeypatch.setattr("csstsim.io.level0.read_level0", lambda frame: frame)
    image, bad, _, to_sky = module.opened("a.fits", print)
    assert image == ("run", "a.fits") and bad is None
    ra, dec = to_sky(np.array([8.0, 16.0]), np.array([4.0, 12.0]))
    assert ra.tolist() == [127.0, 128.0] and dec.tolist() == [5.0, 7.0]


def test_a_calibrated_image_has_flagged_pixels(monkeypatch, tmp_path):
    from csstsim.inject import place as module

    sci, dq = np.arange(6, dtype=np.float32).reshape(2, 3), np.array([[0, 4, 0], [1, 0, 0]], np.uint8)
    fits.HDUList([fits.PrimaryHDU(), fits.ImageHDU(sci, name="SCI"), fits.ImageHDU(dq, name="DQ")]).writeto(
        tmp_path / "a.fits"
    )
    monkeypatch.setattr(module, "job_of", lambda frame, log, **given: (None, None))
    monkeypatch.setattr(module, "kind_of", lambda frame: "calibrated")
    image, bad, near_bad, _ = module.opened(tmp_path / "a.fits", print)
    assert np.array_equal(image, sci) and np.array_equal(bad, dq > 0) and not near_bad


def write_blank(folder, kind):
    """Write an image of 200 px without a value left of column 90, and a DQ of 4 right of it below row 100."""
    path = write_image(folder, error=False)
    blank = np.nan if kind == "float32" else -32768
    pixels = np.random.default_rng(2).normal(100, 5, (200, 200)).astype(kind)
    pixels[:, :90] = blank
    flags = np.zeros((200, 200), np.int16)
    flags[:100, 90:] = 4
    with fits.open(path) as file:
        sci = fits.ImageHDU(pixels, file["SCI"].header, "SCI")
        if kind != "float32":
            sci.header["BLANK"] = blank
        fits.HDUList([fits.PrimaryHDU(), sci, fits.ImageHDU(flags, name="DQ")]).writeto(path, overwrite=True)
    return path


@pytest.mark.parametrize("kind", ["float32", "int16"])
def test_positions_avoid_flagged_pixels_and_those_without_a_value(tmp_path, kind):
    """Random ones by 8 px, or are only not on a flagged one. Points of a grid are on a pixel with a value."""
    frame, kinds = write_blank(tmp_path, kind), tmp_path / "kinds.csv"
    Table({"mag": np.full(25, 20.0)}).write(kinds)
    placements = {"random.csv": Placement(), "grid.csv": Placement(spacing=20.0)}
    x, y = {}, {}
    for name, chosen in placements.items():
        place(frame, kinds, tmp_path / name, print, chosen)
        made = read_table(tmp_path / name)
        x[name], y[name] = read_foreign(frame).wcs.pixels(made["ra"], made["dec"])
    assert x["random.csv"].min() > 97.4 and 99.4 < y["random.csv"].min() < 107.4
    assert x["grid.csv"].min() > 99.4 and y["grid.csv"].min() < 20
    Table({"mag": np.full(60, 20.0)}).write(kinds, overwrite=True)  # 9 x 9 points, of which 9 x 5 have a value
    with pytest.raises(InputError, match="a grid of 45 positions is too small for 60 objects"):
        place(frame, kinds, tmp_path / "no.csv", print, Placement(spacing=20.0))


def test_what_the_command_writes_and_refuses(tmp_path):
    """Ids are counted from 1 where there are none; ra, dec are replaced; random positions are those of the seed."""
    frame, kinds = write_image(tmp_path), tmp_path / "kinds.csv"
    Table({"mag": [20.0, 21.0], "ra": [1.0, 2.0], "dec": [3.0, 4.0]}).write(kinds)
    placement = Placement(seed=3, min_separation=40.0)
    for name in ("a.csv", "b.csv"):
        place(frame, kinds, tmp_path / name, print, placement)
    made, again = (read_table(tmp_path / name) for name in ("a.csv", "b.csv"))
    assert made["id"].tolist() == [1, 2] and np.array_equal(made["ra"], again["ra"])
    foreign = read_foreign(frame)
    x, y = foreign.wcs.pixels(made["ra"], made["dec"])
    wanted = random_positions(free_pixels(foreign.image), 2, 3, 40.0)
    assert np.stack([x, y]) == pytest.approx(wanted, abs=1e-4) and np.hypot(*np.ptp([x, y], axis=1)) > 40
    place(frame, kinds, tmp_path / "c.csv", print, Placement(near=kinds, distance=(0.25, 0.25), seed=9))
    near = read_table(tmp_path / "c.csv")
    wanted = near_objects(np.array([1.0, 2.0]), np.array([3.0, 4.0]), 2, 0.25, 0.25, 9)
    assert np.stack([near["ra"], near["dec"]]) == pytest.approx(np.stack(wanted), abs=1e-9)
    for parent in (7, 0):  # 0 is an id, too
        Table({"mag": [20.0, 21.0], "part_of": [-1, parent]}).write(tmp_path / "parts.csv", overwrite=True)
        with pytest.raises(InputError, match="cannot place parts of objects"):
            place(frame, tmp_path / "parts.csv", tmp_path / "d.csv")
    Table({"mag": [20.0, 21.0], "id": [70, 30]}).write(tmp_path / "ids.csv")
    west = {"ra": [-0.01, 359.99], "dec": [-90.0, 90.0]}  # right ascensions of either form
    Table(west).write(tmp_path / "west.csv")
    place(frame, tmp_path / "ids.csv", tmp_path / "f.csv", print, Placement(near=tmp_path / "west.csv"))
    assert read_table(tmp_path / "f.csv")["id"].tolist() == [70, 30]
    Table({"ra": [1.0]}).write(tmp_path / "no_dec.csv")
    with pytest.raises(InputError, match="lacks a column"):
        place(frame, kinds, tmp_path / "d.csv", placement=Placement(near=tmp_path / "no_dec.csv"))
    with pytest.warns(DeprecationWarning, match="Placement"):
        place(frame, kinds, tmp_path / "e.csv", print, seed=3, apart=40.0)
    assert np.array_equal(read_table(tmp_path / "e.csv")["ra"], made["ra"])
    for name in ("a.csv", "d.txt"):
        with pytest.raises(InputError, match="--output: cannot be the table"):
            place(frame, kinds, tmp_path / name)
