"""The halo as a lens: closed forms against integrals of the density, and their transforms."""

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.special import j0

from csstsim.universe.structure.halo_profile import (
    disc_transform,
    halo_transform,
    nfw_mass,
    nfw_projected,
    nfw_transform,
    whole_mass,
)


def column(x, c):
    """F by integration of 1 / (r (1 + r)^2) along half the line of sight, r from 0 to c."""
    end = np.sqrt(c * c - x * x)
    return quad(lambda s: 1 / (np.hypot(x, s) * (1 + np.hypot(x, s)) ** 2), 0, end, epsabs=0, epsrel=1e-10, limit=200)[
        0
    ]


def projected(x, *cuts):
    cuts = np.array(cuts)
    return nfw_projected(x, cuts, nfw_mass(cuts))


@pytest.mark.parametrize("c", [1.2, 4.0, 15.0])
def test_projected_sphere_against_integrals(c):
    for x in (0.03, 0.4, 0.9, 0.9995, 1.0, 1.0005, 1.1, 0.98 * c):
        f, g = projected(x, c)
        inside = quad(lambda r: 2 * r * projected(r, c)[0], 0, x, points=[0.5 * x], epsrel=1e-9, limit=200)[0] / x**2
        assert f == pytest.approx(column(x, c) if x < c else 0.0, rel=1e-5)
        assert f + g == pytest.approx(inside, rel=1e-5)


def test_mass_lies_within_the_cut():
    f, g = projected(7.0, 5.0)
    assert f == 0.0 and g == pytest.approx(2 * nfw_mass(5.0) / 49)
    assert np.isfinite(projected(0.0, 5.0)).all() and np.isfinite(projected(1.0, 0.7)).all()


@pytest.mark.parametrize("cuts", [(0.6, 2.0, 7.0), (9.0, 30.0, 80.0, 300.0)])
def test_spheres_of_several_cuts_add_up(cuts):
    for x in (1e-3, 0.01, 0.59, 0.61, 0.998, 1.0, 1.004, 1.99, 2.01, 6.9, 7.1, 29.0):
        assert projected(x, *cuts) == pytest.approx(np.sum([projected(x, cut) for cut in cuts], axis=0), rel=1e-8)


@pytest.mark.parametrize("c", [2.0, 9.0])
def test_transform_of_the_sphere(c):
    r = np.linspace(1e-7, c, 400001)
    for k in (1e-3, 0.3, 2.0, 20.0):
        expected = np.trapezoid(r / (1 + r) ** 2 * np.sinc(k * r / c / np.pi), r) / nfw_mass(c)
        assert nfw_transform(k, 1.0, c) == pytest.approx(expected, abs=1e-7)


def test_a_halo_ends_in_steps():
    """Mass and transform by integration of the density that is left beyond each cut."""
    c, cuts, r = 5.0, (0.8, 1.3, 2.0), np.linspace(1e-7, 2.0, 400001)  # over the virial radius
    fraction = np.select([r < cuts[0], r < cuts[1]], [1.0, 2 / 3], 1 / 3)
    mass = r * c**2 / (1 + r * c) ** 2 * fraction / nfw_mass(c)
    assert whole_mass(c, cuts) == pytest.approx(np.trapezoid(mass, r), rel=1e-5)
    for k in (0.0001, 0.4, 3.0, 20.0):
        expected = np.trapezoid(mass * np.sinc(k * r * 1.5 / np.pi), r) / np.trapezoid(mass, r)
        assert halo_transform(k, 1.5, c, cuts) == pytest.approx(expected, abs=1e-5)
    assert whole_mass(c, (1.0,)) == 1.0 and halo_transform(0.4, 1.5, c, (1.0,)) == nfw_transform(0.4, 1.5, c)


def test_transform_of_the_disc():
    y = np.linspace(0, 1, 100001)
    for k in (0.0, 0.03, 0.0999, 0.1001, 2.0, 11.0):
        expected = np.trapezoid(8 * y * (1 - y * y) ** 3 * j0(k * y), y)
        assert disc_transform(k, 1.0) == pytest.approx(expected, abs=1e-6)
