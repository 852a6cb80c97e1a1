"""World coordinates of others' images against astropy's high-level interface: frames, orders of axes, projections."""

import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import SkyCoord
from astropy.io.fits import Header
from astropy.wcs import WCS
from hypothesis import given, settings
from hypothesis import strategies as st

from csstsim.base.errors import InputError
from csstsim.base.image_wcs import ImageWCS

FRAMES = {
    "icrs": ("RA--", "DEC-", {"RADESYS": "ICRS"}),
    "fk5": ("RA--", "DEC-", {"RADESYS": "FK5", "EQUINOX": 2000.0}),
    "fk5 of 1975": ("RA--", "DEC-", {"RADESYS": "FK5", "EQUINOX": 1975.0}),
    "fk4": ("RA--", "DEC-", {"RADESYS": "FK4", "EQUINOX": 1950.0, "MJD-OBS": 40000.0}),
    "galactic": ("GLON", "GLAT", {}),
    "unsaid": ("RA--", "DEC-", {}),
}
PROJECTIONS = "TAN", "SIN", "ARC", "ZEA", "STG", "CAR", "AIT", "TAN-SIP"
SIDE = 400.0


@st.composite
def headers(draw):
    lon, lat, more = FRAMES[draw(st.sampled_from(sorted(FRAMES)))]
    projection = draw(st.sampled_from(PROJECTIONS))
    names = [f"{lon}-{projection}"[:12], f"{lat}-{projection}"[:12]]
    at = [draw(st.floats(0, 359)), draw(st.floats(-88, 88))]
    if projection in ("CAR", "AIT"):
        at[1] = 0.0  # a reference off the equator turns the whole sphere
    scale, turn = draw(st.floats(0.03, 2.0)) / 3600, np.radians(draw(st.floats(0, 360)))
    parity = draw(st.sampled_from([-1, 1]))
    matrix = scale * np.array([[parity * np.cos(turn), np.sin(turn)], [-parity * np.sin(turn), np.cos(turn)]])
    swapped = draw(st.booleans()) and not projection.endswith("SIP")
    order = [1, 0] if swapped else [0, 1]
    header = Header({"NAXIS": 2, "NAXIS1": int(SIDE), "NAXIS2": int(SIDE), **more})
    for k, which in enumerate(order, 1):
        header[f"CTYPE{k}"], header[f"CRVAL{k}"] = names[which], at[which]
        header[f"CRPIX{k}"] = draw(st.floats(-2000, 2000))
        for j in (1, 2):
            header[f"CD{k}_{j}"] = matrix[which, j - 1]
    if projection.endswith("SIP"):
        header["A_ORDER"], header["B_ORDER"], header["A_2_0"], header["B_1_1"] = 2, 2, 1e-6, -2e-6
    return header


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
