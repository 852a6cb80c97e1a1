"""Galaxies of a halo by proxy: closed forms against integrals, published numbers of satellites, monotony."""

import numpy as np
import pytest
from scipy.integrate import quad

from csstsim.base.shipped import SHIPPED
from csstsim.instrument.load import read_data
from csstsim.universe.galaxies.subhaloes import (
    host_masses,
    proxies,
    proxy_above,
    satellite_counts,
    scatter_in_proxy,
    subhaloes_above,
    surviving_fraction,
)

NUMBERS = read_data(SHIPPED / "universe" / "occupation.yaml")


@pytest.mark.parametrize("x", [1e-6, 1e-2, 0.3, 0.9])
def test_subhaloes_above_a_mass_are_the_integral_of_their_law(x):
    law = NUMBERS["subhaloes"]

    def density(ln):
        return law["gamma"] * np.exp(law["alpha"] * ln - law["beta"] * np.exp(law["omega"] * ln))

    assert subhaloes_above(x, law) == pytest.approx(quad(density, np.log(x), 2.0, limit=200)[0], rel=1e-8)


def test_slope_of_the_stellar_to_halo_relation_is_its_derivative():
    law, mass, step = NUMBERS["stellar_to_halo"], np.array([9.0, 11.5, 12.5, 15.0]), 1e-5

    def log_stars(m):
        y = 10 ** (m - law["log_m1"])
        return m - np.log10(y ** -law["beta"] + y ** law["gamma"])

    slope = (log_stars(mass + step) - log_stars(mass - step)) / (2 * step)
    np.testing.assert_allclose(law["scatter"] / scatter_in_proxy(mass, law), slope, rtol=1e-6)


def test_centrals_scatter_about_their_mass():
    fraction, mass, x = proxy_above(NUMBERS), host_masses(), proxies()
    row = np.argmin(np.abs(mass - 13.0))
    mean = x[0] + np.trapezoid(fraction[row], x)
    assert mean == pytest.approx(mass[row], abs=1e-3)
    assert fraction[row, 0] == 1.0 and fraction[row, -1] < 1e-12


def test_satellites_are_the_subhaloes_when_scatter_is_small():
    """Without scatter, those above a proxy are the subhaloes above that mass, up to the host's own."""
    sharp = NUMBERS | {"stellar_to_halo": NUMBERS["stellar_to_halo"] | {"scatter": 1e-4}}
    counts, mass, x = satellite_counts(sharp, proxy_above(sharp)), host_masses(), proxies()
    row, column = np.argmin(np.abs(mass - 14.0)), np.argmin(np.abs(x - 12.0))
    law = sharp["subhaloes"]
    wanted = subhaloes_above(10 ** (x[column] - mass[row]), law) - subhaloes_above(1.0, law)
    assert counts[row, column] == pytest.approx(wanted, rel=1e-6)
    assert (np.diff(counts, axis=1) <= 1e-12).all() and counts[row, -1] == 0.0


@pytest.mark.parametrize(
    ("log_mass", "z", "fraction"), [(13, 0, 0.38), (15, 0, 0.38 * 10**0.16), (13, 1, 0.38 * 2**0.3), (16, 6, 0.9)]
)
def test_galaxies_survive_in_young_haloes(log_mass, z, fraction):
    assert surviving_fraction(log_mass, z, NUMBERS["surviving"]) == pytest.approx(fraction)
