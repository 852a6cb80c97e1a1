"""Spectra in bins against sums over the paper's grid (embedded_spectra): the same light, line by line."""

import numpy as np
import pytest
from scipy.integrate import cumulative_trapezoid
from support.csst import BANDS
from support.embedded_sky import shipped
from support.grating_scene import GV, disperser_of

from csstsim.catalog.light.binned_spectra import binned
from csstsim.catalog.light.embedded_spectra import spectra
from csstsim.catalog.light.photometry import subband_fluxes
from csstsim.catalog.table import ASTEROID, GALAXY, QUASAR, SATELLITE, STAR, ObjectTable
from csstsim.instrument.filter import GRID
from csstsim.universe.coefficients import COEFFICIENTS

CHIPS = 1, GV, 3


@pytest.fixture(scope="module")
def universe():
    return shipped()[0]


def galaxies(universe, z, seed=2, av=(0.0, 1.0)):
    rng = np.random.default_rng(seed)
    n = len(z)
    mix = universe.galaxy_seds.coefficients(rng.dirichlet(np.full(5, 0.4), n), rng.exponential(0.6, n), np.ones(n))
    columns = {"id": np.arange(n), "obj_type": np.full(n, GALAXY), "z": z, "av": rng.uniform(*av, n),
               "sed_scale": rng.uniform(1, 2, n)}  # fmt: skip
    return ObjectTable.complete(columns | {f"coeff{k}": mix[:, k] for k in range(COEFFICIENTS)}, BANDS)


def stars(n=60, seed=3):
    rng = np.random.default_rng(seed)
    return ObjectTable.complete({
        "id": np.arange(n), "obj_type": np.full(n, STAR), "teff": np.geomspace(2600, 40000, n),
        "logg": rng.uniform(0, 5, n), "feh": rng.uniform(-2.5, 0.3, n), "av": rng.uniform(0, 2, n),
        "sed_scale": 10 ** rng.uniform(-22, -20, n),
    }, BANDS)  # fmt: skip


def exact(universe, table, edges):
    """By scipy's integral of the sampled spectra."""
    running = cumulative_trapezoid(spectra(universe, table), GRID, axis=1, initial=0.0)
    return np.diff(running[:, np.searchsorted(GRID, edges)], axis=1) / np.diff(edges)


@pytest.mark.parametrize("chip", CHIPS)
def test_stars_bin_by_bin(universe, camera, chip):
    """Exact without extinction. That enters at knots 5 A apart: up to A(V) = 2 mag 1e-3 of a bin, nearly everywhere.

    It is 1% where a cool star's spectrum rises tenfold from knot to knot, and at 3030 A, where the curve has a step.
    """
    edges = disperser_of(camera, chip).edges
    table = stars()
    clear = table.with_columns(av=np.zeros(len(table)))
    assert np.abs(binned(universe, clear, edges) / exact(universe, clear, edges) - 1).max() < 1e-9
    found, wanted = binned(universe, table, edges), exact(universe, table, edges)
    error = np.abs(found - wanted)
    assert np.percentile(error / wanted, 99) < 1e-3 and (error / wanted).max() < 0.02
    assert np.percentile(error / wanted.mean(axis=1, keepdims=True), 99.9) < 5e-3


@pytest.mark.parametrize("chip", CHIPS)
def test_galaxies_to_redshift_five(universe, camera, chip):
    """The grid's 0.5 A samples smear a line of a galaxy at z = 0 by themselves, so light is compared within 10 A.

    A galaxy's own nodes are exact; where neither lines nor the Lyman forest are near, 1e-3 of each stretch.
    """
    edges = disperser_of(camera, chip).edges
    table = galaxies(universe, np.linspace(0.0, 5.0, 60))
    found, wanted = binned(universe, table, edges), exact(universe, table, edges)
    some = round(10 / (edges[1] - edges[0]))
    n = found.shape[1] // some * some
    found, wanted = (v[:, :n].reshape(60, -1, some).mean(axis=2) for v in (found, wanted))
    typical = wanted.mean(axis=1, keepdims=True)
    error = np.abs(found - wanted) / np.maximum(wanted, 0.05 * typical)
    assert np.median(error) < 3e-4
    assert np.percentile(error, 99) < 5e-3
    assert found.sum(axis=1) == pytest.approx(wanted.sum(axis=1), rel=1e-3)


def test_an_emission_line_keeps_its_light_in_whatever_bins(universe, camera):
    """Light of [O II] to [S II] above the same galaxy without lines, in bins of 0.5, 1.5 and 6 A, at many redshifts."""
    n = 40
    z = 0.2 + 0.0007 * np.arange(n)
    masses = np.tile(np.eye(5)[1], (n, 1))
    light = []
    for step in (1, 3, 12):
        edges = GRID[4000:14000:step]
        both = []
        for strength in (1.0, 0.0):
            mix = universe.galaxy_seds.coefficients(masses, np.zeros(n), np.full(n, strength))
            columns = {"id": np.arange(n), "obj_type": np.full(n, GALAXY), "z": z, "av": np.full(n, 0.2),
                       "sed_scale": np.ones(n)}  # fmt: skip
            table = ObjectTable.complete(columns | {f"coeff{k}": mix[:, k] for k in range(COEFFICIENTS)}, BANDS)
            both.append((binned(universe, table, edges) * np.diff(edges)).sum(axis=1))
        light.append(both[0] - both[1])
    assert (light[0] > 0.01 * both[1]).all()
    for other in light[1:]:
        assert other == pytest.approx(light[0], rel=2e-4)


def test_quasars_and_a_mixed_table_in_its_own_order(universe, camera):
    edges = disperser_of(camera, GV).edges
    rng = np.random.default_rng(5)
    star, galaxy = stars(4), galaxies(universe, np.array([0.3, 1.1, 2.0, 4.0]))
    star = star.with_columns(**{f"coeff{k}": np.zeros(4) for k in range(COEFFICIENTS)})
    mixed = {name: np.concatenate([star[name], galaxy[name], galaxy[name]]) for name in galaxy.names}
    mixed["obj_type"][8:] = QUASAR
    for k in range(COEFFICIENTS):
        mixed[f"coeff{k}"][8:] = 0.0
    mixed["z"][8:] = [0.5, 1.5, 2.5, 4.5]
    table = ObjectTable.complete(mixed, BANDS).take(rng.permutation(12))
    found, wanted = binned(universe, table, edges), exact(universe, table, edges)
    assert found.sum(axis=1) == pytest.approx(wanted.sum(axis=1), rel=1e-3)
    quasar = table["obj_type"] == QUASAR
    assert np.abs(found[quasar] / wanted[quasar] - 1).max() < 1e-10
    for k in (0, 5, 11):  # alone as among others, but for the dust they share: its series is good to 1e-9
        assert binned(universe, table.take(np.array([k])), edges)[0] == pytest.approx(found[k], rel=1e-8)
    assert binned(universe, table.take(np.zeros(0, int)), edges).shape == (0, len(edges) - 1)


@pytest.mark.parametrize("kind", [ASTEROID, SATELLITE])
def test_what_reflects_sunlight_has_the_spectrum_of_a_star_whatever_row_is_first(universe, camera, kind):
    edges, table = disperser_of(camera, GV).edges, stars(3)
    wanted = binned(universe, table, edges)
    for first in (0, 2):
        kinds = np.full(3, STAR)
        kinds[first] = kind
        np.testing.assert_array_equal(binned(universe, table.with_columns(obj_type=kinds), edges), wanted)


@pytest.mark.parametrize("chip", CHIPS)
def test_electrons_of_the_first_order_are_the_fluxes_of_selection(universe, camera, chip):
    """Sum over the bins times the throughput's integral in each: the rate that magnitudes rest on, to 1e-3."""
    disperser, filter = disperser_of(camera, chip), camera.filters[camera.chips[chip].filter]
    for table in (stars(), galaxies(universe, np.linspace(0, 3, 40))):
        rate = subband_fluxes(spectra(universe, table), filter, camera.telescope).sum(axis=1)
        for piece in range(2):
            electrons = binned(universe, table, disperser.edges) @ disperser.rates[piece, disperser.orders.index(1)]
            lit = rate > 1e-3 * np.median(rate)
            assert electrons[lit] == pytest.approx(rate[lit], rel=1e-3)
