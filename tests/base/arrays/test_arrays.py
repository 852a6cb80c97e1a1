"""Robust sigmas, weights of polynomials and bounds of positions: one home each."""

import numpy as np
import pytest

from csstsim.base.arrays.bounds import bounds_of
from csstsim.base.arrays.polynomial_weights import cubic_weights, lagrange_weights
from csstsim.base.arrays.robust_sigma import robust_sigma, sigma_of_deviations


@pytest.mark.parametrize("dtype", [np.float64, np.float32])
def test_robust_sigma_is_that_of_a_gaussian_and_keeps_the_precision(dtype):
    values = np.random.default_rng(1).normal(5, 2, 100_001).astype(dtype)
    assert robust_sigma(values) == pytest.approx(2, rel=0.01) and robust_sigma(values).dtype == dtype
    values[::10] = 1e6  # outliers
    assert robust_sigma(values) == pytest.approx(2, rel=0.2)


def test_robust_sigma_about_a_given_centre():
    values = np.array([1, 2, 4, 7])
    assert robust_sigma(values) == 1.4826 * 1.5
    assert robust_sigma(values, 1) == sigma_of_deviations(np.array([0, 1, 3, 6])) == 1.4826 * 2


@pytest.mark.parametrize("t", [0.0, 0.3, 1.0])
def test_cubics_through_four_values(t):
    weights = np.empty(4)
    lagrange_weights(t + 1, 4, weights)
    assert cubic_weights(t) == pytest.approx(weights, abs=1e-15)
    for power in range(4):
        assert cubic_weights(t) @ np.arange(-1.0, 3.0) ** power == pytest.approx(t**power, abs=1e-14)


def test_weights_of_an_array_are_those_of_its_numbers():
    t = np.array([0.2, 0.9])
    weights = np.empty((8, 2))
    one = np.empty(8)
    lagrange_weights(t, 8, weights)
    lagrange_weights(t[1], 8, one)
    assert np.array_equal(weights[:, 1], one) and np.array_equal(np.transpose(cubic_weights(t))[1], cubic_weights(0.9))


def test_bounds():
    assert bounds_of(np.array([[1.0, 5.0], [3.0, 4.0], [2.0, 6.0]])) == (1.0, 3.0, 4.0, 6.0)
