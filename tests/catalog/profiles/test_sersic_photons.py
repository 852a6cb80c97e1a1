"""Radii of Sersic profiles against the gamma distribution of their light."""

import numba
import numpy as np
import pytest
from scipy import stats
from scipy.special import gammainc, gammaincinv, gammaln

from csstsim.base.counter import word
from csstsim.catalog.profiles.sersic_photons import RINGED, RINGS, ring, rings_for

RANDOM = 200_000  # draws
P_VALUE = 1e-5  # 4.4 sigma


@numba.njit
def rings(which, n):
    r = np.empty(n)
    for i in range(n):
        r[i] = ring(RINGS, which, 0.0, word(np.uint64(17), np.uint64(i)))
    return r


@numba.njit
def ring_of(which, bits, table=RINGS, share=0.0):
    r = np.empty(len(bits))
    for i in range(len(bits)):
        r[i] = ring(table, which, share, bits[i])
    return r


def ring_edges():
    octave, step = np.divmod(np.arange(1025), 32)
    return 2.0 ** (octave - 1) * (1 + step / 32)


def mean_square(one):
    """Return <r^2> of rings (2, rings, 2), summed over them."""
    edges = ring_edges()
    return ((one[..., 0] + one[..., 1] * (edges[1:] + edges[:-1]) / 2) * np.diff(edges)).sum() / 2**32


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
    assert mean_square(RINGS[which]) == pytest.approx(exact, rel=1e-5)
    edges = ring_edges()
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


# n = 0.3113 lies in the middle between the first two nodes, 2.5 and 5.1 anywhere, 6.2 beyond the last but one
FREE = [0.3, 0.3113, 0.5, 1.5, 2.5, 3.999, 5.1, 6.2]


@pytest.mark.parametrize("n", FREE)
def test_any_index_has_the_light_and_size_of_its_profile(n):
    """Enclosed light by Kolmogorov and Smirnov; <r^2> of the rings by their own closed form, within 6e-5."""
    all_rings, which, share = rings_for(np.array([n]))
    b, bits = gammaincinv(2 * n, 0.5), np.random.default_rng(3).integers(0, 2**63, RANDOM).astype(np.uint64)
    r = ring_of(int(which[0]), bits, all_rings, float(share[0]))
    assert stats.kstest(r, lambda r: gammainc(2 * n, b * r ** (1 / n))).pvalue > P_VALUE
    exact = np.exp(gammaln(4 * n) - gammaln(2 * n)) / b ** (2 * n)
    near, far = (mean_square(all_rings[which[0] + k]) for k in range(2))
    assert near + share[0] * (far - near) == pytest.approx(exact, rel=6e-5)  # 2^-33 of the light is beyond


@pytest.mark.parametrize("n", FREE)
def test_interpolated_rings_enclose_the_light_to_1e_4(n):
    """Against the inverse of the light, at shares from 1e-5 to 1 - 1e-5, as a share of the total."""
    all_rings, which, share = rings_for(np.array([n]))
    t = np.random.default_rng(5).integers(2**16, 2**31, 4000).astype(np.uint64)
    r = ring_of(int(which[0]), t, all_rings, float(share[0]))
    assert np.abs(gammainc(2 * n, gammaincinv(2 * n, 0.5) * r ** (1 / n)) - (t + 0.5) / 2**32).max() < 2e-4


def test_rings_of_a_disk_and_a_bulge_are_not_interpolated():
    found, which, share = rings_for(np.array([[1.0, 4.0], [0.0, 1.0]]))
    assert found is RINGS and which.tolist() == [[0, 1], [-1, 0]] and not share.any()
    more, both, _ = rings_for(np.array([1.0, 4.0, 2.0]))
    assert both[:2].tolist() == [0, 1] and np.array_equal(more[:2], RINGS)


@pytest.mark.parametrize("n", [0.29, 6.3, np.nan, -1.0])
def test_an_index_without_rings_is_an_error(n):
    with pytest.raises(ValueError, match="Sersic index"):
        rings_for(np.array([1.0, n]))
