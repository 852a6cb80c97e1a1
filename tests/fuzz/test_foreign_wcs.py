"""Each reader of others' images puts pixels where astropy does, for random valid WCS; `make fuzz` tries many more.

To 1e-3 px: the frame that objects are injected into, and the image that is a galaxy's light.
"""

import numpy as np
import pytest
from astropy.coordinates import SkyCoord
from astropy.io import fits
from astropy.wcs import WCS
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from support.foreign_headers import SIDE, headers

from csstsim.catalog.galaxy_shapes.images import read_image
from csstsim.inject.others.frame import read_foreign

PX = 1e-3  # px
STAMP = 24
HOW = {"deadline": None, "database": None, "suppress_health_check": list(HealthCheck)}


def frame(folder, header, x, y):
    """A frame's places, both ways, and the map about an object, against those of astropy."""
    path = folder / "frame.fits"
    header = header.copy()
    header.update(BUNIT="electron", EXPTIME=100.0)
    fits.HDUList([fits.PrimaryHDU(np.ones((int(SIDE), int(SIDE)), np.float32), header)]).writeto(path, overwrite=True)
    wcs, theirs = read_foreign(path).wcs, WCS(header)
    there = theirs.pixel_to_world(x, y).icrs
    assert np.array(wcs.pixels([there.ra.deg], [there.dec.deg])).ravel() == pytest.approx([x, y], abs=PX)
    ra, dec = wcs.sky(x, y)
    back = np.array(theirs.world_to_pixel(SkyCoord(ra, dec, unit="deg")))
    assert back == pytest.approx([x, y], abs=PX)


def picture(folder, header, x, y):
    """The map about the middle of a small image takes its edges where astropy's, from half a pixel, would, to PX."""
    path = folder / "stamp.fits"
    header = header.copy()
    header["CRPIX1"], header["CRPIX2"] = header["CRPIX1"] - x, header["CRPIX2"] - y
    light = np.zeros((STAMP + 1, STAMP + 1), np.float32)
    light[STAMP // 2, STAMP // 2] = 1
    fits.HDUList([fits.PrimaryHDU(light, header)]).writeto(path, overwrite=True)
    sky, theirs, middle = read_image(str(path)).sky, WCS(header), STAMP / 2
    here = theirs.pixel_to_world(middle, middle).icrs
    for step in np.eye(2):
        ends = [theirs.pixel_to_world(*(middle + half * step)).icrs for half in (-0.5, 0.5)]
        (e0, n0), (e1, n1) = ([part.arcsec for part in here.spherical_offsets_to(end)] for end in ends)
        off = np.linalg.solve(sky, [e1 - e0, n1 - n0]) - step
        assert np.abs(off).max() * STAMP / 2 < PX


READERS = {"frame": frame, "picture": picture}


def tried(name, folder, examples):
    @settings(max_examples=examples, **HOW)
    @given(headers(), st.floats(0, SIDE - 1), st.floats(0, SIDE - 1))
    def give(header, x, y):
        READERS[name](folder, header, x, y)

    give()


@pytest.mark.parametrize("name", READERS)
@pytest.mark.filterwarnings("ignore")
def test_places_are_astropys(name, tmp_path):
    tried(name, tmp_path, 40)


@pytest.mark.slow
@pytest.mark.parametrize("name", READERS)
@pytest.mark.filterwarnings("ignore")
def test_places_are_astropys_for_many(name, tmp_path):
    tried(name, tmp_path, 4000)
