"""A Frame without a simulation: what a notebook shows, positions, CCDData."""

import base64
import io
import re
from html.parser import HTMLParser

import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import SkyCoord
from astropy.io import fits
from astropy.nddata import CCDData
from astropy.table import Table
from astropy.wcs import WCS
from PIL import Image

from csstsim.instrument.chip import Window
from csstsim.simulation.frame import Frame

SCALE = 0.074 / 3600


def frame_of(ny=30, nx=50, header=True, image=None, types=(0, 1, 1)):
    wcs = WCS(naxis=2)
    wcs.wcs.ctype = "RA---TAN", "DEC--TAN"
    wcs.wcs.crval, wcs.wcs.crpix, wcs.wcs.cdelt = (10.0, 80.0), (nx / 2, ny / 2), (-SCALE, SCALE)
    wcs.wcs.radesys = "ICRS"
    cards = fits.Header([("FILTER", "i"), ("CRVAL1", 11.0), ("CD1_1", 2.0), ("A_2_0", 3.0), ("CTYPE1C", "RA---TAN")])
    cards["POSKIND"] = "APPARENT"
    cards.append(("CRVAL1", 11.0))  # both headers of a file in one
    return Frame(
        image=np.zeros((ny, nx), np.uint16 if header else np.float32) if image is None else image,
        truth=Table({"obj_type": np.array(types, np.int8)}),
        wcs=wcs,
        window=Window(100, 100 + nx, 200, 200 + ny),
        header=cards if header else None,
        key=("10100000001", 9),
        filter="<i>",
    )


class Tags(HTMLParser):
    def __init__(self):
        super().__init__()
        self.open, self.text = [], []

    def handle_starttag(self, tag, attrs):
        if tag != "img":
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.text.append(data)


def shown(frame):
    """Return the texts and the thumbnail (ny, nx) of a Frame in a notebook."""
    html = frame._repr_html_()
    tags = Tags()
    tags.feed(html)
    assert not tags.open
    png = base64.b64decode(re.search(r"base64,([^\"]+)", html)[1])
    return tags.text, np.asarray(Image.open(io.BytesIO(png)))


def test_a_notebook_shows_the_facts():
    text, _ = shown(frame_of())
    facts = "10100000001", "9", "<i>", "x 100 to 150, y 200 to 230", "uint16 [DN]", "1 star, 2 galaxies"
    for fact in facts:
        assert fact in text


def test_a_thumbnail_has_the_first_row_below():
    image = np.zeros((900, 600), np.float32)
    image[:90, :60] = 100.0
    _, picture = shown(frame_of(900, 600, False, image, ()))
    assert picture.shape == (225, 150)
    assert picture[-1, 0] > 100 > 90 > picture[0, 0] == picture[-1, -1]


@pytest.mark.parametrize("value", [0.0, 3.0, np.nan])
@pytest.mark.parametrize("shape", [(1, 1), (1, 700), (241, 1)])
def test_a_thumbnail_of_any_shape(shape, value):
    text, picture = shown(frame_of(*shape, False, np.full(shape, value, np.float32), ()))
    assert min(picture.shape) >= 1 and "no objects" in text


def test_positions_go_to_pixels_and_back():
    frame = frame_of()
    sky = frame.pixel_to_icrs([0.0, 24.5, 49], [0.0, 3, 29])
    assert sky.frame.name == "icrs"
    for given in ((sky.galactic,), (sky.ra.deg, sky.dec.deg), (sky.ra, sky.dec.to(u.arcmin))):
        x, y = frame.icrs_to_pixel(*given)
        assert np.allclose(x, [0, 24.5, 49], atol=1e-6) and np.allclose(y, [0, 3, 29], atol=1e-6)
    assert frame.icrs_to_pixel(10.0, 80.0) == (pytest.approx(24), pytest.approx(14))


@pytest.mark.parametrize("header, unit", [(True, u.adu), (False, u.electron)])
def test_ccddata_keeps_the_icrs_positions(header, unit, tmp_path):
    frame = frame_of(header=header)
    data = frame.to_ccddata()
    assert data.unit == unit and data.data is frame.image
    data.write(tmp_path / "frame.fits")
    read = CCDData.read(tmp_path / "frame.fits")
    assert read.unit == unit and np.array_equal(read.data, frame.image)
    assert read.wcs.pixel_to_world(3, 4).separation(frame.wcs.pixel_to_world(3, 4)).mas < 1e-3
    assert isinstance(read.wcs.pixel_to_world(3, 4), SkyCoord)
    assert not {"A_2_0", "CTYPE1C", "POSKIND"} & set(read.header)
    assert (read.header.get("FILTER") == "i") == header
    assert not header or frame.header["CRVAL1"] == 11.0  # the frame's own is as it was
