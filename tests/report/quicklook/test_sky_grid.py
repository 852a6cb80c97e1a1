"""Right ascension and declination on a picture: the right WCS, lines and labels, also at RA 0 and at the pole."""

from types import SimpleNamespace

import numpy as np
import pytest
from astropy.io import fits
from matplotlib.backends.backend_agg import FigureCanvasAgg
from support.tangent_header import tangent_header

from csstsim.base.shipped import SHIPPED
from csstsim.optics.geometry.distortion import load_distortion
from csstsim.optics.geometry.sip import sip_header
from csstsim.optics.geometry.wcs import ChipWCS
from csstsim.report.quicklook.figure import draw
from csstsim.report.quicklook.picture import read_picture
from csstsim.report.quicklook.sky_grid import LINEAR, _sides, exposure_wcs, header_wcs

GRID_PX = 1e-3  # of the SIP polynomials, measured 2e-4


def chip_header(camera, pointing, **changes):
    wcs = ChipWCS(camera.chips[9], pointing)
    words = {"FILETYPE": "SCIE", "DETECTOR": "09", "FLDDIST": True, "CAMHASH": camera.digest_for("level0")}
    place = {"RA_OBJ": pointing.ra, "DEC_OBJ": pointing.dec, "POS_ANG0": pointing.pa}
    return wcs.header() | words | place | changes


def test_the_grid_follows_the_field_distortion_of_the_shipped_camera(camera, make_pointing):
    pointing = make_pointing()
    distortion = load_distortion(SHIPPED / "instrument" / "distortion.fits")
    true = ChipWCS(camera.chips[9], pointing, distortion)
    x, y = (a.ravel() for a in np.meshgrid([0.0, 4000.0, 9215.0], [0.0, 4000.0, 9231.0]))
    sky = true.pixel_to_world(x, y)
    wcs, remark = exposure_wcs(chip_header(camera, pointing))
    assert np.abs(np.array(wcs.all_world2pix(*sky, 0)) - [x, y]).max() < GRID_PX and remark == ""
    linear, remark = exposure_wcs(chip_header(camera, pointing, CAMHASH="another"))
    assert np.abs(np.array(linear.all_world2pix(*sky, 0)) - [x, y]).max() > 10 and remark == LINEAR


def test_exposures_without_distortion_and_without_sky(camera, make_pointing):
    header = chip_header(camera, make_pointing(), FLDDIST=False)
    wcs, remark = exposure_wcs(header)
    assert wcs.sip is None and remark == ""
    assert exposure_wcs(header | {"FILETYPE": "BIAS"}) == (None, "")


def test_a_sip_header_moved_to_the_pixels_of_the_chip(camera, make_pointing):
    """CRPIX of an array that begins at pixel (1000, 2000): same sky, pixels counted on the chip."""
    true = ChipWCS(camera.chips[9], make_pointing(), load_distortion(SHIPPED / "instrument" / "distortion.fits"))
    header = sip_header(true)
    header |= {"CRPIX1": header["CRPIX1"] - 1000, "CRPIX2": header["CRPIX2"] - 2000}
    sky = true.pixel_to_world(np.array([1500.0, 3000.0]), np.array([2500.0, 9000.0]))
    pixels = header_wcs(header, (1000, 2000)).all_world2pix(*sky, 0)
    assert np.allclose(pixels, [[1500, 3000], [2500, 9000]], atol=GRID_PX)


@pytest.mark.parametrize(
    "header",
    [{}, {"CTYPE1": "LINEAR", "CTYPE2": "LINEAR"}, {"CTYPE1": "RA---TAN", "CTYPE2": "DEC--SIN"}, {"CRPIX1": 4.0}],
)
def test_headers_without_a_sky(header):
    assert header_wcs(header) is None
    assert header_wcs(fits.Header(header)) is None


def labels(path):
    """Return {(RA or Dec, side): [texts]} of the labels on the picture of a file."""
    picture = read_picture(path)
    figure = draw(picture, picture.bounds, "asinh")
    FigureCanvasAgg(figure).draw()
    overlay = figure.axes[0]._all_coords[1]
    found = {}
    for name, coordinate in zip(("RA", "Dec"), overlay, strict=True):
        for side in coordinate.get_ticklabel_position():
            found[name, side] = coordinate._ticklabels.text[side]
    return found


def test_labels_across_right_ascension_zero(calibrated):
    image = np.random.default_rng(1).normal(size=(30, 40))
    cards = dict(tangent_header(ra=0.0, dec=-40.0, pa=0.0, scale=20 * 0.074 / 3600))
    found = labels(calibrated(image, **cards))
    assert {key for key, texts in found.items() if len(texts) > 1} == {("RA", "t"), ("Dec", "r")}
    text = " ".join(found["RA", "t"])
    assert "23" in text and "0" in text and len(found["RA", "t"]) >= 2


@pytest.mark.parametrize("pa", [90.0, 270.0])
def test_north_to_the_side_puts_right_ascension_on_the_right(calibrated, pa):
    cards = dict(tangent_header(pa=pa))
    found = labels(calibrated(np.random.default_rng(1).normal(size=(30, 40)), **cards))
    assert {key for key, texts in found.items() if len(texts) > 1} == {("RA", "r"), ("Dec", "t")}


@pytest.mark.parametrize("dec", [90.0, -90.0])
def test_labels_with_a_pole_in_the_picture(calibrated, dec):
    cards = dict(tangent_header(ra=30.0, dec=dec))
    found = labels(calibrated(np.random.default_rng(1).normal(size=(30, 40)), **cards))
    assert found["RA", "t"] and found["RA", "r"] and found["Dec", "r"]


@pytest.mark.parametrize(("right_ascension", "sides"), [
    (lambda x, y: 1e-4 * (x - 130) ** 2 + 1e-3 * y, ("r", "t")),
    (lambda x, y: 1e-4 * (y - 40) ** 2 + 1e-3 * x, ("t", "r")),
    (lambda x, y: 8e-4 * x - 1e-3 * y, ("r", "t")), (lambda x, y: -1e-3 * x + 8e-4 * y, ("t", "r")),
    (lambda x, y: (359.9995 + 1e-3 * (x - 130) + 2e-3 * (y - 40)) % 360, ("r", "t")),
])  # fmt: skip
def test_labels_stand_where_more_lines_end(right_ascension, sides):
    """By the change of right ascension a pixel on from the middle of a part of the chip that is no square."""
    wcs = SimpleNamespace(all_pix2world=lambda x, y, origin: (right_ascension(np.array(x), np.array(y)), None))
    axes = SimpleNamespace(get_xlim=lambda: (100.0, 160.0), get_ylim=lambda: (20.0, 60.0))
    assert _sides(wcs, axes) == sides
