"""Selection of objects whose light reaches a window through gratings: none is missed, few are superfluous."""

import numpy as np
import pytest
from support.dispersed_sky import Flat, Sky
from support.grating_scene import gaussian_psf

from csstsim.base.errors import InputError
from csstsim.base.units import ab_photon_density
from csstsim.catalog.flags import BAD_VALUE
from csstsim.catalog.light.object_spectra import ROW, catalog_spectra
from csstsim.catalog.light.photometry import bin_means
from csstsim.instrument.chip import Window
from csstsim.instrument.filter import GRID
from csstsim.optics.scatter.scattered_light import Scattered, scattered_light


@pytest.fixture(scope="module")
def psf(tmp_path_factory):
    return gaussian_psf(tmp_path_factory.mktemp("psf") / "g.h5")


@pytest.fixture
def sky(camera, make_pointing, observe, psf):
    return lambda objects: Sky(camera, make_pointing(), observe(make_pointing()), psf, objects)


@pytest.mark.parametrize(
    "window", [Window(5400, 5700, 3000, 3200), Window(0, 200, 0, 9232), Window(9000, 9216, 100, 9000)]
)
def test_who_is_left_out_would_have_put_nothing_there(sky, window):
    """200 stars of magnitude 16 to 22 about the window, the split, the frame: what is left out, drawn, is dark."""
    rng = np.random.default_rng(window.x0)
    x = rng.uniform(window.x0 - 2300, window.x1 + 2300, 200)
    y = rng.uniform(max(window.y0 - 200, -700), min(window.y1 + 200, 9900), 200)
    objects = [
        (a, b, {"id": k, "ab": m}) for k, (a, b, m) in enumerate(zip(x, y, rng.uniform(16, 22, 200), strict=True))
    ]
    there = sky(objects)
    chosen, whole = there.select(window), there.select()
    kept = np.isin(whole["id"], chosen["id"])
    assert len(chosen) == kept.sum() > 8
    image, *_ = there.draw(whole.take(~kept), window)
    assert image.sum(dtype=float) < 1e-3
    _, drawn, *_ = there.draw(chosen, window)
    lands = drawn["drawn"] > 1e-3
    assert lands.mean() > 0.75  # an order's box is a rectangle, stamps are squares
    assert whole.meta["dropped"]["outside"] + len(whole) == 200


def test_magnitudes_are_those_of_the_first_order(sky, camera):
    table = sky([(4000.0, 5000.0, {"id": 1, "ab": 18.0})]).select()
    assert table["mag"][0] == pytest.approx(18.0, abs=1e-4)
    assert table["x"][0] == pytest.approx(4000.0, abs=1e-5)


def test_a_star_far_off_the_chip_comes_on_the_open_side_only(sky):
    """x = -1500 by its second order; 9216 + 1500 lies beyond the frame; -1700 too."""
    chip = Window(0, 9216, 0, 9232)
    places = (-1500.0, 9216 + 1500.0, -1700.0, 9216 + 600.0)
    table = sky([(x, 4000.0, {"id": k, "ab": 15.0}) for k, x in enumerate(places)]).select(chip)
    assert table["id"].tolist() == [0, 3]


def test_wings_bring_stars_from_further(sky, camera):
    scattered = Scattered(scattered_light(camera, camera.filters["GV"]).wing)
    window = Window(6000, 6400, 3000, 3400)
    objects = [(5900.0, 4000.0, {"id": 1, "ab": 10.0}), (5900.0, 4000.0, {"id": 2, "ab": 20.0})]
    there = sky(objects)
    assert len(there.select(window)) == 0
    assert there.select(window, scattered=scattered)["id"].tolist() == [1]


def test_spectra_of_a_users_catalogue_are_its_own(sky):
    """Means over bins of what load_sed gives, lensing magnification included, whatever rows and their order."""
    objects = [(4000.0 + 10 * k, 5000.0, {"id": k, "ab": 18.0 + k}) for k in range(4)]
    objects[2][2].update(type="galaxy", size_disk=0.3, bulge_frac=0.0, kappa=0.1, gamma1=0.05)
    there = sky(objects)
    table = there.select(Window(0, 9216, 0, 9232))
    edges = there.disperser.edges
    light = catalog_spectra(table, there.catalog)(np.array([3, 2, 0]), edges)
    at = np.searchsorted(GRID, edges)
    for row, k in zip(light, (3, 2, 0), strict=True):
        mu = 1 / (0.9**2 - 0.05**2) if k == 2 else 1.0
        wanted = mu * bin_means(ab_photon_density(GRID, 18.0 + k)[None, at[0] : at[-1] + 1], at - at[0])[0]
        assert np.abs(row / wanted - 1).max() < 1e-6
    assert table[ROW].tolist() == [0, 1, 2, 3]
    electrons = light[1] @ there.disperser.rates[0, 3]
    assert electrons == pytest.approx(sum(table[f"flux{i}"][2] for i in range(4)), rel=1e-3)


def test_a_catalogue_that_changes_is_refused(sky):
    there = sky([(4000.0, 5000.0, {"id": 1, "ab": 18.0})])
    table = there.select()
    other = sky([(4001.0, 5000.0, {"id": 1, "ab": 18.0})])
    with pytest.raises(InputError, match=r"Flat: gives other objects each time it is opened"):
        catalog_spectra(table, other.catalog)


def test_a_mistake_in_the_users_code_is_one_line(sky, monkeypatch):
    there = sky([(4000.0, 5000.0, {"id": 7, "ab": 18.0})])
    load = catalog_spectra(there.select(), there.catalog)
    monkeypatch.setattr(Flat, "load_sed", lambda self, obj: 1 / 0)
    with pytest.raises(InputError, match=r"Flat.load_sed, object 7: ZeroDivisionError"):
        load(np.array([0]), there.disperser.edges)


def test_a_spectrum_that_dips_below_zero_leaves_its_object_dark_and_flagged(sky):
    """Its flux is positive, so selection takes it; no photons can be drawn of it."""
    objects = [(4000.0 + 50 * k, 5000.0, {"id": k, "ab": 18.0}) for k in range(3)]
    objects[1][2]["dip"] = -1.0
    there = sky(objects)
    window = Window(3000, 6000, 4900, 5100)
    table = there.select(window)
    assert len(table) == 3 and (table["flags"] & BAD_VALUE == 0).all()
    _, drawn, orders, _ = there.draw(table, window)
    assert (drawn["flags"] & BAD_VALUE > 0).tolist() == [False, True, False]
    assert drawn["method"].tolist() == ["slabs", "none", "slabs"] and drawn["drawn"][1] == 0
    assert 1 not in orders["row"]


def test_behind_a_grating_the_fractions_of_components_are_the_table_s(sky, monkeypatch):
    """There they change from bin to bin, with the spectra of components."""
    shares = {"bulge_frac": np.full(1, 0.9, np.float32), "knots_frac": np.zeros(1, np.float32)}
    monkeypatch.setattr(Flat, "component_shares", lambda self, rows, filter: shares)
    galaxy = {"id": 1, "ab": 18.0, "type": "galaxy", "size_disk": 0.3, "size_bulge": 0.2, "bulge_frac": 0.25}
    assert sky([(4000.0, 5000.0, galaxy)]).select()["bulge_frac"].tolist() == [0.25]
