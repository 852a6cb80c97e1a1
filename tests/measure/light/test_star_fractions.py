"""Probabilities of a point are right at any fraction of points, and where points and galaxies are hardly told apart."""

import numpy as np
import pytest

from csstsim.measure.light.star_fractions import BIN, PRIOR_SOURCES, RARE, with_star_fractions
from csstsim.measure.light.total_light import POINT_FRACTION


def sources(fraction, apart, count, seed=0):
    """Return (is point, probability at POINT_FRACTION) of sources with a quantity of N(+-apart / 2, 1)."""
    rng = np.random.default_rng(seed)
    is_point = rng.random(count) < fraction
    quantity = rng.normal(np.where(is_point, 0.5, -0.5) * apart, 1.0)
    odds = np.exp(quantity * apart) * POINT_FRACTION / (1 - POINT_FRACTION)  # the ratio of the two Gaussians
    return is_point, odds / (1 + odds)


@pytest.mark.parametrize("fraction", [0.01, 0.1, 0.5, 0.95])
@pytest.mark.parametrize("apart", [2.5, 4.0, 8.0])
def test_of_sources_with_a_probability_so_many_are_points(fraction, apart):
    """In bins of probability, within 4 sigma; before, most of those above 0.9 are galaxies where points are rare."""
    is_point, before = sources(fraction, apart, 20_000)
    after = with_star_fractions(before, np.full(20_000, 24.1), np.ones(20_000, bool))
    for low, high in ((0.0, 0.1), (0.1, 0.5), (0.5, 0.9), (0.9, 1.0)):
        rows = (after >= low) & (after <= high)
        if rows.sum() > 20:
            expected, error = after[rows].mean(), np.sqrt((after * (1 - after))[rows].sum()) / rows.sum()
            assert is_point[rows].mean() == pytest.approx(expected, abs=4 * error + 0.02)
    assert after.mean() == pytest.approx(fraction, rel=0.1, abs=0.01)


def test_fractions_are_those_of_each_magnitude():
    mags = np.repeat([20.25, 25.25], 5000)
    bright, faint = sources(0.8, 3.0, 5000, 1), sources(0.02, 3.0, 5000, 2)
    after = with_star_fractions(np.append(bright[1], faint[1]), mags, np.ones(10_000, bool))
    for rows, is_point in ((slice(5000), bright[0]), (slice(5000, None), faint[0])):
        assert after[rows].mean() == pytest.approx(is_point.mean(), abs=0.01)


def test_between_the_middles_of_bins_odds_are_interpolated():
    probability = np.full(3, POINT_FRACTION)
    mag = np.array([20.25, 20.25 + BIN, 20.25 + 0.5 * BIN - 1e-9])
    known = np.array([True, True, False])
    probability[:2] = 1 - 1e-12, 1e-12
    after = with_star_fractions(probability, mag, known)
    logit = np.log(after / (1 - after))
    first = (1 + PRIOR_SOURCES * POINT_FRACTION) / (1 + PRIOR_SOURCES)  # of a bin whose only source is a point
    second = PRIOR_SOURCES * first / (1 + PRIOR_SOURCES)
    assert after[1] < 1e-11 and after[0] > 1 - 1e-11
    wanted = 0.5 * (np.log(first / (1 - first)) + np.log(second / (1 - second)))
    assert logit[2] == pytest.approx(wanted, abs=1e-3)


def test_what_is_not_known_stays():
    point = np.array([0.0, 1.0, np.nan])
    mag = np.full(3, 20.0)
    for known in (np.ones(3, bool), np.zeros(3, bool)):
        assert with_star_fractions(point, mag, known) == pytest.approx(point, nan_ok=True, abs=1e-12)
    assert with_star_fractions(np.zeros(0), np.zeros(0), np.zeros(0, bool)).size == 0


@pytest.mark.parametrize("point", [0.0, 1.0])
def test_one_kind_alone_at_all_magnitudes_leaves_odds_of_the_other(point):
    mag = np.repeat(np.arange(10.0, 30.0, 0.1), 500)
    known = np.arange(mag.size) % 500 > 0
    before = np.where(known, point, POINT_FRACTION)
    after = with_star_fractions(before, mag, known)
    assert after[~known][-1] == pytest.approx(abs(point - RARE), rel=1e-6)


@pytest.mark.parametrize("last", [0, 1, 2, 5])
def test_few_sources_at_the_limit_have_the_fraction_of_brighter_ones(last):
    """Galaxies at 24.75 and 25.25, some at 25.6, and faint ones, or without a flux, that tell nothing."""
    _, before = sources(0.0, 1.5, 2000 + last)
    mag = np.concatenate([np.full(400, 24.75), np.full(400, 25.25), np.full(last, 25.6), np.full(600, 26.4)])
    mag = np.append(mag, np.full(600, np.nan))
    known = np.append(np.ones(800 + last, bool), np.zeros(1200, bool))
    after = with_star_fractions(before, mag, known)
    assert (before[~known] > 0.5).sum() > 20 and not (after[~known] > 0.5).any()
