"""Bricks of a footprint are complete, also at poles and across RA 0: against random points in the grown polygon."""

import time

import healpy
import numpy as np
import pytest
from support.csst import BANDS, MARGIN

from csstsim.catalog.selection.bricks import bricks_for, region_for
from csstsim.optics.geometry.wcs import ChipWCS, gnomonic

PLACES = {
    "common": (60.0, -40.0),
    "ra wrap": (359.99, 10.0),
    "north": (123.0, 89.99),
    "south": (10.0, -90.0),
    "equator": (0, 0),
}


@pytest.mark.parametrize("place", PLACES)
@pytest.mark.parametrize("margin", [0.0, MARGIN, 1.0])
def test_no_brick_within_the_margin_is_missing(camera, make_pointing, place, margin):
    ra, dec = PLACES[place]
    for chip_id in (6, 13, 25):
        wcs = ChipWCS(camera.chips[chip_id], make_pointing(ra=ra, dec=dec, pa=33.0))
        bricks = bricks_for(*wcs.footprint(), margin)
        reach = margin / (0.074 / 3600)
        rng = np.random.default_rng(1)
        x, y = (rng.uniform(-0.99 * reach - 0.5, n - 0.5 + 0.99 * reach, 40000) for n in (9216, 9232))
        touched = np.unique(healpy.ang2pix(256, *wcs.pixel_to_world(x, y), nest=True, lonlat=True))
        assert np.isin(touched, bricks).all()
        assert len(bricks) <= 2 * len(touched) + 8 and (np.diff(bricks) > 0).all()


def test_polygon_round_the_pole():
    bricks = bricks_for(np.array([0.0, 90.0, 180.0, 270.0]), np.full(4, 89.0), 0.0)
    ra, dec = np.random.default_rng(2).uniform(0, 360, 5000), np.random.default_rng(3).uniform(89.3, 90, 5000)
    assert np.isin(healpy.ang2pix(256, ra, dec, nest=True, lonlat=True), bricks).all()
    assert len(bricks) < 100


def test_corner_order_does_not_matter():
    ra, dec = np.array([10.0, 10.2, 10.2, 10.0]), np.array([5.0, 5.0, 5.2, 5.2])
    assert np.array_equal(bricks_for(ra, dec, MARGIN), bricks_for(ra[::-1], dec[::-1], MARGIN))


def test_tiny_window():
    size = 0.074 / 3600 * 4
    ra, dec = np.array([0, size, size, 0]), np.array([0, 0, size, size])
    assert healpy.ang2pix(256, 0.0, 0.0, nest=True, lonlat=True) in bricks_for(ra, dec, 0.0)


def test_grown_corners_stand_off_by_the_margin():
    ra, dec = np.array([0.0, 0.1, 0.1, 0.0]) - 0.05, np.array([-0.05, -0.05, 0.05, 0.05])
    region = region_for(ra, dec, 0.02, BANDS)
    assert region.dec == pytest.approx([-0.07, -0.07, 0.07, 0.07], abs=1e-6)
    assert (np.array(region.ra) + 180) % 360 - 180 == pytest.approx([-0.07, 0.07, 0.07, -0.07], abs=1e-6)


def test_fast_enough_for_a_workflow(camera, make_pointing):
    footprint = ChipWCS(camera.chips[8], make_pointing()).footprint()
    bricks_for(*footprint, MARGIN)
    start = time.process_time()
    for _ in range(50):
        bricks_for(*footprint, MARGIN)
    assert (time.process_time() - start) / 50 < 0.01  # s; 0.4 ms when written


@pytest.mark.parametrize("dec", [0.0, -40.0, 89.9, -89.95])
@pytest.mark.parametrize("ra", [0.0, 123.4])
def test_a_region_holds_what_lies_between_its_corners(ra, dec):
    """A square of half a degree about a place: each point against its plane coordinates there; poles and RA wrap."""
    rng, half = np.random.default_rng(4), np.radians(0.25)
    middle = np.array([ra, dec])
    offsets = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * half
    corners = np.array([on_sky(middle, *offset) for offset in offsets])
    region = region_for(*corners.T, margin_deg=0.0, bands=BANDS)
    xi, eta = rng.uniform(-2 * half, 2 * half, (2, 500))
    places = np.array([on_sky(middle, *point) for point in zip(xi, eta, strict=True)])
    inside = (np.abs(xi) < half) & (np.abs(eta) < half)
    assert inside.sum() > 50 and np.array_equal(region.contains(*places.T), inside)
    back = gnomonic(middle, *places.T)
    assert np.allclose(back, (xi, eta), atol=1e-12)


def on_sky(middle, xi, eta):
    """Return ra, dec [deg] of a point of the plane that touches the sky at `middle`."""
    ra, dec = np.radians(middle)
    east, north = (
        np.array([-np.sin(ra), np.cos(ra), 0]),
        np.array([-np.sin(dec) * np.cos(ra), -np.sin(dec) * np.sin(ra), np.cos(dec)]),
    )
    v = np.array([np.cos(dec) * np.cos(ra), np.cos(dec) * np.sin(ra), np.sin(dec)]) + xi * east + eta * north
    return np.degrees(np.arctan2(v[1], v[0])) % 360, np.degrees(np.arctan2(v[2], np.hypot(v[0], v[1])))
