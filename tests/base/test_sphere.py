"""Directions on the sphere against astropy, closed forms, and points counted inside polygons."""

import numpy as np
import pytest
from astropy import units
from astropy.coordinates import SkyCoord

from csstsim.base import sphere
from csstsim.base.rng import stream

RNG_SEED = 7


@pytest.fixture
def sky():
    rng = stream(RNG_SEED, "sphere")
    return rng.uniform(0, 360, 200), np.degrees(np.arcsin(rng.uniform(-1, 1, 200)))


def test_vectors_round_trip_at_poles_and_wrap():
    ra = np.array([0.0, 359.9999999, 180.0, 45.0, 10.0])
    dec = np.array([0.0, -1e-9, 90.0, -89.9999, 41.8])
    back_ra, back_dec = sphere.ra_dec(sphere.unit_vectors(ra, dec))
    assert np.allclose(back_dec, dec, atol=1e-9)  # deg: 4 microarcsec
    assert ((back_ra >= 0) & (back_ra < 360)).all()
    assert np.allclose((back_ra - ra + 180) % 360 - 180, 0.0, atol=1e-6) or back_dec[2] == 90.0


def test_vectors_and_angles_against_astropy(sky):
    ra, dec = sky
    theirs = SkyCoord(ra, dec, unit="deg")
    vectors = sphere.unit_vectors(ra, dec)
    assert np.allclose(vectors, theirs.cartesian.xyz.value.T, rtol=0, atol=1e-15)
    for step in (1e-9, 1.0, 179.0):  # deg
        other = theirs.directional_offset_by(33.0 * units.deg, step * units.deg)
        found = sphere.angle(vectors, sphere.unit_vectors(other.ra.deg, other.dec.deg))
        assert np.allclose(found, step, rtol=1e-6, atol=1e-12)


def test_frames_are_the_derivatives_of_places(sky):
    """East and north are where a vector goes as ra cos dec and dec grow; both differences are good to 1e-8."""
    ra, dec = np.radians(sky)
    here, east, north = sphere.frames(ra, dec)
    h = 1e-6
    for along, plus, minus in (
        (east, sphere.frames(ra + h / np.cos(dec), dec)[0], sphere.frames(ra - h / np.cos(dec), dec)[0]),
        (north, sphere.frames(ra, dec + h)[0], sphere.frames(ra, dec - h)[0]),
    ):
        near_pole = np.abs(np.cos(dec)) < 1e-2
        assert np.allclose(((plus - minus) / (2 * h))[~near_pole], along[~near_pole], atol=1e-7)
    assert np.allclose(np.cross(east, north), here, atol=1e-15)


def test_offsets_across_ra_zero():
    east, north = sphere.offsets(0.001, 60.0002, 359.999, 60.0)
    assert east == pytest.approx(0.002 * 0.5, rel=1e-9) and north == pytest.approx(0.0002, rel=1e-9)


@pytest.mark.parametrize("centre", [(0.0, 0.0), (123.0, -45.0), (10.0, 89.9)])
def test_a_grown_polygon_holds_what_is_within_the_margin_and_no_more(centre):
    """A square of a degree grown by 0.1: points by their distance from the great circles of its edges, both senses."""
    axis, east, north = sphere.frames(*np.radians(centre))
    rng = stream(RNG_SEED, "polygon")

    def lifted(x, y):
        return sphere.normalised(axis + np.tan(np.radians(x))[:, None] * east + np.tan(np.radians(y))[:, None] * north)

    corners = lifted(np.array([-0.5, 0.5, 0.5, -0.5]), np.array([-0.5, -0.5, 0.5, 0.5]))
    points = lifted(*rng.uniform(-1, 1, (2, 4000)))
    normals = sphere.normalised(np.cross(corners, np.roll(corners, -1, axis=0)))
    depth = np.degrees(np.arcsin(points @ normals.T)).min(axis=1)  # from the nearest edge, inside positive
    assert np.array_equal(sphere.inside_polygon(points, corners), depth >= 0)
    wide = sphere.inside_polygon(points, sphere.expanded_polygon(corners, np.radians(0.1)))
    assert wide[depth > -0.1].all() and not wide[depth < -0.1 - 1e-3].any()
    assert np.array_equal(sphere.inside_polygon(points, corners[::-1]), depth >= 0)
    assert not sphere.inside_polygon(-points, corners).any()
