"""Bricks: one for every position, margins, coverage; against healpy's own neighbours and areas."""

import healpy
import numpy as np
import pytest

from csstsim.base import healpix
from csstsim.base.rng import stream


def test_vectors_round_trip_at_poles_and_wrap():
    ra = np.array([0.0, 359.9999999, 180.0, 45.0, 10.0])
    dec = np.array([0.0, -1e-9, 90.0, -89.9999, 41.8])
    back_ra, back_dec = healpix.from_vectors(healpix.to_vectors(ra, dec))
    assert np.allclose(back_dec, dec, atol=1e-9)  # deg: 4 microarcsec
    assert ((back_ra >= 0) & (back_ra < 360)).all()
    assert np.allclose((back_ra - ra + 180) % 360 - 180, 0.0, atol=1e-6) or back_dec[2] == 90.0


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
    border = healpix.to_vectors(ra, dec)
    centre = healpix.to_vectors(*healpy.pix2ang(256, pix, nest=True, lonlat=True))
    outward = border - centre
    outward /= np.linalg.norm(outward, axis=1, keepdims=True)
    for push, expected in ((-0.5, True), (0.4, True), (2.0, False)):
        moved = healpix.from_vectors(border + np.radians(push * margin) * outward)
        near = healpix.near_brick(pix, *moved, margin)
        # 2 margins along the diagonal of a square corner are 1.4 margins from both borders
        assert (near == expected).all(), push


@pytest.mark.parametrize("pix", [0, 21845, 65535, 131071, 123456, 555555, 786431, WRAP, POLE])
def test_near_brick_around_corners_however_sharp(pix):
    """Random points around the four corners, against their distance to 16,384 points of the border, 0.2" apart."""
    from scipy.spatial import cKDTree

    margin = 2.0 / 3600.0
    border = healpix.to_vectors(*healpix.brick_corners(pix, step=4096))
    corners = np.repeat(border[::4096], 100, axis=0)
    points = corners + np.radians(1.5 * margin) * stream(pix, "corners").normal(size=corners.shape)
    ra, dec = healpix.from_vectors(points)
    points = healpix.to_vectors(ra, dec)
    distance = np.degrees(cKDTree(border).query(points)[0]) / margin
    outside, near = healpix.brick_of(ra, dec) != pix, healpix.near_brick(pix, ra, dec, margin)
    assert near[~outside].all() and not near[outside & (distance > 1.01)].any()
    assert near[distance < 0.7].all()  # a corner's tip may hide between two directions further out
    assert (near & outside).sum() > 50


def test_coverage_by_known_quadrilaterals():
    pix = int(healpix.brick_of(40.0, 30.0))
    corners = healpix.brick_corners(pix)
    assert healpix.coverage(pix, [corners]) == pytest.approx(1.0, abs=0.01)
    assert healpix.coverage(pix, []) == 0.0
    ra, dec = corners
    half = np.array([ra[0], ra[1], ra[2]]), np.array([dec[0], dec[1], dec[2]])  # a triangle: half the brick
    assert healpix.coverage(pix, [half]) == pytest.approx(0.5, abs=0.02)
    assert healpix.coverage(pix, [(ra[::-1], dec[::-1])]) == pytest.approx(1.0, abs=0.01)  # either sense
    assert healpix.coverage(pix, [((ra + 180) % 360, -dec)]) == 0.0  # the antipode


def test_coverage_across_ra_zero_and_at_the_pole():
    big_ra, big_dec = np.array([359.0, 1.0, 1.0, 359.0]), np.array([-1.0, -1.0, 1.0, 1.0])
    assert healpix.coverage(int(healpix.brick_of(0.0, 0.0)), [(big_ra, big_dec)]) == 1.0
    around = np.array([0.0, 90.0, 180.0, 270.0]), np.full(4, 89.0)
    assert healpix.coverage(int(healpix.brick_of(30.0, 90.0)), [around]) == 1.0
