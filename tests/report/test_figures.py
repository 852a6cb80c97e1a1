"""The projection of the sky map against that of astropy."""

import numpy as np
import pytest
from astropy.wcs import WCS

from csstsim.report.figures import _offsets


@pytest.mark.parametrize("centre", [(150.0, 2.0), (0.0, -60.0), (359.99, 45.0), (30.0, 90.0), (200.0, -89.9)])
def test_the_sky_map_is_lamberts_equal_area_projection(centre):
    """Over the whole sky but for the point opposite the centre, to 1e-9 deg."""
    wcs = WCS(naxis=2)
    wcs.wcs.ctype, wcs.wcs.crval, wcs.wcs.crpix, wcs.wcs.cdelt = ["RA---ZEA", "DEC--ZEA"], centre, [1, 1], [1, 1]
    wcs.wcs.lonpole = 180.0  # north is up at the pole, too
    rng = np.random.default_rng(5)
    ra, dec = rng.uniform(0, 360, 500), np.degrees(np.arcsin(rng.uniform(-1, 1, 500)))
    ra[:3], dec[:3] = (0.0, 360.0, centre[0]), (10.0, 10.0, 0.9 * centre[1])
    np.testing.assert_allclose(_offsets(ra, dec, centre), wcs.all_world2pix(ra, dec, 0), atol=1e-9)
