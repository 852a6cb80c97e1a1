"""Sersic tables against closed forms, GalSim's transform and plain integrals; the look-up by bits."""

import galsim
import numba
import numpy as np
import pytest
from scipy.integrate import quad
from scipy.special import gammaincc, gammaincinv, j0

from csstsim.catalog.profiles import sersic
from csstsim.catalog.profiles.log_table import first_of, nodes, read
from csstsim.catalog.profiles.sersic import (
    CUT_NONE,
    INDEX_MAX,
    INDEX_MIN,
    K2_HIGH,
    K2_LOW,
    R2_HIGH,
    R2_LOW,
    brightness,
    brightness_radius,
    cut_for,
    extent,
    light_beyond,
    radius_of,
    sersic_b,
    tables,
)

K = np.sqrt(nodes(K2_LOW, K2_HIGH))
SQUARE = nodes(R2_LOW, R2_HIGH)


def test_a_table_is_read_between_its_nodes():
    """1 / x from 2^-3 to 2^5: the last bit at nodes, 2^-14 / 4 between, the end values outside."""

    @numba.njit
    def look(table, first, x):
        line = np.array([x])
        return read(table, first, line.view(np.int64)[0])

    x, first = nodes(-3, 5), first_of(-3)
    table = 1 / x
    assert len(x) == 8 * 128 + 1 and x[0] == 0.125 and x[-1] == 32.0
    assert look(table, first, x[77]) == table[77]
    for value in np.random.default_rng(1).uniform(0.125, 32, 200):
        assert look(table, first, value) == pytest.approx(1 / value, rel=2.0**-14 / 4 * 1.01)
    assert look(table, first, 0.0) == look(table, first, 1e-9) == 8.0
    assert look(table, first, 1e9) == 1 / 32


@pytest.mark.parametrize(
    "index, closed", [(0.5, lambda k, b: np.exp(-(k**2) / (4 * b))), (1.0, lambda k, b: (1 + (k / b) ** 2) ** -1.5)]
)
def test_transforms_with_a_closed_form(index, closed):
    transform, outer = tables(index, np.inf)
    assert np.abs(transform - closed(K, float(sersic_b(index)))).max() < 1e-8
    assert not outer.any()


@pytest.mark.parametrize("index", [0.3, 0.7, 2.5, 4.0, 6.2])
def test_transforms_are_galsims(index):
    """To 1e-5, GalSim's own accuracy asked for; its table for n = 0.3 is off by 1.4e-5."""
    transform, _ = tables(index, np.inf)
    profile = galsim.Sersic(index, half_light_radius=1.0, gsparams=galsim.GSParams(kvalue_accuracy=1e-7))
    some = np.flatnonzero((K > 1e-3) & (K < 1e3))[::40]
    theirs = np.array([profile.kValue(k, 0.0).real for k in K[some]])
    assert np.abs(transform[some] - theirs).max() < (2e-5 if index < 0.5 else 1e-5)
    assert transform[0] == pytest.approx(1.0, abs=1e-5)


@pytest.mark.parametrize("index, cut", [(0.7, 1.5), (1.0, 4.0), (4.0, 8.0), (6.2, 0.5)])
def test_a_split_profile_is_the_whole(index, cut):
    """Their light is 1; the inner transform is its integral; the outer part begins at half the cut."""
    transform, outer = tables(index, cut)
    r = np.exp(np.linspace(-20, 20, 400_001))
    rest = np.interp(r * r, SQUARE, outer, right=0.0)
    light = np.trapezoid(2 * np.pi * r * r * rest, np.log(r))
    assert transform[0] + light == pytest.approx(1.0, abs=2e-5)
    assert not outer[(0.5 * cut) ** 2 > SQUARE].any()
    far = (cut**2 < SQUARE) & ((2 * cut) ** 2 > SQUARE)
    assert outer[far] == pytest.approx(brightness(np.sqrt(SQUARE[far]), index))
    for k in (0.3, 2.0, 9.0):

        def ring(log_r, k=k):
            r = np.exp(log_r)
            t = np.clip(2 * r / cut - 1, 0, 1)
            return 2 * np.pi * r * r * j0(k * r) * brightness(r, index) * (1 - t**3 * (10 - 15 * t + 6 * t * t))

        value = sum(quad(ring, *ends, limit=300)[0] for ends in ((-25, np.log(cut / 2)), np.log([cut / 2, cut])))
        assert np.interp(k, K, transform) == pytest.approx(value, abs=5e-5)


@pytest.mark.parametrize("index", [0.3, 1.0, 4.0, 6.2])
def test_the_radius_of_a_brightness_is_galsims(index):
    """GalSim's profile has that brightness there; one that is fainter in the middle has no such radius."""
    profile = galsim.Sersic(index, half_light_radius=1.0)
    for limit in (1e-3, 0.05):
        radius = brightness_radius(limit, index)
        assert profile.xValue(0.0, radius) == pytest.approx(limit, rel=1e-4)
    assert brightness_radius(2 * brightness(0.0, index), index) == 0.0


@pytest.mark.parametrize("index", [0.5, 1.0, 2.5, 4.0, 6.2])
@pytest.mark.parametrize("fraction", [0.1, 0.5, 0.9, 0.99])
def test_the_radius_of_a_fraction_of_the_light_is_galsims(index, fraction):
    radius = radius_of(fraction, index)
    galaxy = galsim.Sersic(index, half_light_radius=1.0)
    within, _ = quad(lambda r: 2 * np.pi * r * galaxy.xValue(r, 0.0), 0.0, radius, points=[1e-4, 1e-2], limit=500)
    assert within == pytest.approx(fraction, abs=1e-4)


def test_the_light_beyond_a_radius_of_any_index_is_the_incomplete_gamma_function():
    """Between the nodes of the table, too: to 1% of it and 1e-9 of all; disks and bulges by series."""
    rng = np.random.default_rng(8)
    index = np.concatenate([rng.uniform(0.31, 6.1, 4000), [1.0, 4.0, 1.0]])
    radius, half = np.exp(rng.uniform(-5, 4, 4003)), rng.uniform(0.1, 2.0, 4003)
    exact = gammaincc(2 * index, gammaincinv(2 * index, 0.5) * (radius / half) ** (1 / index))
    assert light_beyond(radius, half, index) == pytest.approx(exact, rel=0.01, abs=1e-9)


def test_a_profile_ends_where_its_light_does():
    x = float(sersic_b(1.0)) * extent(1.0)
    assert (1 + x) * np.exp(-x) == pytest.approx(5e-5)  # the light beyond a disk's radius
    assert cut_for(1.0, 7.5) == np.inf and cut_for(1.0, 3.3) == pytest.approx(2**1.75)
    assert 3.3 <= cut_for(4.0, 3.3) <= 3.3 * 2**0.25


@pytest.mark.parametrize("index", [0.5, 1.0, 2.0, 4.0, 5.5])
def test_the_light_beyond_a_radius_of_one_index(index):
    """A number in place of an array of indices: exact, but for what a disk's and a bulge's b is rounded to."""
    radius, half = np.array([0.0, 0.3, 1.0, 4.0]), np.array([0.5, 0.5, 1.0, 0.8])
    exact = gammaincc(2 * index, gammaincinv(2 * index, 0.5) * (radius / half) ** (1 / index))
    assert light_beyond(radius, half, index) == pytest.approx(exact, rel=1e-5)
    assert light_beyond(1.0, 1.0, index) == pytest.approx(0.5, rel=1e-6)
    assert light_beyond(1.0, 0.0, index) < 1e-9  # of a point


def test_indices_that_have_a_series_and_others_may_be_mixed():
    index = np.array([4.0, 2.2, 1.0, 1.0, 4.0])
    radius, half = np.array([2.0, 3.0, 1.5, 0.2, 0.1]), np.array([1.0, 2.0, 0.5, 0.4, 0.3])
    found = light_beyond(radius, half, index)
    for k in (0, 2, 3, 4):
        assert found[k] == light_beyond(radius[k], half[k], index[k])
    assert found[1] == pytest.approx(gammaincc(4.4, gammaincinv(4.4, 0.5) * 1.5 ** (1 / 2.2)), rel=1e-3)
    far = light_beyond(np.array([1e9, 1e-9]), np.ones(2), np.array([2.2, 2.2]))  # beyond either end of the table
    assert far == pytest.approx([0.0, 1.0], abs=1e-3)


@pytest.mark.parametrize("index", [0.5, 2.0, 4.0])
def test_a_profile_ends_with_five_in_a_hundred_thousand_of_its_light_beyond(index):
    assert gammaincc(2 * index, gammaincinv(2 * index, 0.5) * extent(index) ** (1 / index)) == pytest.approx(5e-5)
    assert cut_for(index, extent(index)) == np.inf and np.isfinite(cut_for(index, 0.7 * extent(index)))


def test_a_cut_of_next_to_nothing_leaves_all_of_the_profile_outside():
    assert cut_for(1.0, 0.0) == cut_for(1.0, 1e-9) == CUT_NONE == 2.0**-10
    assert cut_for(1.0, 1.0) == 1.0 and cut_for(1.0, 1.01) == pytest.approx(2**0.25)
    transform, outer = tables(1.0, CUT_NONE)
    assert not transform.any()
    assert outer == pytest.approx(1.678347**2 / (2 * np.pi) * np.exp(-1.678347 * np.sqrt(SQUARE)), rel=1e-6, abs=1e-9)


def test_the_light_beyond_is_interpolated_to_the_ends_of_the_table():
    """Radii to the last node and to the first, and indices to either limit."""
    rng = np.random.default_rng(9)
    for low, high in ((INDEX_MIN, INDEX_MIN * 1.004), (INDEX_MAX / 1.004, INDEX_MAX)):
        index = rng.uniform(low, high, 400)
        ratio = np.exp(rng.uniform(-5, 4, 400))
        exact = gammaincc(2 * index, gammaincinv(2 * index, 0.5) * ratio ** (1 / index))
        assert light_beyond(ratio, np.ones(400), index) == pytest.approx(exact, rel=0.05, abs=1e-9)
    index = np.full(200, 5.5)
    ratio = np.exp(sersic._LOG_RATIO[-1] - rng.uniform(0, 2, 200) * np.diff(sersic._LOG_RATIO)[0])
    exact = gammaincc(2 * index, gammaincinv(2 * index, 0.5) * ratio ** (1 / index))
    assert light_beyond(ratio, np.ones(200), index) == pytest.approx(exact, rel=2e-3, abs=0)
