"""Shear by haloes: sign, size, distances, compensation, the sphere's curvature."""

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.special import eval_legendre, j0, lpmv
from universe.structure.small_matter import COSMOLOGY, NUMBERS

from csstsim.base.sphere import ra_dec, unit_vectors
from csstsim.universe.lensing.cosmology import Cosmology
from csstsim.universe.lensing.power_spectrum import MatterPower
from csstsim.universe.structure.halo_lensing import halo_lenses, halo_shear
from csstsim.universe.structure.halo_profile import disc_transform, halo_transform, nfw_mass, whole_mass
from csstsim.universe.structure.mass_function import HaloMassFunction

SHIPPED = NUMBERS["haloes"]
CUTS = SHIPPED["cuts"]
NUMBERS = NUMBERS | {"haloes": SHIPPED | {"compensation": {"mass": [1e13], "ratio": [2.0]}}}
DISC = 2.0
PLACES = {"common": (123.0, -41.0), "RA 0": (0.0, 10.0), "pole": (40.0, 90.0)}


@pytest.fixture(scope="module")
def masses():
    cosmology = Cosmology(COSMOLOGY)
    return HaloMassFunction(cosmology, MatterPower(cosmology, COSMOLOGY))


def halo(position, z=0.4, log_mass=14.3, c=5.0):
    ra, dec = position
    return {"ra": [ra], "dec": [dec], "z": [z], "log_mass": [log_mass], "concentration": [c]}


def lenses(masses, *haloes, numbers=NUMBERS["haloes"]):
    joined = {name: np.concatenate([one[name] for one in haloes]) for name in haloes[0]}
    return halo_lenses(joined, masses, numbers)


def around(position, theta, phi):
    """Return ra, dec [deg] at angles theta [rad] from a position, in directions phi of an arbitrary frame."""
    n = unit_vectors(*position)
    first = np.cross(n, [0.6, 0.0, 0.8])
    first /= np.linalg.norm(first)
    side = np.cos(phi)[:, None] * first + np.sin(phi)[:, None] * np.cross(n, first)
    return ra_dec(np.cos(theta)[:, None] * n + np.sin(theta)[:, None] * side)


def turned(position, ra, dec, gamma1, gamma2):
    """Return tangential and cross shear about a position, from its bearing at each source."""
    a, d, a0, d0 = np.radians([ra, dec, np.full_like(ra, position[0]), np.full_like(ra, position[1])])
    east = np.cos(d0) * np.sin(a0 - a)
    north = np.sin(d0) * np.cos(d) - np.cos(d0) * np.sin(d) * np.cos(a0 - a)
    phi = np.arctan2(north, east)
    return -gamma1 * np.cos(2 * phi) - gamma2 * np.sin(2 * phi), gamma1 * np.sin(2 * phi) - gamma2 * np.cos(2 * phi)


def surface(masses, r, log_mass, c):
    """Surface density over the mean density [Mpc] at comoving r [Mpc]: spheres by integration, less the disc."""
    mass, virial = 10**log_mass / masses.density, masses.virial_radius(10**log_mass)
    scale, disc = virial / c, DISC * masses.lagrangian_radius(10**log_mass)
    peak = mass / (4 * np.pi * scale**3 * nfw_mass(c))
    sigma = 0.0
    for edge in (t * virial for t in CUTS):
        part = 1 / len(CUTS)
        if r < edge:
            end = np.sqrt(edge**2 - r**2)
            sphere = quad(lambda s: peak / (np.hypot(r, s) / scale) / (1 + np.hypot(r, s) / scale) ** 2, 0, end)[0]
            sigma += 2 * part * sphere
        whole = part * mass * nfw_mass(edge / scale) / nfw_mass(c)
        sigma -= 4 * whole / (np.pi * disc**2) * max(1 - (r / disc) ** 2, 0.0) ** 3
    return sigma


@pytest.mark.parametrize("name", PLACES)
def test_tangential_shear_of_a_halo_by_integration(masses, name):
    position, z, z_source = PLACES[name], 0.4, 1.1
    cosmology = masses.cosmology
    chi, source = float(cosmology.comoving_distance(z)), float(cosmology.comoving_distance(z_source))
    critical = 1.5 * 0.3111 * (67.66 / 299792.458) ** 2 * (1 + z) * chi * (1 - chi / source)
    radii = np.array([0.05, 0.9, 2.5, 3.1, 19.0])  # Mpc, comoving; the spheres end at 1.5, 2.3, 3.4, the disc at 21.4
    phi = np.linspace(0.3, 6.0, len(radii))
    ra, dec = around(position, radii / chi, phi)
    kappa, *gamma = halo_shear(lenses(masses, halo(position)), ra, dec, np.full(len(radii), source))
    tangential, cross = turned(position, ra, dec, *gamma)
    expected = [surface(masses, r, 14.3, 5.0) for r in radii]
    ends = [t * masses.virial_radius(10**14.3) for t in CUTS]
    means = [
        2 / r**2 * quad(lambda s: s * surface(masses, s, 14.3, 5.0), 0, r, epsrel=1e-3, limit=200,
                        points=[0.5 * r, *(end for end in ends if end < r)])[0]
        for r in radii
    ]  # fmt: skip
    peak = critical * expected[0]
    np.testing.assert_allclose(kappa, critical * np.array(expected), rtol=1e-3, atol=1e-4 * peak)
    np.testing.assert_allclose(tangential, critical * np.subtract(means, expected), rtol=2e-3, atol=1e-5 * peak)
    np.testing.assert_allclose(cross, 0.0, atol=1e-9)
    assert (tangential > 0).all()


def test_nothing_beyond_the_disc_nor_before_the_halo(masses):
    position = PLACES["common"]
    chi = float(masses.cosmology.comoving_distance(0.4))
    disc = DISC * float(masses.lagrangian_radius(10**14.3)) / chi
    ra, dec = around(position, disc * np.array([0.999, 1.001, 0.1, 0.1, 0.1, 0.1]), np.arange(6.0))
    source = np.array([2 * chi, 2 * chi, 0.999999 * chi, 0.5 * chi, 0.0, np.nan])
    kappa, gamma1, gamma2 = halo_shear(lenses(masses, halo(position)), ra, dec, source)
    assert kappa[0] != 0 and gamma1[0] != 0
    for column in (kappa, gamma1, gamma2):
        assert not column[1:].any()


def test_mass_is_conserved(masses):
    """The mean convergence over the disc, on rings of equal area."""
    position, chi = PLACES["RA 0"], float(masses.cosmology.comoving_distance(0.1))
    disc = DISC * float(masses.lagrangian_radius(10**14.3)) / chi
    fraction = np.linspace(0, 1, 40001)[1:] ** 4  # of the disc's area
    weight = np.gradient(fraction)
    ra, dec = around(position, 2 * np.arcsin(0.5 * disc * np.sqrt(fraction)), np.full(len(fraction), 1.0))
    kappa = halo_shear(lenses(masses, halo(position, z=0.1)), ra, dec, np.full(len(fraction), 3000.0))[0]
    assert abs((kappa * weight).sum()) < 2e-4 * (np.abs(kappa) * weight).sum()


@pytest.mark.parametrize("log_mass", [12.7, 13.5, 14.3, 14.9])
def test_transform_of_a_lens_is_that_of_the_spectra(masses, log_mass):
    """The sphere and the disc of each mass are those of halo_spectra; the sphere's mass gives the scale."""
    position, z, source, c = PLACES["common"], 0.4, 2500.0, 5.0
    chi, radius = float(masses.cosmology.comoving_distance(z)), masses.lagrangian_radius(10**log_mass)
    shape = SHIPPED["compensation"]
    disc = np.interp(log_mass, np.log10(shape["mass"]), shape["ratio"]) * radius
    theta = np.geomspace(1e-6, 1.001 * disc / chi, 30000)
    ra, dec = around(position, theta, np.zeros(len(theta)))
    lens = lenses(masses, halo(position, z, log_mass, c), numbers=SHIPPED)
    kappa = halo_shear(lens, ra, dec, np.full(len(theta), source))[0]
    volume = 10**log_mass / masses.density * whole_mass(c, CUTS)
    flux = 1.5 * 0.3111 * (67.66 / 299792.458) ** 2 * (1 + z) / chi * (1 - chi / source) * volume
    for k in (0.3, 1.0, 3.0):
        found = 2 * np.pi * np.trapezoid(theta**2 * kappa * j0(k * chi * theta), np.log(theta))
        expected = halo_transform(k, masses.virial_radius(10**log_mass), c, CUTS) - disc_transform(k, disc)
        assert found / flux == pytest.approx(expected, abs=2e-3)


def test_shear_on_the_sphere_by_harmonics(masses):
    """A disc of 20 deg: gamma_t = sum (2l + 1) / 4 pi kappa_l / (l (l + 1)) P_l^2, from the convergence alone."""
    z, mass = 0.03, 15.69
    chi, source = float(masses.cosmology.comoving_distance(z)), 3000.0
    disc = DISC * float(masses.lagrangian_radius(10**mass)) / chi
    assert np.degrees(disc) > 20
    theta = np.concatenate([np.geomspace(1e-6, 0.03, 2000), np.linspace(0.03, 1.001 * disc, 1000)[1:]])
    some = lenses(masses, halo(PLACES["pole"], z=z, log_mass=mass))
    kappa = halo_shear(some, np.zeros(len(theta)), 90 - np.degrees(theta), np.full(len(theta), source))[0]
    ell = np.arange(2, 300)
    at = np.array([0.1, 0.2, 0.3])
    ra, dec = np.full(3, 77.0), 90 - np.degrees(at)
    tangential, _ = turned((0.0, 90.0), ra, dec, *halo_shear(some, ra, dec, np.full(3, source))[1:])
    expected = np.zeros(3)
    for degree in ell:
        part = 2 * np.pi * np.trapezoid(kappa * eval_legendre(degree, np.cos(theta)) * np.sin(theta), theta)
        part *= np.exp(-((degree / 150) ** 4))  # leaves what is smooth as it is, and ends the series of the core
        expected += (2 * degree + 1) / (4 * np.pi) * part / (degree * (degree + 1)) * lpmv(2, degree, np.cos(at))
    np.testing.assert_allclose(tangential, expected, rtol=5e-3, atol=3e-4 * tangential[0])


def test_haloes_add_in_any_order_of_sources(masses):
    near, far = halo((123.0, -41.0)), halo((123.1, -41.05), z=0.7, log_mass=13.5)
    rng = np.random.default_rng(1)
    ra, dec, chi = rng.uniform(122.8, 123.3, 300), rng.uniform(-41.2, -40.8, 300), rng.uniform(0, 6000, 300)
    both = halo_shear(lenses(masses, near, far), ra, dec, chi)
    apart = halo_shear(lenses(masses, near), ra, dec, chi) + halo_shear(lenses(masses, far), ra, dec, chi)
    np.testing.assert_allclose(both, apart, atol=1e-15)
    order = rng.permutation(300)[:100]
    np.testing.assert_array_equal(
        halo_shear(lenses(masses, near, far), ra[order], dec[order], chi[order]), both[:, order]
    )
    assert halo_shear(lenses(masses, near), [], [], np.zeros(0)).shape == (3, 0)
