"""Laws of the galaxy population: volumes of cells, counts of bright ones, dust between its nodes."""

import copy

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.stats import kstest
from support.embedded_sky import shipped

from csstsim.universe.galaxies.galaxies import cumulative_counts, try_laws
from csstsim.universe.galaxies.mass_function import MassGrid


@pytest.fixture(scope="module")
def universe():
    return shipped()[0]


def test_galaxies_of_a_cell_are_uniform_in_its_volume(universe):
    """The nearest cell, from redshift 0 on, where volume and distance differ most: distance^3 by a KS test."""
    cosmology = universe.cosmology
    grid = MassGrid(universe.numbers["galaxies"]["mass_function"], cosmology, lambda z: np.full(len(z), 9.0))
    z, _, _ = grid.draw_in_cells(np.random.default_rng(12), *(np.zeros(20_000, int) for _ in range(3)))
    edge = cosmology.comoving_distance(grid.z[1])
    assert kstest((cosmology.comoving_distance(z) / edge) ** 3, "uniform").pvalue > 1e-6


def test_those_brighter_than_the_table_are_counted(universe):
    """By quad, on the slope of the table's first two entries; and the total is the density asked for."""
    numbers = universe.numbers["galaxies"]
    (m0, n0), (m1, n1) = numbers["counts"][:2]
    mag, total = cumulative_counts(numbers)
    slope = np.log(n1 / n0) / (m1 - m0)
    brighter, _ = quad(lambda m: n0 * np.exp(slope * (m - m0)), m0 - 40.0, m0)
    assert mag[0] == m0 and total[0] == pytest.approx(brighter, rel=1e-6)
    assert total[-1] == pytest.approx(numbers["density"] * 3600.0)


def test_dust_dims_more_and_more_without_a_step(universe):
    """Light of a young mixture in steps of 0.01 mag of A(V), across the nodes of its table: falling, and smooth."""
    seds = universe.galaxy_seds
    dust = np.arange(0.0, 2.0, 0.01)
    mix = np.tile(np.eye(5)[0], (len(dust), 1))
    coefficients = seds.coefficients(mix, dust, np.ones(len(dust)))
    wave = np.array([3500.0, 5500.0, 9000.0])
    zeros = np.zeros(len(dust))
    spectra = seds.spectra(zeros, coefficients, np.ones(len(dust)), zeros, wave, igm=False)
    step = np.diff(np.log(spectra), axis=0)
    assert (step < 0).all()
    assert (step > -0.05).all()  # 0.01 mag at V is 0.01 to 0.02 in the logarithm


@pytest.mark.parametrize(
    ("part", "key"),
    [
        ("mass_function", "spread"),
        ("star_formation", "near"),
        ("star_formation", "quiescent_rate"),
        ("size", "disk"),
        ("dust", "growth"),
    ],
)
def test_a_law_that_is_missing_or_no_law_shows(universe, part, key):
    try_laws(universe.numbers["galaxies"], universe.cosmology)
    for wrong in ("none", None):
        numbers = copy.deepcopy(universe.numbers["galaxies"])
        numbers[part][key] = wrong
        if wrong is None:
            del numbers[part][key]
        with pytest.raises((KeyError, TypeError, ValueError)):
            try_laws(numbers, universe.cosmology)
