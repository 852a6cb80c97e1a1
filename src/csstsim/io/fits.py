"""FITS images on disk, bit-exact, with DATASUM and CHECKSUM (FITS standard 4.0, sections 4 and 5, appendix J).

cfitsio is not used for writing, for three reasons: it turns infinities into NaN, writes the time into the checksum's
comment (so that two identical runs differ), and needs four times the CPU for a frame with checksums.
"""

import math
import sys
from pathlib import Path

import fitsio
import numpy as np

from csstsim.base.errors import InputError
from csstsim.base.files.file_log import logged
from csstsim.base.files.fits_headers import check_headers
from csstsim.io.fits_cards import card

BLOCK = 2880
_LITTLE = sys.byteorder == "little"
_CHUNK = 1 << 18  # pixels converted at a time, so that they stay in the cache
MOST = 1 << 28  # pixels of an image that are read: three chips
_STORED = {8: "u1", 16: "i2", 32: "i4", -32: "f4"}
_BITPIX = {"uint8": 8, "uint16": 16, "int16": 16, "int32": 32, "float32": -32}


def write_hdus(path, hdus):
    """Write a FITS file of a data-less primary HDU and image extensions.

    `hdus` is a list of (name, cards, array): the first has array None; the others any type of _BITPIX, in C order;
    `cards` as made by `card` and `remark`. uint16 is stored as int16 with BZERO 32768.
    """
    with open(path, "wb") as file:
        for name, cards, array in hdus:
            head = _structure(name, array) + list(cards)
            if any(text[80:90] == "CONTINUE  " for text in head):
                head.append(card("LONGSTRN", "OGIP 1.0", "strings go on in CONTINUE cards"))
            start = file.tell()
            file.seek(start + len(_sealed_header(head, 0)))
            datasum = 0 if array is None else _write_data(file, array)
            end = file.tell()
            file.seek(start)
            file.write(_sealed_header(head, datasum))
            file.seek(end)


def _structure(name, array):
    if array is None:
        return [card("SIMPLE", True, "conforms to the FITS standard"), card("BITPIX", 8), card("NAXIS", 0),
                card("EXTEND", True, "extensions may follow")]  # fmt: skip
    cards = [card("XTENSION", "IMAGE", "image extension"), card("BITPIX", _BITPIX[array.dtype.name], "bits per value")]
    cards.append(card("NAXIS", array.ndim, "number of axes"))
    cards += [card(f"NAXIS{i + 1}", n, f"length of axis {i + 1}") for i, n in enumerate(array.shape[::-1])]
    cards += [card("PCOUNT", 0, "no parameters"), card("GCOUNT", 1, "one group")]
    if array.dtype == np.uint16:
        cards += [card("BSCALE", 1, "value = BSCALE x stored + BZERO"), card("BZERO", 32768, "unsigned 16 bits")]
    return [*cards, card("EXTNAME", name, "name of this extension")]


def _write_data(file, array):
    flat = np.ascontiguousarray(array).reshape(-1)
    total = 0
    for start in range(0, flat.size, _CHUNK):
        part = flat[start : start + _CHUNK]
        if part.dtype == np.uint16:
            part = part ^ np.uint16(0x8000)
        data = part.byteswap() if _LITTLE and part.itemsize > 1 else part
        raw = data.view(np.uint8)
        if start + _CHUNK >= flat.size:
            raw = np.concatenate([raw, np.zeros(-(flat.nbytes) % BLOCK, np.uint8)])
        total += _sum(part.view(np.uint32)) if part.itemsize == 4 else _word_sum(raw)
        file.write(raw)
    return _fold(total)


def _sum(words):
    return int(words.sum(dtype=np.uint64))


def _word_sum(raw):
    """Return the sum of the big-endian 32-bit words in bytes (uint8 array), the last filled with zeros."""
    raw = np.concatenate([raw, np.zeros(-raw.size % 4, np.uint8)]) if raw.size % 4 else raw
    words = raw.view(np.uint32)
    return _sum(words.byteswap() if _LITTLE else words)


def _fold(total):
    """Return a sum as a 32-bit ones' complement number: carries are added back."""
    while total >> 32:
        total = (total & 0xFFFFFFFF) + (total >> 32)
    return total


def _sealed_header(head, datasum):
    """Return the header's bytes with DATASUM and a CHECKSUM that makes the HDU's sum all ones."""
    data = card("DATASUM", str(datasum), "checksum of the data")
    blank = _pad([*head, card("CHECKSUM", "0" * 16, "checksum of the HDU"), data])
    total = _fold(_word_sum(np.frombuffer(blank, np.uint8)) + datasum)
    return _pad([*head, card("CHECKSUM", _encode(0xFFFFFFFF - total), "checksum of the HDU"), data])


def _pad(cards):
    text = "".join([*cards, "END".ljust(80)])
    return text.ljust(BLOCK * math.ceil(len(text) / BLOCK)).encode("ascii")


def _encode(value):
    """Return 16 letters and digits whose four words sum to `value` (appendix J), rotated by one byte."""
    punctuation = {*range(0x3A, 0x41), *range(0x5B, 0x61)}
    text = bytearray(16)
    for i, byte in enumerate(value.to_bytes(4, "big")):
        letters = [byte // 4 + 0x30] * 4
        letters[0] += byte % 4
        while punctuation & set(letters):
            for j in (0, 2):
                if punctuation & set(letters[j : j + 2]):
                    letters[j] += 1
                    letters[j + 1] -= 1
        text[i::4] = bytes(letters)
    return (text[-1:] + text[:-1]).decode()


def open_fits(path):
    """Return an open fitsio.FITS for reading; InputError if `path` is missing, cut short or not FITS."""
    path = Path(path)
    if not path.is_file():
        raise InputError("no such file", file=path)
    check_headers(path)
    try:
        with logged("opened", path):
            file = fitsio.FITS(path)
        end = file[len(file) - 1].get_offsets()["data_end"]
    # fitsio cannot decode cfitsio's message about damaged bytes
    except (OSError, ValueError, fitsio.FITSFormatError) as exc:
        why = str(exc).splitlines()[0] if isinstance(exc, OSError) and str(exc) else "a header is damaged"
        raise InputError(f"not a readable FITS file: {why}", file=path) from None
    if end > path.stat().st_size:
        file.close()
        raise InputError("the FITS file is cut short", file=path)
    return file


def read_header(hdu, path):
    """Return an HDU's header {keyword: value}. Raises InputError for a header with something that is not a value."""
    try:
        cards = raw_cards(hdu, path)
        if any(text.startswith("CONTINUE") for text in cards):
            return dict(hdu.read_header())  # slow: cfitsio looks for each keyword from the first card on
        header = dict(fitsio.FITSHDR(cards))
    except (OSError, ValueError) as exc:  # also bytes that are not text
        raise InputError(f"a header is damaged: {type(exc).__name__}", file=path) from exc
    return {key: value.rstrip() if isinstance(value, str) else value for key, value in header.items()}


def raw_cards(hdu, path):
    """Return the cards of an HDU's header, without END. Raises ValueError if they are not text, or have no END."""
    offsets = hdu.get_offsets()
    with open(path, "rb") as file:
        file.seek(offsets["header_start"])
        text = file.read(offsets["data_start"] - offsets["header_start"]).decode("ascii")
    cards = [text[i : i + 80] for i in range(0, len(text), 80)]
    return cards[: cards.index("END".ljust(80))]


def verify_hdu(hdu, path):
    """Raise InputError if the checksum of an HDU of the file `path` is missing or wrong."""
    offsets = hdu.get_offsets()
    _check_sum(hdu, path, _sum_of(path, offsets["header_start"], offsets["data_end"]))


def _sum_of(path, start, stop):
    """Return the sum of the 32-bit words in bytes start..stop of a file."""
    total, left = 0, stop - start
    with open(path, "rb") as file:
        file.seek(start)
        while left and (raw := np.fromfile(file, np.uint8, min(left, _CHUNK * 4))).size:
            total += _word_sum(raw)
            left -= raw.size
    return total


def _check_sum(hdu, path, total):
    """Raise InputError if the checksum of an HDU whose words sum to `total` is missing or wrong."""
    key = f"HDU {hdu.get_extname() or 'primary'}"
    try:
        sealed = any(text.startswith("CHECKSUM=") for text in raw_cards(hdu, path))
    except ValueError:
        raise InputError("a header is damaged", file=path, key=key) from None
    if not sealed:
        raise InputError("there is no CHECKSUM", file=path, key=key)
    if _fold(total) != 0xFFFFFFFF:
        raise InputError("the file is damaged: wrong CHECKSUM", file=path, key=key)


def compress(path, without=()):
    """Replace the image extensions of a FITS file by tile-compressed ones (RICE, one row per tile), without loss.

    without: keywords that the primary header loses.
    """
    from astropy.io import fits  # takes half a second, needed only for compressed files

    with fits.open(path, memmap=False) as file:
        hdus = [file[0].copy()]
        for name in without:
            hdus[0].header.remove(name, ignore_missing=True)
        for hdu in file[1:]:
            for name in ("CHECKSUM", "DATASUM"):
                hdu.header.remove(name, ignore_missing=True)
            tile = (1, hdu.data.shape[1])
            hdus.append(fits.CompImageHDU(hdu.data, hdu.header, compression_type="RICE_1", tile_shape=tile))
    fits.HDUList(hdus).writeto(path, overwrite=True, checksum=True)
    _reseal(path)


def _reseal(path):
    """Give every header the checksum cards of this module: astropy's have the time in their comments."""
    with open_fits(path) as file:
        places = [(hdu.get_offsets()["header_start"], hdu.get_offsets()["data_start"]) for hdu in file]
    with open(path, "r+b") as raw:
        for start, stop in places:
            raw.seek(start)
            text = raw.read(stop - start).decode()
            cards = [text[i : i + 80] for i in range(0, len(text), 80)]
            cards = cards[: cards.index("END".ljust(80))]
            datasum = next(int(text[11:].split("'")[0]) for text in cards if text.startswith("DATASUM "))
            raw.seek(start)
            raw.write(_sealed_header([c for c in cards if not c.startswith(("CHECKSUM", "DATASUM "))], datasum))


def image_header(hdu, path):
    """Return an image extension's header {keyword: value}; of a compressed one as it would be uncompressed."""
    header = read_header(hdu, path)
    if not hasattr(hdu, "is_compressed"):
        raise InputError("a table where an image belongs", file=path, key=hdu.get_extname())
    kept = ("BITPIX", "NAXIS", "NAXIS1", "NAXIS2", "PCOUNT")
    return header | {key: header[f"Z{key}"] for key in kept if hdu.is_compressed() and f"Z{key}" in header}


def read_pixels(hdu, path, verify=False):
    """Return an image extension's array with the bits that were written (uint16 where BZERO says so).

    verify: check its sum as verify_hdu does, in the same pass. Raises InputError for an image that does not match its
    header, or compressed data that cannot be unpacked.
    """
    header = image_header(hdu, path)
    shape = [header.get(f"NAXIS{i}") for i in range(_number(header.get("NAXIS")), 0, -1)]
    stored, size = _STORED.get(header.get("BITPIX")), math.prod(map(_number, shape))
    if stored is None or not 0 <= size <= MOST:
        raise InputError(
            "not an image that csstsim writes", file=path, key="BITPIX, NAXIS", value=(header.get("BITPIX"), shape)
        )
    if hdu.is_compressed():
        if verify:
            verify_hdu(hdu, path)
        _check_tiles(read_header(hdu, path), shape, path)
        try:
            return hdu.read()
        except OSError as exc:
            raise InputError(f"cannot be unpacked: {exc}", file=path) from None
    unsigned = header.get("BZERO") == 32768 and stored == "i2"
    data, places = np.empty(shape, np.uint16 if unsigned else f"={stored}"), hdu.get_offsets()
    total = _fill(data.reshape(-1), path, places["data_start"], verify)
    if verify:
        _check_sum(hdu, path, total + _sum_of(path, places["header_start"], places["data_start"]))
    return data


def _fill(data, path, start, verify):
    """Read the values of `data` (1-D) from byte `start` of a file on; return the sum of its 32-bit words if `verify`.

    Raises InputError for a file that ends before.
    """
    raw, total = data.view(np.uint8), 0
    wide = data.itemsize == 4  # its words are the values
    with open(path, "rb", buffering=0) as file:
        file.seek(start)
        for at in range(0, raw.size, _CHUNK):
            part = raw[at : at + _CHUNK]  # stays in the cache between reading, sum and swap
            if _read_into(part, file) < part.size:
                raise InputError("the FITS file is cut short", file=path)
            if verify and not wide:
                total += _word_sum(part)
            if _LITTLE and data.itemsize > 1:
                part.view(data.dtype).byteswap(inplace=True)
            if verify and wide:
                total += _sum(part.view(np.uint32))
            if data.dtype == np.uint16:
                part.view(np.uint16)[:] ^= np.uint16(0x8000)
        if verify:  # what fills the last block
            rest = np.zeros(-raw.size % BLOCK, np.uint8)
            _read_into(rest, file)
            total += _word_sum(np.concatenate([np.zeros(raw.size % 4, np.uint8), rest]))
    return total


def _read_into(part, file):
    """Fill `part` (uint8) from a raw file; return the number of bytes, fewer at its end."""
    done = 0
    while done < part.size and (count := file.readinto(part[done:])):
        done += count
    return done


def _number(value):
    """Return a length in a header; -1 if it is not a number."""
    return value if type(value) is int else -1


def _check_tiles(header, shape, path):
    """Raise InputError for sizes of tiles that would crash cfitsio."""
    sides = [_number(header.get(f"ZTILE{i}", 1 if i > 1 else shape[-1])) for i in range(len(shape), 0, -1)]
    parameters = {header[f"ZNAME{i}"]: header.get(f"ZVAL{i}") for i in range(1, 10) if f"ZNAME{i}" in header}
    good = all(0 < side <= length for side, length in zip(sides, shape, strict=True))
    good = good and header.get("NAXIS2") == math.prod(-(-n // side) for n, side in zip(shape, sides, strict=True))
    good = good and parameters.get("BLOCKSIZE", 32) in (16, 32) and parameters.get("BYTEPIX", 2) in (1, 2, 4)
    if not good:
        raise InputError("its tiles do not make up the image", file=path, key="ZTILE, ZNAME", value=(sides, parameters))
