"""Galaxies along a smooth density: mean over the sky, fraction of each pixel, cells of mass and type."""

import numpy as np
from scipy.stats import chi2

from csstsim.universe.galaxies.field_galaxies import draw_field

KINDS, ROWS, COLUMNS, PIXELS = 2, 3, 4, 50


def _draw(mean, bias, delta, variance, seed=1):
    return draw_field(np.random.default_rng(seed), mean, bias, delta, variance)


def test_every_cell_has_its_poisson_number():
    """chi2 over all cells of type, redshift, mass and pixel."""
    rng = np.random.default_rng(2)
    mean = rng.uniform(0.0, 30.0, (KINDS, ROWS, COLUMNS))
    mean[1, 2] = 0.0
    bias, variance = np.array([0.5, 1.0, 2.0]), np.array([0.3, 0.2, 0.1])
    delta = rng.normal(0, np.sqrt(variance)[:, None], (ROWS, PIXELS))
    found = np.zeros((KINDS, ROWS, COLUMNS, PIXELS))
    np.add.at(found, _draw(mean, bias, delta, variance), 1)
    wanted = mean[..., None] * np.exp(bias[:, None] * delta - 0.5 * (bias**2 * variance)[:, None])[None, :, None]
    used = wanted > 0
    assert not found[~used].any()
    assert chi2.sf(((found - wanted)[used] ** 2 / wanted[used]).sum(), used.sum()) > 1e-4


def test_the_mean_over_the_sky_does_not_know_the_field():
    """A lognormal intensity of mean 1: over many pixels within 5 sigma."""
    rng, variance = np.random.default_rng(3), np.array([0.5])
    mean, bias = np.full((KINDS, 1, COLUMNS), 0.25), np.array([1.3])
    pixels = 100_000
    row = _draw(mean, bias, rng.normal(0, np.sqrt(0.5), (1, pixels)), variance)[1]
    spread = np.sqrt(2.0 * pixels + 4.0 * pixels * np.expm1(1.3**2 * 0.5))
    assert abs(len(row) - 2.0 * pixels) < 5 * spread


def test_no_galaxies():
    drawn = _draw(np.zeros((KINDS, ROWS, COLUMNS)), np.ones(ROWS), np.zeros((ROWS, PIXELS)), np.ones(ROWS))
    assert all(len(index) == 0 for index in drawn)
