"""Colour gradients: shares of bulge, disk and knots by band and wavelength, against integrals and by their sign."""

import numpy as np
import pytest

from csstsim.base.shipped import SHIPPED
from csstsim.catalog.galaxy_shapes.component_light import BULGE, DISK, KNOTS, ComponentLight
from csstsim.catalog.galaxy_shapes.full_components import load_numbers
from csstsim.catalog.table import GALAXY, QUASAR, STAR, ObjectTable
from csstsim.instrument.filter import GRID
from csstsim.universe.parameters import load_universe

EXACT, SHARE = 1e-12, 1e-3  # of the light
BLUE_TO_RED = "nuv", "u", "g", "r", "i", "z"
Z = [0.0, 0.03, 0.4, 1.1, 3.0, 6.5]


@pytest.fixture(scope="module")
def light():
    return ComponentLight(load_universe(SHIPPED / "universe"))


def galaxies(z, bulge=0.3, knots=0.1, gal_type=0, obj_type=GALAXY):
    z = np.atleast_1d(np.asarray(z, np.float32))
    columns = {"bulge_frac": bulge, "knots_frac": knots, "gal_type": gal_type, "obj_type": obj_type}
    return ObjectTable({"z": z} | {name: np.full(len(z), value) for name, value in columns.items()})


def test_all_components_together_are_the_galaxy(light, camera):
    table = galaxies(Z)
    for band in camera.filters.values():
        shares = light.through(band, table)
        assert shares.sum(axis=1) == pytest.approx(np.ones(len(Z)), abs=EXACT) and (shares >= 0).all()
    shares = light.binned(table, GRID[::200])
    assert shares.shape == (len(Z), len(GRID[::200]) - 1, 3) and (shares >= 0).all()
    assert shares.sum(axis=2) == pytest.approx(np.ones(shares.shape[:2]), abs=EXACT)


@pytest.mark.parametrize("band", ["NUV", "g", "y", "GI"])
def test_the_share_of_a_band_is_an_integral_over_it(light, camera, band):
    """By trapezoids over every sample of the band, and each galaxy's own redshift."""
    seds, throughput = light._universe.galaxy_seds, camera.filters[band].at(GRID)
    for z in (0.017, 0.333, 1.26):
        found = light.through(camera.filters[band], galaxies([z, 2.0]))[0]
        wanted = np.array([
            w * np.trapezoid(throughput * np.interp(GRID / (1 + z), seds.wavelength, row), GRID)
            for w, row in zip((0.3, 0.6, 0.1), light.spectra, strict=True)
        ])  # fmt: skip
        assert found == pytest.approx(wanted / wanted.sum(), abs=SHARE)


def test_bins_are_means_over_wavelength(light):
    """Bins of half an angstrom, summed with the populations' light in each, give those of a hundred angstrom."""
    table, edges = galaxies([0.21]), GRID[5000:9001:200]
    fine = light.binned(table, GRID[5000:9001])[0]
    middles = 0.5 * (GRID[5000:9000] + GRID[5001:9001])
    own = light._universe.galaxy_seds.wavelength
    total = np.array([0.3, 0.6, 0.1]) @ [np.interp(middles / 1.21, own, row) for row in light.spectra]
    wanted = (fine * total[:, None]).reshape(-1, 200, 3).sum(axis=1) / total.reshape(-1, 200).sum(axis=1)[:, None]
    assert light.binned(table, edges)[0] == pytest.approx(wanted, abs=SHARE)


def test_where_the_spectra_are_equal_the_shares_are_those_of_the_table(light):
    equal = load_numbers().equal
    for wavelength, component, bulge, knots in ((equal.bulge, BULGE, 0.3, 0.0), (equal.knots, KNOTS, 0.0, 0.1)):
        edges = np.array([wavelength - 50.0, wavelength + 50.0])
        found = light.binned(galaxies([0.0], bulge, knots), edges)[0, 0, component]
        assert found == pytest.approx(bulge + knots, abs=SHARE)


def test_bulges_are_red_and_knots_are_blue(light, camera):
    shares = np.array([light.through(camera.bands[band], galaxies([0.05]))[0] for band in BLUE_TO_RED])
    assert (np.diff(shares[:, BULGE]) > 0).all() and (np.diff(shares[:, KNOTS]) < 0).all()
    mags = -2.5 * np.log10(shares[:, BULGE] / shares[:, DISK])
    u, g, i = (mags[BLUE_TO_RED.index(band)] for band in "ugi")
    assert u - i > 0.3 and 0.15 < g - i < 0.6  # by how much bulges are redder than disks
    lines = light.binned(galaxies([0.0]), np.array([6400.0, 6500.0, 6550.0, 6576.0, 6650.0, 6750.0]))[0, :, KNOTS]
    assert lines[2] > 1.2 * max(lines[0], lines[4])  # H alpha is from the knots


@pytest.mark.parametrize("columns", [
    {"gal_type": 1}, {"obj_type": STAR, "gal_type": -1}, {"obj_type": QUASAR, "gal_type": -1},
    {"bulge": 1.0, "knots": 0.0}, {"bulge": 0.0, "knots": 0.0}, {"bulge": 0.0, "knots": 1.0},
])  # fmt: skip
def test_others_have_one_spectrum(light, camera, columns):
    table = galaxies(Z, **columns)
    galaxy = columns.get("obj_type", GALAXY) == GALAXY
    bulge, knots = (float(table[name][0]) * galaxy for name in ("bulge_frac", "knots_frac"))
    wanted = np.tile([bulge, 1 - bulge - knots, knots], (len(Z), 1))
    for shares in (light.through(camera.bands["g"], table), light.binned(table, GRID[::900])[:, 3]):
        assert shares == pytest.approx(wanted, abs=1e-7)
    assert not light.has_gradient(table).any()
    assert light.has_gradient(galaxies(Z)).all()


def test_no_objects(light, camera):
    none = galaxies([])
    assert light.through(camera.bands["g"], none).shape == (0, 3)
    assert light.binned(none, GRID[::9000]).shape == (0, 2, 3)
