"""Numbers of haloes where the field is high: their mean, their bias and their clustering, by integration."""

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.stats import norm

from csstsim.universe.structure.intensity import excess, intensity, series

STRENGTHS = (0.0, 0.2, 0.7, 1.0, 2.0, 3.5)  # b sigma


@pytest.mark.parametrize("strength", STRENGTHS)
def test_mean_number_and_bias(strength):
    sigma, bias = 0.4, strength / 0.4

    def moment(n):
        return quad(lambda x: x**n * intensity(sigma * x, bias, sigma**2) * norm.pdf(x), -9, 14, limit=300)[0]

    assert moment(0) == pytest.approx(1.0, abs=3e-5)
    assert moment(1) == pytest.approx(strength, abs=1e-4)


def test_weak_haloes_are_lognormal_up_to_the_bend():
    delta, bias, variance = np.linspace(-1.5, 0.4, 50), 1.1, 0.09
    lognormal = np.exp(bias * delta - 0.5 * bias**2 * variance)
    np.testing.assert_allclose(intensity(delta, bias, variance), lognormal, rtol=0.03)


def test_grows_with_the_field_and_less_than_lognormal_on_top():
    delta = np.linspace(-2.0, 4.0, 400)
    f = intensity(delta, 5.0, 0.16)
    assert (np.diff(f) > 0).all() and (f > 0).all()
    assert f[-1] < 0.02 * np.exp(5.0 * 4.0 - 0.5 * 25 * 0.16)


def test_no_variance_is_no_clustering():
    np.testing.assert_array_equal(intensity([0.0, 0.0], 3.0, 0.0), 1.0)


@pytest.mark.parametrize("r", [-0.3, 0.0, 0.4, 0.9])
def test_clustering_is_that_of_two_correlated_fields(r):
    """<f f'> - 1 by two-dimensional quadrature, of two kinds of haloes."""
    x, w = np.polynomial.hermite_e.hermegauss(160)
    w = w / w.sum()
    other = r * x[:, None] + np.sqrt(1 - r * r) * x
    first, second = 1.3, 0.6
    pairs = w @ (intensity(x, first, 1.0)[:, None] * intensity(other, second, 1.0)) @ w - 1
    found = excess(series(first), series(second), np.array([r]))[0]
    assert found + first * second * r == pytest.approx(pairs, abs=2e-3)
