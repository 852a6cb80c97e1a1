"""Radii of Sersic profiles against the gamma distribution of their light."""

import numba
import numpy as np
import pytest
from scipy import stats
from scipy.special import gammainc, gammaincinv, gammaln

from csstsim.base.counter import word
from csstsim.profiles.sersic_photons import RINGED, RINGS, gamma, ring

RANDOM = 200_000  # draws
P_VALUE = 1e-5  # 4.4 sigma


@numba.njit
def rings(which, n):
    r = np.empty(n)
    for i in range(n):
        r[i] = ring(which, word(np.uint64(17), np.uint64(i)))
    return r


@numba.njit
def ring_of(which, bits):
    r = np.empty(len(bits))
    for i in range(len(bits)):
        r[i] = ring(which, bits[i])
    return r


@numba.njit
def gammas(shape, n):
    x, counter = np.empty(n), np.uint64(0)
    for i in range(n):
        x[i], counter = gamma(shape, np.uint64(23), counter)
    return x


@pytest.mark.parametrize("which", range(len(RINGED)))
def test_rings_have_the_light_of_the_profile(which):
    n = RINGED[which]
    b = gammaincinv(2 * n, 0.5)
    r = rings(which, RANDOM)
    assert stats.kstest(r, lambda r: gammainc(2 * n, b * r ** (1 / n))).pvalue > P_VALUE


@pytest.mark.parametrize("which", range(len(RINGED)))
def test_rings_are_the_inverse_of_the_light(which):
    """At any share of the light, from 1e-9 of it to all but 1e-9, r^2 is within 5e-4."""
    n = RINGED[which]
    b = gammaincinv(2 * n, 0.5)
    t = np.concatenate([2.0 ** np.arange(2, 31), np.random.default_rng(5).integers(2**8, 2**31, 2000)]).astype(
        np.uint64
    )
    for side, sign in ((0, 1), (2**31, -1)):
        light = (t.astype(float) + 0.5) / 2**32
        if sign > 0:
            exact = (gammaincinv(2 * n, light) / b) ** n
        else:
            exact = (stats.gamma.isf(light, 2 * n) / b) ** n
        assert np.abs((ring_of(which, t + np.uint64(side)) / exact) ** 2 - 1).max() < 5e-4


@pytest.mark.parametrize("which", range(len(RINGED)))
def test_rings_have_the_size_of_the_profile(which):
    """<r^2>, summed over the rings, is Gamma(4n) / Gamma(2n) / b^2n but for the 2^-33 of the light beyond them."""
    n = RINGED[which]
    exact = np.exp(gammaln(4 * n) - gammaln(2 * n)) / gammaincinv(2 * n, 0.5) ** (2 * n)
    octave, step = np.divmod(np.arange(1025), 32)
    edges = 2.0 ** (octave - 1) * (1 + step / 32)
    width, middle = np.diff(edges), (edges[1:] + edges[:-1]) / 2
    square = (RINGS[which, ..., 0] + RINGS[which, ..., 1] * middle) * width / 2**32
    assert square.sum() == pytest.approx(exact, rel=1e-5)
    ends = (
        RINGS[which, ..., 0] + RINGS[which, ..., 1] * edges[:-1],
        RINGS[which, ..., 0] + RINGS[which, ..., 1] * edges[1:],
    )
    assert min(end.min() for end in ends) >= 0


def test_rings_are_finite_at_the_ends():
    ends = np.array([0, 2**31 - 1, 2**31, 2**32 - 1, 2**64 - 1], np.uint64)
    for which in range(len(RINGED)):
        r = ring_of(which, ends)
        assert np.isfinite(r).all() and (r > 0).all() and r.argmax() == 2
        assert r[[1, 3, 4]] == pytest.approx(1.0, rel=1e-3)  # half the light


@pytest.mark.parametrize("n", [0.3, 0.5, 1.0, 2.5, 4.0, 6.2])
def test_gamma_numbers(n):
    x = gammas(2 * n, RANDOM)
    assert stats.kstest(x, "gamma", args=(2 * n,)).pvalue > P_VALUE
    assert abs(x.mean() - 2 * n) < 5 * np.sqrt(2 * n / RANDOM)
