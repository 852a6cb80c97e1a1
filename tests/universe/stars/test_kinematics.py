"""Motions, against astropy's transformations and the ellipsoids."""

import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import CartesianDifferential, CartesianRepresentation, Galactic, SkyCoord

from csstsim.base.shipped import SHIPPED
from csstsim.instrument.load import read_data
from csstsim.universe.stars.kinematics import galactic_velocity, sky_motion
from csstsim.universe.stars.milky_way import components, direction

NUMBERS = read_data(SHIPPED / "universe" / "stars.yaml")
BY_NAME = {component.name: component for component in components(NUMBERS)}
SUN = np.array(NUMBERS["sun"]["motion"])


def test_projection_against_astropy():
    rng = np.random.default_rng(3)
    ra = np.concatenate([[0.0, 359.999, 192.86], rng.uniform(0, 360, 100)])
    dec = np.concatenate([[89.9, -89.9, 27.13], np.degrees(np.arcsin(rng.uniform(-1, 1, 100)))])
    kpc = 10 ** rng.uniform(-2, 1.5, len(ra))
    velocity = rng.normal(0, 100, (3, len(ra)))
    position = CartesianRepresentation(direction(ra, dec) * kpc * u.kpc)
    motion = CartesianDifferential(velocity * u.km / u.s)
    reference = SkyCoord(Galactic(position.with_differentials(motion))).icrs
    pmra, pmdec, rv = sky_motion(ra, dec, kpc, velocity)
    # The two frames are 0.1 arcsec apart: 5e-7 of the velocity, more near the pole, where axes turn.
    scale = 1000 / (4.74 * kpc)
    np.testing.assert_allclose(pmra, reference.pm_ra_cosdec.to_value(u.mas / u.yr), atol=1e-3 * scale.max(), rtol=1e-3)
    assert (np.abs(pmra - reference.pm_ra_cosdec.to_value(u.mas / u.yr)) < 3e-4 * scale).all()
    assert (np.abs(pmdec - reference.pm_dec.to_value(u.mas / u.yr)) < 3e-4 * scale).all()
    np.testing.assert_allclose(rv, reference.radial_velocity.to_value(u.km / u.s), atol=1e-3)


@pytest.mark.parametrize("name", ["thin2", "thin7", "thick", "halo"])
def test_ellipsoid_at_the_sun(name):
    component = BY_NAME[name]
    normal = np.random.default_rng(4).standard_normal((3, 40000))
    v = galactic_velocity(component, normal, np.zeros((3, 40000)), NUMBERS)
    sigma = np.array([component.sigma_u, component.sigma_v, component.sigma_w])
    np.testing.assert_allclose(v.std(axis=1), sigma, rtol=5 / np.sqrt(80000))
    # Asymmetric drift: some 53 km/s for the thick disc, the halo does not turn.
    lag = {"thin2": 5, "thin7": 23, "thick": 56, "halo": NUMBERS["circular"]}[name]
    np.testing.assert_allclose(v.mean(axis=1) + SUN, [0, -lag, 0], atol=5 * sigma.max() / 200 + 1)


def test_cold_disc_shows_oort_constants():
    """A flat rotation curve: rv = A d sin 2l and 4.74 pm_l = A cos 2l + B for d << R0, A = -B = V / 2 R0."""
    cold = BY_NAME["thin1"]
    l = np.radians(np.array([0.0, 30.0, 45.0, 90.0, 200.0, 315.0]))  # noqa: E741
    kpc, zero = 0.01, np.zeros((3, 6))
    here = np.stack([np.cos(l), np.sin(l), 0 * l])
    v = galactic_velocity(cold, zero, kpc * here, NUMBERS)
    v[1] += cold.sigma_u**2 / NUMBERS["drift"]  # the direction of the lag depends on the position: negligible
    v += SUN[:, None]
    oort = NUMBERS["circular"] / (2 * NUMBERS["sun"]["r0"])
    along = np.stack([-np.sin(l), np.cos(l), 0 * l])
    np.testing.assert_allclose((v * here).sum(axis=0), oort * kpc * np.sin(2 * l), atol=5e-3)
    np.testing.assert_allclose((v * along).sum(axis=0), oort * kpc * (np.cos(2 * l) - 1), atol=5e-3)


def test_reflex_of_the_sun():
    """Stars at rest in the Galaxy at the pole move by the Sun's motion backwards."""
    halo = BY_NAME["halo"]
    v = galactic_velocity(halo, np.zeros((3, 1)), np.array([[0.0], [0.0], [2.0]]), NUMBERS)[:, 0]
    np.testing.assert_allclose(v, -SUN - [0, NUMBERS["circular"], 0], atol=1e-9)


def test_the_galactic_centre_and_far_stars_are_finite():
    position = np.array([[NUMBERS["sun"]["r0"], 1e-12, 1e6], [0.0, 0.0, 0.0], [0.0, 0.0, 1e6]])
    for component in BY_NAME.values():
        v = galactic_velocity(component, np.ones((3, 3)), position, NUMBERS)
        assert np.isfinite(v).all() and np.abs(v).max() < 1500
