"""The TPV header in ICRS against the reduction itself, by astropy's WCS, over whole chips."""

from dataclasses import replace

import numpy as np
import pytest
from astropy.coordinates import SkyCoord
from astropy.io import fits
from astropy.wcs import WCS

from csstsim.base.shipped import SHIPPED
from csstsim.catalog.astrometry.reduction import icrs
from csstsim.optics.geometry.distortion import load_distortion
from csstsim.optics.geometry.icrs_header import corners, icrs_header
from csstsim.optics.geometry.wcs import ChipWCS

MAS = 0.1


@pytest.mark.parametrize("chip", [9, 15, 29])
@pytest.mark.parametrize("ra, dec", [(60.0, -40.0), (0.01, 2.0), (120.0, 89.8)])
def test_within_a_tenth_of_a_mas_over_a_chip(camera, make_pointing, observe, chip, ra, dec):
    pointing = make_pointing(ra=ra, dec=dec)
    distortion = load_distortion(SHIPPED / "instrument" / "distortion.fits")
    wcs, craft, window = (
        ChipWCS(camera.chips[chip], pointing, distortion),
        observe(pointing),
        camera.chips[chip].full_window,
    )
    header = fits.Header()
    header.update(icrs_header(wcs, craft, window))
    x, y = (v.ravel() for v in np.meshgrid(np.linspace(0, window.nx - 1, 8), np.linspace(0, window.ny - 1, 7)))
    seen = SkyCoord(*WCS(header).all_pix2world(x, y, 0), unit="deg")
    true = SkyCoord(*icrs(*wcs.pixel_to_world(x, y), craft), unit="deg")
    assert seen.separation(true).mas.max() < MAS
    edge = SkyCoord(*np.transpose(corners(wcs, craft, window)), unit="deg")
    assert edge[0].separation(SkyCoord(*WCS(header).all_pix2world(-0.5, -0.5, 0), unit="deg")).mas < 1.0


def test_corners_and_reference_pixel_of_a_window(camera, make_pointing, observe):
    """Corners in order round pixels' edges, as the header's WCS has them; the reference pixel is the middle."""
    pointing = make_pointing(ra=200.0, dec=55.0)
    wcs, craft = ChipWCS(camera.chips[9], pointing), observe(pointing)
    window = replace(camera.chips[9].full_window, x0=1000, x1=1501, y0=300, y1=1302)
    header = icrs_header(wcs, craft, window)
    assert (header["CRPIX1"], header["CRPIX2"]) == (251.0, 501.5)
    assert header["PV1_1"] == pytest.approx(1.0, abs=1e-3) and header["RADESYS"] == "ICRS"
    x, y = np.array([-0.5, 500.5, 500.5, -0.5]), np.array([-0.5, -0.5, 1001.5, 1001.5])
    by_header = SkyCoord(*WCS(fits.Header(header)).all_pix2world(x, y, 0), unit="deg")
    found = SkyCoord(*np.transpose(corners(wcs, craft, window)), unit="deg")
    assert found.separation(by_header).mas.max() < 2 * MAS
    seen = SkyCoord(*wcs.pixel_to_world(x + 1000, y + 300), unit="deg")
    assert found.separation(seen).arcsec.min() > 1.0  # aberration is undone
