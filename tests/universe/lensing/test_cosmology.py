"""Distances and growth against astropy, closed forms and the integral of the growth equation."""

import numpy as np
import pytest
from astropy.cosmology import FlatLambdaCDM
from scipy.integrate import quad

from csstsim.base.shipped import SHIPPED
from csstsim.instrument.load import read_data
from csstsim.universe.lensing.cosmology import Cosmology

NUMBERS = read_data(SHIPPED / "universe" / "cosmology.yaml")
Z = np.array([1e-6, 0.01, 0.3, 1.0, 3.5, 6.0, 1100.0])


@pytest.fixture(scope="module")
def cosmology():
    return Cosmology(NUMBERS)


def test_distances_and_volumes_are_those_of_astropy(cosmology):
    peer = FlatLambdaCDM(H0=67.66, Om0=0.3111, Tcmb0=0)
    np.testing.assert_allclose(cosmology.comoving_distance(Z), peer.comoving_distance(Z).value, rtol=1e-8)
    np.testing.assert_allclose(cosmology.luminosity_distance(Z), peer.luminosity_distance(Z).value, rtol=1e-8)
    np.testing.assert_allclose(cosmology.distance_modulus(Z), peer.distmod(Z).value, atol=1e-7)
    shell = (peer.comoving_volume(1.1) - peer.comoving_volume(1.0)).value / (4 * np.pi * np.degrees(1) ** 2)
    assert cosmology.volume(1.0, 1.1) == pytest.approx(shell, rel=1e-8)


def test_radiation_left_out_is_small(cosmology):
    peer = FlatLambdaCDM(H0=67.66, Om0=0.3111, Tcmb0=2.7255)
    np.testing.assert_allclose(cosmology.comoving_distance(Z[:-1]), peer.comoving_distance(Z[:-1]).value, rtol=5e-4)


def test_growth_solves_its_equation(cosmology):
    """D ~ E(z) int_z^inf (1 + z') / E^3 dz' (Heath 1977)."""
    heath = [
        cosmology.expansion(z) * quad(lambda x: (1 + x) / cosmology.expansion(x) ** 3, z, np.inf)[0] for z in Z[:-1]
    ]
    today = quad(lambda x: (1 + x) / cosmology.expansion(x) ** 3, 0, np.inf)[0]
    np.testing.assert_allclose(cosmology.growth(Z[:-1]), np.array(heath) / today, rtol=1e-6)


def test_einstein_de_sitter_in_closed_form():
    flat = Cosmology({"omega_m": 1.0, "omega_lambda": 0.0, "h0": 70.0})
    np.testing.assert_allclose(flat.comoving_distance(Z), 2 * flat.hubble_distance * (1 - (1 + Z) ** -0.5), rtol=1e-9)
    np.testing.assert_allclose(flat.growth(Z), 1 / (1 + Z), rtol=1e-14)


def test_edges(cosmology):
    assert cosmology.comoving_distance(0.0) == 0.0 and cosmology.distance_modulus(0.0) == -np.inf
    assert np.isnan(cosmology.comoving_distance([-0.1, 2000.0, np.nan])).all()
    assert cosmology.comoving_distance([]).shape == (0,)


@pytest.mark.parametrize("wrong", [{"omega_m": 0.2}, {"omega_m": np.nan}, {"h0": 0.0}])
def test_not_a_flat_universe(wrong):
    with pytest.raises(ValueError, match="cosmology"):
        Cosmology(NUMBERS | wrong)


def test_matter_fraction_and_signs(cosmology):
    """The share of matter, by astropy; a volume inwards is negative, and volumes add."""
    peer = FlatLambdaCDM(H0=67.66, Om0=0.3111, Tcmb0=0)
    np.testing.assert_allclose(cosmology.matter_fraction(Z), peer.Om(Z), rtol=1e-9)
    np.testing.assert_allclose(cosmology.expansion(Z), peer.efunc(Z), rtol=1e-9)
    np.testing.assert_allclose(
        cosmology.angular_diameter_distance(Z), peer.angular_diameter_distance(Z).value, rtol=1e-8
    )
    assert cosmology.volume(1.0, 0.5) == -cosmology.volume(0.5, 1.0) < 0
    assert cosmology.volume(0.2, 0.5) + cosmology.volume(0.5, 1.0) == pytest.approx(cosmology.volume(0.2, 1.0))
