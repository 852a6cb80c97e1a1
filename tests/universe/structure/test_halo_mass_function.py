"""Numbers, bias, radii of haloes against colossus and closed forms."""

import numpy as np
import pytest
from universe.structure.small_matter import COSMOLOGY, NUMBERS

from csstsim.universe.lensing.cosmology import Cosmology
from csstsim.universe.lensing.power_spectrum import MatterPower
from csstsim.universe.structure.haloes import concentration
from csstsim.universe.structure.mass_function import HaloMassFunction

MASS = np.array([1e11, 1e12, 1e13, 1e14, 1e15])
# colossus 1.4.0: tinker08, tinker10, duffy08 at these masses [solar], 200m; dn / dlnM in Mpc^-3
NUMBER = {
    0: [1.3968e-02, 1.8401e-03, 2.3708e-04, 2.3475e-05, 6.1336e-07],
    1: [1.4684e-02, 1.7093e-03, 1.5202e-04, 4.9625e-06, 2.9384e-09],
    2: [1.3055e-02, 1.1336e-03, 4.8603e-05, 2.1033e-07, 1.5006e-13],
}
BIAS = {
    0: [0.6789, 0.7831, 1.0431, 1.8055, 4.6430],
    1: [0.8990, 1.2134, 1.9962, 4.3205, 13.1469],
    2: [1.3247, 2.0458, 3.8577, 9.3049, 30.2797],
}
CONCENTRATION = {0: [13.340, 11.070, 9.187, 7.624, 6.327], 2: [4.398, 3.650, 3.029, 2.513, 2.086]}


@pytest.fixture(scope="module")
def haloes():
    cosmology = Cosmology(COSMOLOGY)
    return HaloMassFunction(cosmology, MatterPower(cosmology, COSMOLOGY))


@pytest.mark.parametrize("z", NUMBER)
def test_number_and_bias_against_colossus(haloes, z):
    np.testing.assert_allclose(haloes.dn_dlnm(MASS, z), NUMBER[z], rtol=5e-3)
    np.testing.assert_allclose(haloes.bias(MASS, z), BIAS[z], rtol=2e-3)


@pytest.mark.parametrize("z", CONCENTRATION)
def test_concentration_against_colossus(z):
    found = concentration(MASS, z, NUMBERS["haloes"]["concentration"], COSMOLOGY["h0"] / 100)
    np.testing.assert_allclose(found, CONCENTRATION[z], rtol=1e-3)


def test_radii_and_mean_density(haloes):
    np.testing.assert_allclose(4 * np.pi / 3 * haloes.density * haloes.lagrangian_radius(MASS) ** 3, MASS)
    np.testing.assert_allclose(haloes.virial_radius(MASS) ** 3 * 200, haloes.lagrangian_radius(MASS) ** 3)
    assert haloes.density == pytest.approx(3.953e10, rel=1e-3)  # solar / Mpc^3: 0.3111 x 2.7754e11 x 0.6766^2


def test_sigma_of_the_sphere_that_defines_sigma_8(haloes):
    mass = 4 * np.pi / 3 * haloes.density * (8 / 0.6766) ** 3
    assert haloes.sigma(mass, 0.0) == pytest.approx(COSMOLOGY["sigma_8"], rel=1e-3)
    growth = haloes.cosmology.growth(1.0)
    assert haloes.sigma(mass, 1.0) == pytest.approx(COSMOLOGY["sigma_8"] * growth, rel=1e-3)


def test_masses_beyond_the_table_are_not_a_number(haloes):
    assert np.isnan(haloes.dn_dlnm([1e6, 1e18, np.nan], 0.0)).all()
