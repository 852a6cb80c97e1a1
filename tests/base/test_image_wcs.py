"""World coordinates of others' images against astropy's high-level interface: frames, orders of axes, projections."""

import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import SkyCoord
from astropy.io.fits import Header
from astropy.wcs import WCS
from hypothesis import given, settings
from hypothesis import strategies as st
from support.foreign_headers import SIDE, headers

from csstsim.base.errors import InputError
from csstsim.base.image_wcs import ImageWCS


@settings(max_examples=200, deadline=None)
@given(headers(), st.floats(0, SIDE), st.floats(0, SIDE))
@pytest.mark.filterwarnings("ignore")
def test_places_are_those_of_astropy(header, x, y):
    wcs = ImageWCS(header, "image.fits")
    there = WCS(header).pixel_to_world(x, y).icrs
    ra, dec = wcs.sky(x, y)
    assert SkyCoord(ra, dec, unit="deg").separation(there).arcsec < 1e-5
    assert np.array(wcs.pixels([ra], [dec])).ravel() == pytest.approx([x, y], abs=1e-3)


@settings(max_examples=100, deadline=None)
@given(headers(), st.floats(0, SIDE), st.floats(0, SIDE))
@pytest.mark.filterwarnings("ignore")
def test_the_local_map_is_that_of_small_steps_on_the_sky(header, x, y):
    wcs, foreign = ImageWCS(header, "image.fits"), WCS(header)
    here = foreign.pixel_to_world(x, y).icrs
    local = wcs.jacobian(np.array([here.ra.deg]), np.array([here.dec.deg]))[0]
    for axis, angle in ((0, 90), (1, 0)):
        ends = [here.directional_offset_by((angle + turn) * u.deg, 0.5 * u.arcsec) for turn in (0, 180)]
        step = np.subtract(*(np.array(foreign.world_to_pixel(end)) for end in ends))
        assert local[:, axis] == pytest.approx(step, abs=1e-5 * np.abs(local).max() + 2e-6)
    assert wcs.per_pixel(x, y) @ local == pytest.approx(np.eye(2), abs=1e-4)


@pytest.mark.parametrize("dec", [-90.0, -89.9999, 89.9999, 90.0])
def test_at_a_pole_the_map_is_as_anywhere(dec):
    header = Header({"CTYPE1": "RA---TAN", "CTYPE2": "DEC--TAN", "CRVAL1": 30.0, "CRVAL2": dec})
    header["CD1_1"], header["CD2_2"] = -0.2 / 3600, 0.2 / 3600
    local = ImageWCS(header, "image.fits").jacobian(np.array([30.0]), np.array([dec]))[0]
    turned = -1 if dec == 90 else 1  # FITS: LONPOLE is 0, not 180, where CRVAL2 is 90
    assert local == pytest.approx(turned * np.array([[-5.0, 0.0], [0.0, 5.0]]), abs=1e-4)


def test_a_frame_that_astropy_lacks_is_refused():
    header = Header({"CTYPE1": "HPLN-TAN", "CTYPE2": "HPLT-TAN", "CRVAL1": 0.0, "CRVAL2": 0.0})
    with pytest.raises(InputError, match="does not know"):
        ImageWCS(header, "image.fits")
    with pytest.raises(InputError, match="no WCS"):
        ImageWCS(Header({"CTYPE1": "LINEAR", "CTYPE2": "LINEAR"}), "image.fits")
