"""Laws of intrinsic alignment: signs, mean ellipticities, what stays."""

import numpy as np
import pytest
from support.embedded_sky import shipped

from csstsim.universe.galaxies.alignments import radial_alignment, sheared, tidal_alignment, turned_to


@pytest.fixture(scope="module")
def numbers():
    return shipped()[0].numbers["occupation"]["alignment"]


def test_a_mean_ellipticity_is_composed_as_a_shear():
    """Round becomes g; the mean of a ring of equal |e| is g (Seitz & Schneider 1997); the inverse takes it back."""
    ring = 0.6 * np.exp(2j * np.pi * np.arange(64) / 64)
    g = 0.03 - 0.02j
    assert sheared(np.zeros(1), g)[0] == g
    assert sheared(ring, g).mean() == pytest.approx(g, abs=1e-12)
    np.testing.assert_allclose(sheared(sheared(ring, g), -g), ring, atol=1e-12)
    assert (np.abs(sheared(0.99 * ring / 0.6, g)) < 1).all()


def test_red_galaxies_point_to_an_overdensity(numbers):
    """Round an overdensity shear is tangential, gamma = -|gamma| exp(2 i phi); the alignment is radial."""
    cosmology = shipped()[0].cosmology
    phi = np.array([0.0, 0.7, 2.0])
    g = tidal_alignment(np.zeros(3), -np.exp(2j * phi), cosmology, numbers)
    np.testing.assert_allclose(g, 3.18 * 0.0134 * 0.3111 * np.exp(2j * phi), rtol=1e-12)
    far = tidal_alignment(np.array([3.0]), np.array([1.0 + 0j]), cosmology, numbers)
    assert abs(far[0]) == pytest.approx(abs(g[0]) / cosmology.growth(3.0))


def test_satellites_point_to_their_centre(numbers):
    east, north = np.array([1.0, 0.0, -1.0, 0.0]), np.array([0.0, 2.0, 1.0, 0.0])
    wanted = numbers["radial"] * np.array([1.0, -1.0, -1j, 0.0])
    np.testing.assert_allclose(radial_alignment(east, north, numbers), wanted, atol=1e-15)


def test_centrals_lie_along_their_halo(numbers):
    e = 0.3 * np.exp(1j * np.linspace(0, 6, 5))
    turned = turned_to(e, np.full(5, 0.1), np.full(5, 0.1), np.zeros(5), numbers)
    np.testing.assert_allclose(turned, 0.3j, atol=1e-12)
    off = turned_to(e, np.ones(5), np.zeros(5), np.full(5, 1.0), numbers)
    np.testing.assert_allclose(np.angle(off) / 2, np.radians(numbers["central_angle"]))
