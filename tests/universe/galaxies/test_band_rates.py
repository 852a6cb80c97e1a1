"""Galaxies' light from tables in redshift, against the sum over the paper's grid."""

import numpy as np
import pytest
from support.embedded_sky import shipped

from csstsim.catalog.light.photometry import subband_weights
from csstsim.instrument.filter import GRID
from csstsim.universe.coefficients import COEFFICIENTS
from csstsim.universe.galaxies import band_rates
from csstsim.universe.galaxies.band_rates import BandRates

TOLERANCE = 2e-3  # of the light that arrives, where the forest's edge leaves a band; 5e-4 for nine galaxies in ten
FAINT = 1e-6  # of the light in the galaxy's brightest band: 15 mag fainter, only absolute light counts


@pytest.fixture(scope="module")
def seds():
    return shipped()[0].galaxy_seds


@pytest.fixture(scope="module")
def bands(seds, camera):
    weights = [subband_weights(f, camera.telescope).sum(axis=0) for f in camera.bands.values()]
    return BandRates(seds, np.stack(weights), galaxies_min=1)


def _galaxies(seds, count, seed=3):
    """Random galaxies: redshifts 0 to 7, all templates, old ones among them, A(V) 0 to 3 mag."""
    rng = np.random.default_rng(seed)
    masses = rng.dirichlet(np.full(5, 0.2), count)
    mix = seds.coefficients(masses, rng.exponential(0.6, count), rng.lognormal(0, 0.5, count))
    return rng.uniform(0, 7, count), mix, rng.uniform(0, 3, count)


@pytest.mark.thorough
def test_rates_are_the_sum_over_the_grid(seds, bands):
    z, mix, av = _galaxies(seds, 100)
    direct = seds.spectra(z, mix, np.ones(len(z)), av) @ bands.weights.T
    allowed = TOLERANCE * direct + FAINT * direct.max(axis=1, keepdims=True)
    error = np.abs(bands.rates(z, mix, av) - direct)
    assert (error <= allowed).all()
    assert np.percentile((error / allowed).max(axis=1), 90) * TOLERANCE < 5e-4


def test_negative_sums_of_components_count_as_zero(seds, bands):
    """Old galaxies' components add up to less than zero in the far ultraviolet; NUV of a table alone would, too."""
    z = np.linspace(2.0, 3.5, 60)
    mix = np.repeat(seds.coefficients(np.eye(5)[[3]], [0.0], [0.0]), 60, axis=0)
    assert ((mix[0] @ seds.cells[1]) < 0).any()
    exact = seds.rates(z, mix, np.zeros(60), bands.weights)
    np.testing.assert_allclose(bands.rates(z, mix, np.zeros(60)), exact, rtol=1e-12)


def test_dust_between_tables(seds, bands):
    """Near galaxies, which the forest spares, so that the dust's expansion is what is left: 1e-4."""
    _, mix, _ = _galaxies(seds, 60)
    z, av = np.linspace(0.05, 0.9, 60), np.repeat([0.5, 1.52, 7.9], 20)
    exact = seds.spectra(z, mix, np.ones(60), av) @ bands.weights.T
    np.testing.assert_allclose(bands.rates(z, mix, av), exact, rtol=1e-4)


def test_few_galaxies_are_summed_one_by_one(seds, bands):
    """A table costs more than they do; dusty bricks have many tables with few galaxies each."""
    z, mix, av = _galaxies(seds, 50)
    few = BandRates(seds, bands.weights, galaxies_min=51).rates(z, mix, av)
    np.testing.assert_array_equal(few, seds.rates(z, mix, av, bands.weights))
    assert (few != bands.rates(z, mix, av)).any()


def test_one_alone_has_the_light_that_it_has_among_others(seds, bands):
    z, mix, av = _galaxies(seds, 100)
    light = bands.rates(z, mix, av)
    for k in (0, 17, 99):
        one = bands.rates(z[k : k + 1], mix[k : k + 1], av[k : k + 1])[0]
        np.testing.assert_allclose(one, light[k], rtol=1e-4)  # those summed one by one share the mean dust of a call
    again = BandRates(seds, bands.weights, galaxies_min=1).rates(z[::-1], mix[::-1], av[::-1])[::-1]
    np.testing.assert_allclose(again, light, rtol=1e-9)


@pytest.mark.parametrize("z", [0.0, -1e-4, 1e-12, np.expm1(0.128), np.expm1(0.128) * (1 - 1e-12), 6.999])
@pytest.mark.parametrize("av", [0.0, 0.5, 1.5, 30.0])
def test_borders_of_tables(seds, bands, z, av):
    _, mix, _ = _galaxies(seds, 1)
    direct = seds.rates([z], mix, [av], bands.weights)
    assert (np.abs(bands.rates([z], mix, [av]) - direct) <= TOLERANCE * direct + FAINT * direct.max()).all()


def test_edges_of_the_input(seds, bands):
    assert bands.rates(np.zeros(0), np.zeros((0, COEFFICIENTS)), np.zeros(0)).shape == (0, 7)
    _, mix, _ = _galaxies(seds, 1)
    for z, c, av in (([np.nan], mix, [0.1]), ([0.5], mix * np.nan, [0.1]), ([0.5], mix, [np.nan])):
        assert np.isnan(bands.rates(z, c, av)).all()
    assert not bands.rates([30.0], mix, [0.0]).any()  # all below 600 A at rest
    dark = BandRates(seds, np.zeros((2, len(GRID))), galaxies_min=1)
    assert not dark.rates([0.5], mix, [0.0]).any()


def test_a_galaxy_of_a_table_is_cubic_in_the_steps_of_redshift_and_a_series_in_dust():
    """Two components and two bands of three moments, a cubic of ln(1 + z) each: exp(-d m) sum (-d)^n / n! R_n."""
    step, first, rng = 1e-3, 128, np.random.default_rng(7)
    order, spread = np.arange(4), rng.normal(size=(2, 6, 4))
    nodes = (first - 1 + np.arange(20))[:, None] * 0.01
    table = np.stack([nodes**order @ part.T for part in spread], axis=1) + 9.0  # (nodes, k, bands x moments)
    z = np.expm1(step * (first + np.array([0.0, 0.3, 7.5, 16.9, 5.0])))
    coefficients, depth, mean = (
        rng.uniform(0.5, 1.0, (5, 2)),
        np.array([0.0, 0.3, -0.2, 0.1, 0.4]),
        np.array([0.8, 1.4]),
    )
    out = np.full((5, 2), -7.0)
    rows = np.array([3, 0, 2, 1])
    band_rates.interpolate(out, rows, table, first, z, coefficients, depth, mean)
    for g in rows:
        at = (np.log1p(z[g]) / step * 0.01) ** order
        light = sum(c * (part @ at + 9.0) for c, part in zip(coefficients[g], spread, strict=True)).reshape(2, 3)
        d = depth[g]
        wanted = np.exp(-d * mean) * (light @ [1.0, -d, d**2 / 2])
        assert out[g] == pytest.approx(np.maximum(wanted, 0.0), rel=1e-9)
    assert (out[4] == -7.0).all()
    band_rates.interpolate(out, rows, -table, first, z, coefficients, np.zeros(5), mean)
    assert (out[rows] == 0.0).all()


def test_which_sums_of_components_are_positive():
    basis = np.array([[1.0, 1.0, 1.0], [0.0, 1.0, 2.0]], np.float32)
    mix = np.array([[1.0, 0.0], [1.0, -0.5], [1.0, -0.6], [-0.1, 1.0], [np.nan, 1.0], [0.0, 0.0]], np.float32)
    assert band_rates.all_positive(mix, basis).tolist() == [True, True, False, False, False, True]
