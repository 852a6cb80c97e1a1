"""Maps by source distance: sums of shells against numpy, and polynomials that the interpolation keeps."""

import numpy as np
import pytest

from csstsim.base.arrays.polynomial_weights import lagrange_weights
from csstsim.universe.structure import density, source_maps
from csstsim.universe.structure.source_maps import add_shells, interpolate_depth


def test_maps_of_distances_are_sums_of_the_shells_before_them():
    rng = np.random.default_rng(1)
    values = rng.normal(size=(3, 4, 3, 5)).astype(np.float32)
    weights = np.triu(rng.uniform(0.1, 1.0, (5, 6)), 1).astype(np.float32)  # a shell counts behind it
    weights[4] = 0.0
    weights[2, 4] = 0.0  # and may count nothing again
    maps = add_shells.py_func(values, weights)
    np.testing.assert_allclose(maps, np.einsum("yxcs,sk->yxkc", values, weights), rtol=1e-5, atol=1e-6)


def polynomial(x, y, channel, power):
    return 1.0 + channel + (0.1 * x) ** power - 0.5 * channel * (0.1 * y) ** power + 0.02 * x * y


@pytest.mark.parametrize(("x", "y"), [(3.0, 3.0), (8.3, 6.6), (15.0, 10.0), (4.9, 10.9), (15.9, 3.1)])
@pytest.mark.parametrize(("depth", "between"), [(0.0, 0.0), (1.25, 1.25), (3.0, 3.0), (7.5, 3.0)])
def test_values_between_are_those_of_a_polynomial_and_linear_in_distance(x, y, depth, between, monkeypatch):
    """Of the seventh degree on a grid of 20 columns and 15 rows; the distances' maps rise as k."""
    row, column = np.indices((15, 20))
    plane = np.stack([polynomial(column, row, c, 7) for c in range(3)], axis=-1)
    maps = (plane[:, :, None] * np.array([1.0, 2.0, 3.0, 4.0])[:, None]).astype(np.float32)
    monkeypatch.setattr(source_maps, "lagrange", lagrange_weights)
    found = interpolate_depth.py_func(maps, np.array([[x, y]]), np.array([depth]))[0]
    assert found == pytest.approx([(1 + between) * polynomial(x, y, c, 7) for c in range(3)], rel=3e-6)


@pytest.mark.parametrize(("x", "y"), [(1.0, 1.0), (8.3, 6.6), (17.9, 12.9), (1.2, 12.5), (18.0, 13.0)])
def test_densities_between_are_those_of_a_cubic(x, y, monkeypatch):
    """Shell by shell, with 4 points along each axis, up to the last cell but one."""
    row, column = np.indices((15, 20))
    maps = np.stack([polynomial(column, row, c, 3) for c in range(4)], axis=-1).astype(np.float32)
    monkeypatch.setattr(density, "_lagrange", lagrange_weights)
    wanted = [polynomial(x, y, c, 3) for c in range(4)]
    positions = np.array([[x, y]])
    assert density.interpolate_all.py_func(maps, positions)[0] == pytest.approx(wanted, rel=1e-5)
    for shell in (0, 3):
        assert density.interpolate_one.py_func(maps, positions, np.array([shell]))[0] == pytest.approx(
            wanted[shell], rel=1e-5
        )


@pytest.mark.parametrize("t", [-0.4, 0.0, 1.0, 1.7, 3.2])
def test_cubic_weights_are_lagranges(t):
    weights = np.empty(4)
    lagrange_weights(t, 4, weights)
    for power in range(4):
        assert weights @ np.arange(4.0) ** power == pytest.approx(t**power, abs=1e-12)
