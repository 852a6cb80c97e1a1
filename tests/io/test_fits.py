"""csstsim's FITS cards and files against astropy, fitsio and the standard's checksum."""

import numpy as np
import pytest
from astropy.io import fits

from csstsim.base.errors import InputError
from csstsim.io.fits import _check_tiles, image_header, open_fits, read_header, read_pixels, verify_hdu
from csstsim.io.fits_checksum import encoded, folded, sum_of_bytes, sum_of_words
from csstsim.io.fits_writing import card, compress, remark, write_hdus

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
    """Quotes at and near the end of a card: astropy and fitsio's rules give the text back."""
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


def test_our_reader_gives_the_bits_of_every_type(tmp_path):
    """Odd counts of bytes, unlike sides, all types, with and without the checksum in the same pass."""
    rng, path = np.random.default_rng(2), tmp_path / "x.fits"
    planes = {
        kind: rng.integers(0, 2**16, (3, 7), dtype=np.uint16).astype(kind) for kind in ("uint8", "uint16", "int16")
    } | {kind: rng.integers(0, 2**32, (3, 7), dtype=np.uint32).view(kind) for kind in ("int32", "float32")}
    write_hdus(path, [("", [], None), *((kind.upper(), [], plane) for kind, plane in planes.items())])
    with open_fits(path) as file:
        for kind, plane in planes.items():
            for verify in (False, True):
                found = read_pixels(file[kind.upper()], path, verify)
                assert found.dtype == plane.dtype and found.shape == (3, 7) and found.tobytes() == plane.tobytes()


@pytest.mark.parametrize("kind", ["uint8", "uint16", "float32"])
def test_a_bit_anywhere_in_an_hdu_is_missed_by_its_sum(tmp_path, kind):
    """In the header, the first and the last value, and the filling of the last block."""
    data, path = np.arange(1, 1442).astype(kind).reshape(11, 131), tmp_path / "x.fits"
    write_hdus(path, [("", [], None), ("ONE", [card("A", 1, "a remark")], data)])
    whole = path.read_bytes()
    start = whole.index(b"XTENSION")
    body = start + 2880
    for position in (start + whole[start:].index(b"a remark"), body + 1, body + data.nbytes - 1, len(whole) - 1):
        changed = bytearray(whole)
        changed[position] ^= 2
        path.write_bytes(changed)
        with open_fits(path) as file:
            with pytest.raises(InputError, match="HDU ONE: the file is damaged: wrong CHECKSUM"):
                read_pixels(file[1], path, verify=True)
            with pytest.raises(InputError, match="HDU ONE: the file is damaged: wrong CHECKSUM"):
                verify_hdu(file[1], path)
            verify_hdu(file[0], path)


def test_a_header_is_read_as_astropy_reads_it(tmp_path):
    """Types, blanks at the end, words that go on over several cards."""
    path = tmp_path / "x.fits"
    values = {"WHOLE": 7, "REAL": -2.5e-7, "YES": True, "NO": False, "WORD": "a b", "LONG": "x" * 150}
    for names in (("WHOLE", "REAL", "YES", "NO", "WORD"), tuple(values)):
        cards = [card(name, values[name], "said") for name in names]
        write_hdus(path, [("", cards, None), ("ONE", [], np.ones((2, 3), np.int16))])
        with open_fits(path) as file, fits.open(path) as reference:
            found = read_header(file[0], path)
            assert {name: found[name] for name in names} == {name: reference[0].header[name] for name in names}
            assert all(type(found[name]) is type(values[name]) for name in names)
            one = image_header(file[1], path)
            assert (one["NAXIS1"], one["NAXIS2"], one["BITPIX"]) == (3, 2, 16)


def test_a_packed_image_has_the_header_of_the_plain_one(tmp_path):
    data, path = np.arange(77, dtype=np.uint16).reshape(7, 11), tmp_path / "x.fits"
    write_hdus(path, [("", [card("GONE", 1), card("STAYS", 2)], None), ("ONE", [card("B", 3)], data)])
    compress(path, without=["GONE", "NEVER"])
    with open_fits(path) as file:
        assert "GONE" not in read_header(file[0], path) and read_header(file[0], path)["STAYS"] == 2
        header = image_header(file["ONE"], path)
        assert [header[name] for name in ("BITPIX", "NAXIS", "NAXIS1", "NAXIS2", "B")] == [16, 2, 11, 7, 3]
        assert (header["ZTILE1"], header["ZTILE2"], header["ZCMPTYPE"]) == (11, 1, "RICE_1")
        assert np.array_equal(read_pixels(file["ONE"], path, verify=True), data)


def test_a_table_or_an_image_of_doubles_is_refused(tmp_path):
    path = tmp_path / "x.fits"
    table = fits.BinTableHDU(np.zeros(3, [("a", "i4")]), name="T")
    fits.HDUList([fits.PrimaryHDU(), table, fits.ImageHDU(np.zeros((2, 3)), name="D")]).writeto(path)
    with open_fits(path) as file:
        with pytest.raises(InputError, match="T: a table where an image belongs"):
            image_header(file["T"], path)
        with pytest.raises(InputError, match=r"not an image that csstsim writes.*-64, \[2, 3\]"):
            read_pixels(file["D"], path)


def test_bytes_are_added_as_big_endian_words_with_their_carries():
    """By hand: 0x01020304 + 0x05060000; and the carry of the ones' complement."""
    assert sum_of_bytes(np.array([1, 2, 3, 4, 5, 6], np.uint8)) == 0x01020304 + 0x05060000
    assert sum_of_words(np.full(3, 2**32 - 1, np.uint32)) == 3 * (2**32 - 1)
    assert folded(0xFFFFFFFF) == 0xFFFFFFFF and folded(0x1_0000_0000) == 1 and folded(0x2_FFFF_FFFF) == 2
    assert encoded(0) == "0" * 16  # the standard's own example of zeros


def test_cards_keep_the_standards_columns():
    assert card("A", 5, "said") == f"{'A       =                    5 / said':<80}"
    assert card("LONGNAME", True) == f"{'LONGNAME=                    T':<80}"
    assert card("A-_1", "x'y") == "A-_1    = 'x''y    '".ljust(80)
    assert card("A", "x", "c").index(" / c") == 30 and card("A", 1e-5)[10:30] == f"{'1E-05':>20}"
    assert remark("COMMENT", "a" * 73) == f"COMMENT {'a' * 72}{'COMMENT a':<80}"
    assert remark("HISTORY") == f"{'HISTORY':<80}"


def test_a_bit_of_a_compressed_image_is_missed_by_its_sum(tmp_path):
    """In the header, so that the pixels can still be unpacked."""
    path, image = tmp_path / "x.fits", fits.CompImageHDU(np.arange(600, dtype=np.int16).reshape(20, 30), name="ONE")
    image.header["A"] = (1, "a remark")
    fits.HDUList([fits.PrimaryHDU(), image]).writeto(path, checksum=True)
    with open_fits(path) as file:
        assert read_pixels(file[1], path, verify=True)[19, 29] == 599
    path.write_bytes(path.read_bytes().replace(b"a remark", b"A remark"))
    with open_fits(path) as file:
        assert read_pixels(file[1], path)[19, 29] == 599
        with pytest.raises(InputError, match="HDU ONE: the file is damaged: wrong CHECKSUM"):
            read_pixels(file[1], path, verify=True)


@pytest.mark.parametrize(("changes", "good"), [
    ({}, True), ({"ZTILE1": 20, "NAXIS2": 60}, True), ({"ZTILE1": 21, "NAXIS2": 60}, True),
    ({"NAXIS2": 29}, False), ({"NAXIS2": 31}, False), ({"ZTILE1": 20}, False), ({"ZTILE1": 41}, False),
    ({"ZTILE1": 0}, False), ({"ZTILE1": 41, "NAXIS2": 31}, False), ({"ZTILE2": 30, "NAXIS2": 1}, True),
    ({"ZTILE2": 31, "NAXIS2": 1}, False), ({"ZTILE2": "x"}, False),
    ({"ZNAME1": "BLOCKSIZE", "ZVAL1": 16}, True), ({"ZNAME1": "BLOCKSIZE", "ZVAL1": 64}, False),
    ({"ZNAME2": "BYTEPIX", "ZVAL2": 4}, True), ({"ZNAME2": "BYTEPIX", "ZVAL2": 8}, False),
    ({"ZNAME9": "BYTEPIX", "ZVAL9": 3}, False), ({"NAXIS2": 31, "ZNAME1": "BLOCKSIZE", "ZVAL1": 32}, False),
])  # fmt: skip
def test_tiles_make_up_the_image(changes, good):
    """Of 30 rows of 40 pixels, by default a tile each; each fault alone, with other values right."""
    if good:
        _check_tiles({"NAXIS2": 30} | changes, [30, 40], "x.fits")
        return
    with pytest.raises(InputError, match=r"x\.fits: ZTILE, ZNAME: its tiles do not make up the image"):
        _check_tiles({"NAXIS2": 30} | changes, [30, 40], "x.fits")


def test_characters_that_do_not_print_are_blanks_and_long_words_announce_their_convention(tmp_path):
    """A header has characters 32 to 126 alone; LONGSTRN stands where CONTINUE does, and nowhere else."""
    assert card("A", "a\nb\tc\x7fd")[11:18] == "a b c d" and remark("HISTORY", "x\ny")[8:11] == "x y"
    path, one = tmp_path / "x.fits", np.ones((2, 3), np.int16)
    write_hdus(path, [("", [card("A", "x" * 68)], None), ("ONE", [card("A", "x" * 69)], one), ("TWO", [], one)])
    with fits.open(path, checksum=True) as file:
        assert ["LONGSTRN" in hdu.header for hdu in file] == [False, True, False]
        assert file["ONE"].header["LONGSTRN"] == "OGIP 1.0" and file["ONE"].header["A"] == "x" * 69
