"""Bricks: one for every position, margins, coverage; against healpy's own neighbours and areas."""

import healpy
import numpy as np
import pytest

from csstsim.base import healpix, sphere
from csstsim.base.rng import stream


@pytest.mark.parametrize("order", [0, 1, 3, 8, 12, 29])
def test_pixels_and_their_middles_are_healpys_to_the_bit(order):
    rng, nside = stream(order, "healpix"), 2**order
    ra, dec = rng.uniform(0, 360, 10_000), np.degrees(np.arcsin(rng.uniform(-1, 1, 10_000)))
    ra[:3], dec[:3] = (0.0, 360.0, 5.0), (90.0, -90.0, 0.0)
    pixels = healpix.pixel_of(nside, ra, dec)
    assert np.array_equal(pixels, healpy.ang2pix(nside, ra, dec, nest=True, lonlat=True))
    assert np.array_equal(healpix.pixel_centre(nside, pixels), healpy.pix2ang(nside, pixels, nest=True, lonlat=True))
    assert np.array_equal(healpix.pixel_vector(nside, pixels).T, healpy.pix2vec(nside, pixels, nest=True))
    vectors = sphere.unit_vectors(ra, dec)
    assert np.array_equal(healpix.pixel_towards(nside, vectors), healpy.vec2pix(nside, *vectors.T, nest=True))
    assert (healpix.pixel_of(nside, ra - 360.0, dec) == healpix.pixel_of(nside, ra, dec)).mean() > 0.999  # rounding


@pytest.mark.parametrize("order", [8, 29])
@pytest.mark.parametrize("distance", [1e-8, 1e-6, 1e-4, 0.01, 0.6])
@pytest.mark.parametrize("pole", [1, -1])
def test_pixels_at_a_pole_are_healpys(order, distance, pole):
    rng = stream(order, "poles")
    ra, dec = rng.uniform(0, 360, 1000), pole * (90.0 - rng.uniform(0.1, 1, 1000) * distance)
    pixels = healpix.pixel_of(2**order, ra, dec)
    assert np.array_equal(pixels, healpy.ang2pix(2**order, ra, dec, nest=True, lonlat=True))
    theirs = healpy.pix2ang(2**order, pixels, nest=True, lonlat=True)
    assert np.array_equal(healpix.pixel_centre(2**order, pixels), theirs)


@pytest.mark.parametrize("order", [0, 1, 3, 8, 12])
@pytest.mark.parametrize("step", [1, 4, 16])
def test_borders_are_healpys_to_the_bit(order, step):
    every = stream(step, "borders").integers(0, 12 * 4**order, 100).tolist()
    corners = (k * 4**order + at for k in range(12) for at in (0, 4**order - 1))  # at the poles and between faces
    for pix in {*corners, *every}:
        theirs = healpy.boundaries(2**order, pix, step=step, nest=True).T
        assert np.array_equal(healpix.pixel_border(2**order, pix, step), theirs), pix


@pytest.mark.parametrize("inclusive", [False, True])
def test_discs_are_healpys(inclusive):
    rng = stream(inclusive, "discs")
    for radius in np.radians([0.01, 0.5, 3.0, 20.0]):
        centre = sphere.unit_vectors(rng.uniform(0, 360), rng.uniform(-90, 90))
        theirs = healpy.query_disc(64, centre, radius, inclusive=inclusive, nest=True)
        assert np.array_equal(healpix.disc(64, centre, radius, inclusive), np.sort(theirs))


@pytest.mark.parametrize("dec", [np.nan, np.inf, 90.1, -91.0])
def test_a_position_off_the_sphere_has_no_pixel(dec):
    with pytest.raises(ValueError):
        healpix.pixel_of(256, 10.0, dec)


def test_hats_index_is_in_its_brick():
    rng = stream(1, "healpix")
    ra, dec = rng.uniform(0, 360, 1000), np.degrees(np.arcsin(rng.uniform(-1, 1, 1000)))
    assert (healpix.hats_index(ra, dec) >> 2 * (healpix.HATS_ORDER - 8) == healpix.brick_of(ra, dec)).all()


WRAP, POLE = (int(healpix.brick_of(*place)) for place in ((0.0, 0.0), (5.0, 90.0)))


@pytest.mark.parametrize("pix", [0, 65535, 123456, 786431, WRAP, POLE])
def test_near_brick_takes_the_brick_and_a_margin(pix):
    """Points pushed out of the brick by less than the margin are near; by more, not. Border from healpy."""
    margin = 2.0 / 3600.0
    ra, dec = healpix.brick_corners(pix, step=20)
    border = sphere.unit_vectors(ra, dec)
    centre = sphere.unit_vectors(*healpy.pix2ang(256, pix, nest=True, lonlat=True))
    outward = border - centre
    outward /= np.linalg.norm(outward, axis=1, keepdims=True)
    for push, expected in ((-0.5, True), (0.4, True), (2.0, False)):
        moved = sphere.ra_dec(border + np.radians(push * margin) * outward)
        near = healpix.near_brick(pix, *moved, margin)
        # 2 margins along the diagonal of a square corner are 1.4 margins from both borders
        assert (near == expected).all(), push


@pytest.mark.parametrize("pix", [0, 21845, 65535, 131071, 123456, 555555, 786431, WRAP, POLE])
def test_near_brick_around_corners_however_sharp(pix):
    """Random points around the four corners, against their distance to 16,384 points of the border, 0.2" apart."""
    from scipy.spatial import cKDTree

    margin = 2.0 / 3600.0
    border = sphere.unit_vectors(*healpix.brick_corners(pix, step=4096))
    corners = np.repeat(border[::4096], 100, axis=0)
    points = corners + np.radians(1.5 * margin) * stream(pix, "corners").normal(size=corners.shape)
    ra, dec = sphere.ra_dec(points)
    points = sphere.unit_vectors(ra, dec)
    distance = np.degrees(cKDTree(border).query(points)[0]) / margin
    outside, near = healpix.brick_of(ra, dec) != pix, healpix.near_brick(pix, ra, dec, margin)
    assert near[~outside].all() and not near[outside & (distance > 1.01)].any()
    assert near[distance < 0.7].all()  # a corner's tip may hide between two directions further out
    assert (near & outside).sum() > 50
