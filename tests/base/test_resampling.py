"""A density keeps its integral on another grid: against FITPACK, for samples finer, coarser, uneven, at the ends."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from scipy.interpolate import InterpolatedUnivariateSpline

from csstsim.base.resampling import bin_averages, on_grid, read_at

GRID = np.arange(100.0, 200.25, 0.5)


def integral(x, y, low, high):
    """The integral of the linear spline by FITPACK; zero beyond its ends."""
    return InterpolatedUnivariateSpline(x, y, k=1, ext=1).integral(low, high)


@st.composite
def densities(draw):
    count = draw(st.integers(2, 60))
    even = draw(st.booleans())  # samples on the grid, or anywhere
    gap = st.integers(1, 40).map(lambda n: 0.5 * n) if even else st.floats(1e-3, 30.0)
    start = st.integers(100, 420).map(lambda n: 0.5 * n) if even else st.floats(50.0, 210.0)
    x = draw(start) + np.cumsum(draw(st.lists(gap, min_size=count, max_size=count)))
    y = np.array(draw(st.lists(st.floats(0.0, 1e6), min_size=count, max_size=count)))
    return x, y


@pytest.mark.thorough
@settings(max_examples=300, deadline=None)
@given(densities())
def test_each_bin_has_the_mean_of_its_integral(density):
    x, y = density
    edges = np.append(GRID - 0.25, GRID[-1] + 0.25)
    means = bin_averages(edges, x, y)
    expected = [integral(x, y, a, b) / 0.5 for a, b in pairwise(edges)]
    assert means == pytest.approx(expected, rel=1e-9, abs=1e-9 * max(y.max() * np.ptp(x), 1e-9))


@settings(max_examples=300, deadline=None)
@given(densities())
def test_the_sum_over_the_grid_is_the_integral(density):
    x, y = density
    values, slack = on_grid(GRID, x, y), 1e-9 * max(y.max() * np.ptp(x), 1e-9)
    if np.array_equal(values, np.interp(GRID, x, y, left=0.0, right=0.0)):  # samples: to the ends of the grid
        total, expected = np.trapezoid(values, GRID), integral(x, y, GRID[0], GRID[-1])
    else:  # means: to the ends of the outer bins
        total, expected = 0.5 * values.sum(), integral(x, y, GRID[0] - 0.25, GRID[-1] + 0.25)
    assert total == pytest.approx(expected, rel=1e-9, abs=slack)


@pytest.mark.parametrize("centre", [150.0, 150.125, 150.25, 150.4])
@pytest.mark.parametrize("fwhm", [0.01, 0.1, 0.3, 1.0, 10.0])
def test_a_narrow_line_keeps_its_light(centre, fwhm):
    sigma = fwhm / 2.3548
    x = np.unique(np.r_[np.arange(100.0, 200.5, 1.0), centre + sigma * np.linspace(-6, 6, 400)])
    y = np.exp(-0.5 * ((x - centre) / sigma) ** 2) / (sigma * np.sqrt(2 * np.pi))
    assert 0.5 * on_grid(GRID, x, y).sum() == pytest.approx(np.trapezoid(y, x), rel=1e-12)


def test_samples_on_the_grid_stay_as_they_are():
    x = GRID[::4]
    y = np.random.default_rng(1).random(len(x))
    assert np.array_equal(on_grid(GRID, x, y), np.interp(GRID, x, y))
    assert np.array_equal(on_grid(GRID, np.r_[90.3, GRID, 210.7], np.r_[0.5, GRID, 0.5]), GRID)


def test_beyond_its_ends_it_is_zero():
    assert on_grid(GRID, np.array([120.0, 150.0]), np.ones(2)).sum() == pytest.approx(30 / 0.5)
    assert not on_grid(GRID, np.array([10.0, 20.0]), np.ones(2)).any()
    assert on_grid(GRID, np.array([150.1, 150.2]), np.ones(2)).sum() == pytest.approx(0.1 / 0.5)


@settings(max_examples=300, deadline=None)
@given(densities())
@example((np.array([200.0, 200.25]), np.array([0.0, 1.0])))  # fine beyond the grid's last point alone
def test_a_curve_is_read_at_points_or_keeps_its_integral(density):
    """Coarse curves keep the values of their lines, to the bit; fine ones their integral over the grid, ends held."""
    x, y = density
    values = read_at(GRID, x, y)
    within = x[(x > GRID[0] - 0.5) & (x < GRID[-1] + 0.5)]
    of_grid = np.isin(x[(x >= GRID[0]) & (x <= GRID[-1])], GRID).all()
    if len(within) < 2 or np.diff(within).min() >= 0.5 or of_grid:
        assert np.array_equal(values, np.interp(GRID, x, y))
        return
    at = np.unique([GRID[0] - 0.25, GRID[-1] + 0.25, *within[(within > GRID[0] - 0.25) & (within < GRID[-1] + 0.25)]])
    expected = np.trapezoid(np.interp(at, x, y), at)
    assert 0.5 * values.sum() == pytest.approx(expected, rel=1e-9, abs=1e-9 * max(y.max() * np.ptp(x), 1e-9))
    assert read_at(GRID[7:8], x, y) == np.interp(GRID[7], x, y)
