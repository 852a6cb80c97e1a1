"""Headers of FITS files read block by block: data and padding are not taken for a header, null characters refused."""

import os

import numpy as np
import pytest
from astropy.io import fits

from csstsim.base.errors import InputError
from csstsim.base.files.fits_headers import BLOCK, CARD, check_headers

CARDS = b"".join(card.ljust(CARD) for card in (b"NAXIS1  =                   -5", b"END"))


@pytest.mark.parametrize("blocks", [0.5, 1.0, 1.5, 2.0, 2.5])
def test_data_that_look_like_cards_are_data(tmp_path, blocks):
    """The last block of the first image, whole or not, holds a length that no header may have."""
    image = np.zeros(int(blocks * BLOCK), np.uint8)
    last = (len(image) - 1) // BLOCK * BLOCK
    image[last : last + len(CARDS)] = np.frombuffer(CARDS, np.uint8)
    file = tmp_path / "two.fits"
    fits.HDUList([fits.PrimaryHDU(image), fits.ImageHDU(np.zeros(7, np.int16))]).writeto(file)
    check_headers(file)
    content = file.read_bytes()
    assert content.count(b"NAXIS1  =                    7") == 1
    file.write_bytes(content.replace(b"NAXIS1  =                    7", b"NAXIS1  =                   -7"))
    with pytest.raises(InputError, match=r"NAXIS1.*-7"):
        check_headers(file)


def test_the_heap_of_a_table_is_data(tmp_path):
    """Lists of any length stand behind the rows: cut there the file is cut short, and the next header comes after."""
    lists = fits.Column("a", "PB()", array=np.array([np.full(k, 5, np.uint8) for k in (4000, 3000)], object))
    file = tmp_path / "heap.fits"
    fits.HDUList(
        [fits.PrimaryHDU(), fits.BinTableHDU.from_columns([lists]), fits.ImageHDU(np.zeros(7, np.int16))]
    ).writeto(file)
    check_headers(file)
    content = file.read_bytes()
    file.write_bytes(content.replace(b"NAXIS1  =                    7", b"NAXIS1  =                   -7"))
    with pytest.raises(InputError, match=r"NAXIS1.*-7"):
        check_headers(file)
    file.write_bytes(content[: len(content) - 4 * BLOCK])  # the image and the last block of the heap
    with pytest.raises(InputError, match="cut short"):
        check_headers(file)


@pytest.mark.parametrize(("key", "value", "good"), [
    ("ZTILE1", 0, False), ("ZTILE1", 1, True), ("ZNAXIS1", 1 << 28, True), ("ZNAXIS1", (1 << 28) + 1, False),
    ("ZTILE2", -1, False), ("TFIELDS", 0, True), ("NAXIS", 1000, False), ("TFIELDS", 1000, False),
    ("PCOUNT", -1, False), ("NAXIS1", "7.5", False), ("BITPIX", -32, True), ("ZBITPIX", 0, True),
])  # fmt: skip
def test_lengths_are_whole_and_not_too_large_and_divisors_are_not_0(tmp_path, key, value, good):
    file = tmp_path / "one.fits"
    cards = {"SIMPLE": "T", "BITPIX": 8, "NAXIS": 0} | {key: value}
    text = "".join(f"{name:8}= {number:>20}".ljust(CARD) for name, number in cards.items()) + "END".ljust(CARD)
    file.write_bytes(text.ljust(BLOCK).encode())
    if good:
        check_headers(file)
        return
    with pytest.raises(InputError, match=rf"{key}: a header is damaged: no length \(got '{value}'\)"):
        check_headers(file)


@pytest.mark.parametrize("place", [0, 4, 10, 79])
def test_a_null_character_in_a_card_is_refused(tmp_path, place):
    file = tmp_path / "null.fits"
    fits.PrimaryHDU(header=fits.Header({"OBSERVER": "A"})).writeto(file)
    content = bytearray(file.read_bytes())
    content[content.index(b"OBSERVER") + place] = 0
    file.write_bytes(content)
    with pytest.raises(InputError, match="null character"):
        check_headers(file)


def test_null_characters_behind_the_last_hdu_are_padding(tmp_path):
    file = tmp_path / "padded.fits"
    fits.PrimaryHDU(np.zeros(7, np.int16)).writeto(file)
    file.write_bytes(file.read_bytes() + bytes(2 * BLOCK))
    check_headers(file)


def test_pipes_and_cut_files_are_refused(tmp_path):
    os.mkfifo(tmp_path / "pipe.fits")
    with pytest.raises(InputError, match="not a file"):
        check_headers(tmp_path / "pipe.fits")
    file = tmp_path / "cut.fits"
    fits.HDUList([fits.PrimaryHDU(), fits.BinTableHDU(np.zeros(1000, [("a", "f8")]))]).writeto(file)
    content = file.read_bytes()
    for length in (len(content) - BLOCK, 2 * BLOCK + 8):
        file.write_bytes(content[:length])
        with pytest.raises(InputError, match="cut short"):
            check_headers(file)
    file.write_bytes(content[: 3 * BLOCK + 8000 - BLOCK])  # without the padding behind the data
    check_headers(file)
