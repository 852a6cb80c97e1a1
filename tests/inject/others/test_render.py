"""Injection into images of other telescopes: full pixels, limits of integers, and pixels without a value."""

import numpy as np
import pytest
from astropy.io import fits
from inject.others.test_foreign import at, raw_pixels, wcs_cards, write_psf

from csstsim.catalog.table import ObjectTable
from csstsim.inject.inject import inject

SIDE, MIDDLE, ZERO = 200, 100, 25.0
BRIGHT = 13.0  # mag: 6.3 million electrons in 100 s, up to 440,000 in a pixel of `write_psf`


def write_pixels(folder, pixels, flags=None, **cards):
    """Write an image of electrons on the WCS of test_foreign; cards may be BLANK, SATURATE."""
    header = fits.Header(wcs_cards() | {"BUNIT": "electron", "EXPTIME": 100.0} | cards)
    hdus = [fits.PrimaryHDU(), fits.ImageHDU(pixels, header, "SCI")]
    hdus += [] if flags is None else [fits.ImageHDU(flags, name="DQ")]
    fits.HDUList(hdus).writeto(folder / "image.fits")
    return folder / "image.fits"


def injected(folder, image, psf, mag=BRIGHT, x=MIDDLE):
    """Inject a star; return (pixels as stored, truth, message)."""
    said = []
    table = at(x, MIDDLE, mag=[mag])
    run = {name: np.array(table[name]) for name in table.colnames}
    inject([image], run, folder / "out", said.append, psf=psf, zeropoint=ZERO)
    truth = ObjectTable.read((folder / "out" / image.name).with_suffix(".truth.parquet"))
    return fits.getdata(folder / "out" / image.name, "SCI"), truth, said[-1]


@pytest.mark.parametrize("kind", ["uint8", "int16", "uint16", "int32", "uint32", "int64"])
def test_a_full_pixel_of_integers_stays_full(tmp_path, kind):
    """A saturated star and its neighbours one unit lower, under a star: nothing wraps, and all of them count."""
    top = np.iinfo(kind).max
    pixels = np.full((SIDE, SIDE), 5, kind)
    pixels[MIDDLE - 1 : MIDDLE + 2, MIDDLE - 1 : MIDDLE + 2] = top - 1
    pixels[MIDDLE, MIDDLE] = top
    new, _, said = injected(tmp_path, write_pixels(tmp_path, pixels), write_psf(tmp_path))
    assert new.dtype.newbyteorder("=") == pixels.dtype and (new >= pixels).all()
    assert (new[MIDDLE - 1 : MIDDLE + 2, MIDDLE - 1 : MIDDLE + 2] == top).all()
    assert f"; {np.count_nonzero(new == top)} pixels are full" in said
    assert np.array_equal(new[:40], pixels[:40])


@pytest.mark.parametrize("kind", ["uint16", "int32", "float32"])
def test_pixels_above_saturate_keep_their_value(tmp_path, kind):
    """At 1000.5 integers end at 1000; a pixel above it is kept to the bit, and counts."""
    pixels = np.full((SIDE, SIDE), 50, kind)
    pixels[MIDDLE, MIDDLE - 1 : MIDDLE + 2] = 1200, 1000, 40_000
    new, _, said = injected(tmp_path, write_pixels(tmp_path, pixels, SATURATE=1000.5), write_psf(tmp_path))
    assert new[MIDDLE, MIDDLE - 1] == 1200 and new[MIDDLE, MIDDLE + 1] == 40_000
    top = 1000.5 if kind == "float32" else 1000
    assert new[MIDDLE, MIDDLE] == new[MIDDLE + 1, MIDDLE] == top
    assert f"; {np.count_nonzero(new >= top)} pixels are full" in said


def write_ring(folder):
    """Write a PSF whose ring of 8 px radius is below 0, as wings of sharpened images are."""
    axis = np.arange(-15, 16)
    r = np.hypot(axis, axis[:, None])
    fits.writeto(folder / "ring.fits", np.exp(-0.5 * (r / 1.5) ** 2) - 0.0035 * np.exp(-0.5 * ((r - 8) / 1.5) ** 2))
    return folder / "ring.fits"


@pytest.mark.parametrize("kind", ["uint8", "uint16", "int16"])
def test_a_psf_below_zero_does_not_wrap(tmp_path, kind):
    """The ring takes 1,600 electrons from a pixel: integers end at their minimum. A full pixel in it stays full."""
    limits = np.iinfo(kind)
    pixels = np.full((SIDE, SIDE), limits.min + 3, kind)
    pixels[MIDDLE + 8, MIDDLE] = limits.max
    new, _, _ = injected(tmp_path, write_pixels(tmp_path, pixels), write_ring(tmp_path))
    assert new[MIDDLE, MIDDLE - 8] == new[MIDDLE - 8, MIDDLE] == limits.min
    assert new[MIDDLE + 8, MIDDLE] == limits.max


@pytest.mark.parametrize(
    ("kind", "blank", "level", "nearest"),
    [
        ("int16", 32767, 50, 32766), ("int16", -32768, -32760, -32767), ("uint8", 0, 3, 1), ("uint8", 255, 50, 254),
        ("int32", 60, 59, 59), ("int32", 60, 61, 61),
    ],
)  # fmt: skip
def test_no_pixel_becomes_blank(tmp_path, kind, blank, level, nearest):
    """Bright or negative flux ends next to BLANK. So does a faint star's, where a pixel gains or loses one electron."""
    pixels = np.full((SIDE, SIDE), level, kind)
    pixels[0, :9] = blank
    path = write_pixels(tmp_path, pixels, BLANK=blank)
    injected(tmp_path, path, write_ring(tmp_path), mag=BRIGHT if kind != "int32" else 21.5)
    new = raw_pixels(tmp_path / "out/image.fits")
    assert np.count_nonzero(new == blank) == 9 and (new[MIDDLE - 12 : MIDDLE + 13] == nearest).any()
    assert np.ptp(new[MIDDLE - 12 : MIDDLE + 13].astype(int)) > 2


@pytest.mark.parametrize("kind", ["float32", "int16"])
def test_electrons_on_pixels_without_a_value_are_not_counted(tmp_path, kind):
    """Of a star in the first column after a hole, half and half a column are left: Phi(0.5 px / 1.5 px)."""
    pixels = np.full((SIDE, SIDE), 50, kind)
    pixels[:, :MIDDLE] = np.nan if kind == "float32" else -32768
    cards = {} if kind == "float32" else {"BLANK": -32768}
    path, psf = write_pixels(tmp_path, pixels, **cards), write_psf(tmp_path)
    new, truth, said = injected(tmp_path, path, psf, mag=17.0)
    added = (new[:, MIDDLE:].astype(float) - 50).sum()
    assert truth["drawn"] == pytest.approx(added, rel=1e-3)  # of sums rounded to integers
    assert truth["drawn"] / truth["electrons"] == pytest.approx(0.6306, rel=0.01)
    assert "1 object injected, 0 outside the frame or on pixels without a value" in said


@pytest.mark.parametrize("kind", ["float32", "int16"])
def test_an_object_on_no_pixel_with_a_value_is_not_injected(tmp_path, kind):
    pixels = np.full((SIDE, SIDE), np.nan if kind == "float32" else -32768, kind)
    cards = {} if kind == "float32" else {"BLANK": -32768}
    path = write_pixels(tmp_path, pixels, **cards)
    _, truth, said = injected(tmp_path, path, write_psf(tmp_path))
    assert "0 objects injected, 1 outside the frame or on pixels without a value, 0 electrons" in said
    assert len(truth) == 0 and raw_pixels(tmp_path / "out/image.fits").tobytes() == raw_pixels(path).tobytes()


def test_flagged_pixels_with_a_value_receive_flux(tmp_path):
    """Flags of others have many meanings: a jump that was corrected is no hole. Only values that are missing are."""
    flags = np.zeros((SIDE, SIDE), np.int16)
    flags[:, MIDDLE:] = 4
    path = write_pixels(tmp_path, np.full((SIDE, SIDE), 50, np.float32), flags)
    new, truth, _ = injected(tmp_path, path, write_psf(tmp_path), mag=17.0)
    assert truth["drawn"] == pytest.approx((new.astype(float) - 50).sum(), rel=1e-5)
    assert np.array_equal(fits.getdata(tmp_path / "out/image.fits", "DQ"), flags)


@pytest.mark.parametrize(("side", "centre"), [(31, 0.0), (32, 0.0), (32, 0.5)])
def test_the_centre_of_an_even_stamp_is_between_its_middle_pixels(tmp_path, side, centre):
    """A peak on pixel n / 2, counted from 0, is half a sample after the centre, and so is the star."""
    axis = np.arange(side) - (side - 1) / 2 - centre
    fits.writeto(tmp_path / "psf.fits", np.exp(-0.5 * (axis**2 + axis[:, None] ** 2) / 2**2))
    path = write_pixels(tmp_path, np.zeros((SIDE, SIDE), np.float64))
    light, _, _ = injected(tmp_path, path, tmp_path / "psf.fits", mag=10.0, x=MIDDLE + 0.2)
    x = light.sum(axis=0) @ np.arange(SIDE) / light.sum()
    assert x == pytest.approx(MIDDLE + 0.2 + centre, abs=0.005)  # noise: 2 px / sqrt(1e8 electrons)
