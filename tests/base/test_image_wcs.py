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


def camera_header():
    """Return a header of 4096 x 4096 px of 0.05 arcsec at (150, 2), distorted by 30 px as the ACS is."""
    names = {"CTYPE1": "RA---TAN-SIP", "CTYPE2": "DEC--TAN-SIP", "CRVAL1": 150.0, "CRVAL2": 2.0, "CRPIX1": 2048.5,
             "CRPIX2": 2048.5, "CD1_1": -0.05 / 3600, "CD2_2": 0.05 / 3600, "A_ORDER": 3, "B_ORDER": 3}  # fmt: skip
    a = {"A_2_0": 8.5e-6, "A_1_1": -5.2e-6, "A_0_2": 2.1e-6, "A_3_0": 1e-11, "A_1_2": -2e-11}
    b = {"B_2_0": -1.6e-6, "B_1_1": 6e-6, "B_0_2": -7e-6, "B_0_3": -1e-11}
    return Header(names | a | b)


def test_positions_far_from_a_distorted_image_are_not_in_it():
    """The iteration ends at (2161.6, 539.7) 1.7 deg away. Of 11,000 positions at 1 to 3 deg, 15 end in the frame."""
    wcs = ImageWCS(camera_header(), "image.fits")
    assert np.isnan(wcs.pixels(np.array([148.6]), np.array([1.013]))).all()
    rng = np.random.default_rng(1)
    radius, angle = rng.uniform(1, 3, 20_000), rng.uniform(0, 2 * np.pi, 20_000)
    far = 150 + radius * np.cos(angle) / np.cos(np.radians(2)), 2 + radius * np.sin(angle)
    near = wcs.sky(rng.uniform(-500, 4600, 1000), rng.uniform(-500, 4600, 1000))
    x, y = wcs.pixels(*(np.concatenate(pair) for pair in zip(far, near, strict=True)))
    inside = (np.abs(x - 2048) < 2600) & (np.abs(y - 2048) < 2600)
    assert not inside[:20_000].any() and inside[20_000:].all()  # far ones do not spoil the others


def test_a_frame_that_astropy_lacks_is_refused():
    header = Header({"CTYPE1": "HPLN-TAN", "CTYPE2": "HPLT-TAN", "CRVAL1": 0.0, "CRVAL2": 0.0})
    with pytest.raises(InputError, match="does not know"):
        ImageWCS(header, "image.fits")
    with pytest.raises(InputError, match="no WCS"):
        ImageWCS(Header({"CTYPE1": "LINEAR", "CTYPE2": "LINEAR"}), "image.fits")


def test_the_reason_why_a_wcs_cannot_be_used_is_told():
    """Not the line of wcslib's source code that found it."""
    names = {"CTYPE1": "RA---TAN", "CTYPE2": "DEC--SIN", "CRVAL1": 0.0, "CRVAL2": 0.0}
    with pytest.raises(InputError) as caught:
        ImageWCS(Header(names), "image.fits")
    said = str(caught.value)
    assert said.startswith("image.fits: the WCS cannot be used: ") and said.count(":") == 2, said
    assert "wcslib" not in said and "ERROR" not in said and len(said) > 50, said
