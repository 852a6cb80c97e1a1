"""csstsim's FITS cards and files against astropy, fitsio and the standard's checksum."""

import numpy as np
import pytest
from astropy.io import fits

from csstsim.base.errors import InputError
from csstsim.io.fits import open_fits, read_pixels
from csstsim.io.fits_writing import card, remark, write_hdus

VALUES = [
    True, False, 0, -12345678901234, 1.5, -8.174558361760018e-06, 1e300, 61582.85900462963, "", "r", "O'Neill",
    "x" * 68, "x" * 69, "q'" * 60, "a b " * 70,
]  # fmt: skip


@pytest.mark.parametrize("value", VALUES, ids=[str(i) for i in range(len(VALUES))])
def test_cards_read_back(value):
    text = card("KEY", value, "a comment")
    assert len(text) % 80 == 0 and text.isascii()
    read = fits.Header.fromstring(text)["KEY"]
    assert type(read) is type(value)
    assert read == (value.rstrip() if isinstance(value, str) else value)


@pytest.mark.parametrize("value", [np.nan, np.inf, None, [1], b"x"])
def test_impossible_values(value):
    with pytest.raises(ValueError, match="cannot hold"):
        card("KEY", value)


@pytest.mark.parametrize("name", ["", "TOOLONGKEY", "low", "SP ACE", "Ä"])
def test_impossible_keywords(name):
    with pytest.raises(ValueError, match="keyword"):
        card(name, 1)


def test_text_outside_ascii_is_escaped():
    assert "\\xe9" in card("KEY", "é") and len(card("KEY", 1.0, "µ" * 90)) == 80
    assert len(remark("HISTORY", "long " * 40)) == 80 * 3


@pytest.mark.parametrize("dtype", ["uint8", "uint16", "int16", "int32", "float32"])
@pytest.mark.parametrize("shape", [(1, 1), (3, 5), (719, 7)])
def test_astropy_reads_the_pixels_and_agrees_on_checksums(tmp_path, dtype, shape):
    info = np.iinfo(dtype) if dtype != "float32" else np.finfo(dtype)
    data = np.linspace(float(info.min) / 2, float(info.max) / 2, np.prod(shape)).astype(dtype).reshape(shape)
    data[0, 0], data[-1, -1] = info.max, info.min
    path = tmp_path / "x.fits"
    write_hdus(path, [("", [card("A", 1)], None), ("ONE", [card("B", "x" * 100)], data), ("TWO", [], data[:1])])
    assert path.stat().st_size % 2880 == 0
    with fits.open(path, checksum=True) as hdus:  # a wrong checksum is a warning, and warnings are errors
        hdus.verify("exception")
        assert hdus[0].header["A"] == 1 and hdus["ONE"].header["B"] == "x" * 100
        assert np.array_equal(hdus["ONE"].data, data)
        assert (
            hdus["TWO"].header["DATASUM"] == fits.ImageHDU(data[:1])._calculate_datasum().__str__() or dtype == "uint16"
        )


def test_large_data_in_several_pieces(tmp_path):
    """More pixels than one piece, an odd number of 16-bit values."""
    data = np.arange((1 << 20) + 12345, dtype=np.uint32).astype(np.uint16).reshape(1, -1)
    write_hdus(tmp_path / "x.fits", [("", [], None), ("ONE", [], data)])
    with fits.open(tmp_path / "x.fits", checksum=True) as hdus:
        assert np.array_equal(hdus["ONE"].data, data)


@pytest.mark.parametrize("at", range(60, 75))
@pytest.mark.parametrize("length", [70, 140, 200])
def test_quotes_of_a_long_text_stay_whole_wherever_it_is_cut(at, length):
    """Quotes at and about the places where a card ends: astropy and fitsio's rules give the text back."""
    text = "".join("'" if at <= k < at + 3 or k % 67 == 66 else "abcdefghij"[k % 10] for k in range(length))
    header = fits.Header.fromstring(card("HISTKEY", text, "a comment"))
    assert header["HISTKEY"] == text
    whole = card("HISTKEY", text)
    for part in (whole[i : i + 80].rstrip() for i in range(0, len(whole), 80)):
        quotes = part[part.index("'") :].count("'")
        assert part.endswith("'") and quotes % 2 == 0  # its own pair, and doubled ones


def test_a_file_that_lacks_its_end_is_refused(tmp_path):
    path = tmp_path / "whole.fits"
    write_hdus(path, [("", [], None), ("IMAGE", [], np.arange(20_000, dtype=np.uint16).reshape(100, 200))])
    open_fits(path).close()
    content = path.read_bytes()
    for missing in (1, 2880, 20_000):
        path.write_bytes(content[:-missing])
        with pytest.raises(InputError, match="cut short"):
            open_fits(path)


@pytest.mark.parametrize("tile", [(1, 40), (30, 40), (7, 11), (1, 1)])
def test_tiles_of_any_side_are_read(tmp_path, tile):
    """Astropy's RICE tiles: rows, the whole image, sides that do not divide it, single pixels."""
    data = np.random.default_rng(1).integers(0, 1000, (30, 40)).astype(np.int16)
    fits.HDUList([fits.PrimaryHDU(), fits.CompImageHDU(data, tile_shape=tile)]).writeto(tmp_path / "x.fits")
    with open_fits(tmp_path / "x.fits") as file:
        assert np.array_equal(read_pixels(file[1], tmp_path / "x.fits"), data)
