"""Matter power against CAMB 2.0.5 and Colossus 1.4.0, and its limits."""

import numpy as np
import pytest
from scipy.integrate import quad

from csstsim.base.shipped import SHIPPED
from csstsim.instrument.load import read_data
from csstsim.universe.lensing.cosmology import Cosmology
from csstsim.universe.lensing.power_spectrum import MatterPower, transfer

NUMBERS = read_data(SHIPPED / "universe" / "cosmology.yaml")
K = np.array([1e-3, 1e-2, 0.05, 0.1, 0.3, 1, 3, 10, 30])  # 1 / Mpc

# Colossus 1.4.0 (Diemer 2018, ApJS 239, 35), model eisenstein98, the shipped cosmology, z = 0 [Mpc^3].
COLOSSUS = [17148.8, 75706.3, 29235.7, 10498.1, 1279.21, 86.4513, 5.87972, 0.262084, 0.0138848]
# CAMB 2.0.5 (Lewis, Challinor & Lasenby 2000), halofit_version takahashi, massless neutrinos, same sigma_8 [Mpc^3].
CAMB_LINEAR = [17296.0, 77619.0, 29054.0, 10368.0, 1300.0, 87.32, 5.8462, 0.2577, 0.013549]
CAMB_HALOFIT = {
    0: [17296.0, 76880.0, 28608.0, 11197.0, 2804.4, 846.71, 156.86, 13.291, 1.1714],
    0.5: [10255.0, 45750.0, 17030.0, 6445.4, 1357.3, 357.06, 71.485, 6.0528, 0.49339],
    1: [6394.7, 28597.0, 10687.0, 3972.2, 727.96, 165.19, 36.272, 3.3861, 0.27202],
    2: [3025.7, 13563.0, 5089.3, 1861.1, 287.64, 47.073, 11.032, 1.3517, 0.11664],
    3: [1730.4, 7765.5, 2916.5, 1058.0, 150.13, 18.403, 3.9585, 0.60842, 0.061649],
}


@pytest.fixture(scope="module")
def power():
    return MatterPower(Cosmology(NUMBERS), NUMBERS)


def test_same_fit_as_colossus(power):
    np.testing.assert_allclose(power.linear(K, 0.0), COLOSSUS, rtol=3e-4)


def test_camb_within_what_the_fits_claim(power):
    np.testing.assert_allclose(power.linear(K, 0.0), CAMB_LINEAR, rtol=0.03)
    for z, expected in CAMB_HALOFIT.items():
        np.testing.assert_allclose(power.nonlinear(K, z), expected, rtol=0.04, err_msg=f"z = {z}")


def test_sigma_8(power):
    """By another quadrature, over k of the top hat of 8 Mpc / h."""
    r = 8.0 / 0.6766

    def integrand(log):
        k, x = np.exp(log), np.exp(log) * r
        return k**3 * power.linear(k, 0.0) / (2 * np.pi**2) * (3 * (np.sin(x) - x * np.cos(x)) / x**3) ** 2

    pieces = [quad(integrand, a, a + 1, epsrel=1e-6)[0] for a in range(-10, 5)]
    assert np.sqrt(sum(pieces)) == pytest.approx(0.8102, rel=1e-4)


def test_limits(power):
    assert transfer(1e-6, NUMBERS) == pytest.approx(1.0, abs=1e-3)
    # Linear on large scales, and where little has collapsed.
    assert power.nonlinear(1e-4, 0.0) == pytest.approx(power.linear(1e-4, 0.0), rel=1e-3)
    assert power.nonlinear(0.1, 30.0) == pytest.approx(power.linear(0.1, 30.0), rel=1e-2)
    assert power.linear(0.1, 1.0) / power.linear(0.1, 0.0) == pytest.approx(power.cosmology.growth(1.0) ** 2)
    wide = power.nonlinear(np.geomspace(1e-5, 1e4, 200)[:, None], np.linspace(0, 3.5, 8))
    assert np.isfinite(wide).all() and (wide > 0).all()
