"""Bricks: one for every position, margins, coverage; against healpy's own neighbours and areas."""

import healpy
import numpy as np
import pytest

from csstsim.base import healpix, sphere
from csstsim.base.rng import stream


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
