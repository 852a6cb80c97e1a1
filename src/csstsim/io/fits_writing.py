"""Write FITS images: header cards, and image extensions with DATASUM and CHECKSUM (FITS standard 4.0).

cfitsio is not used for writing, for three reasons: it turns infinities into NaN, writes the time into the checksum's
comment (so that two identical runs differ), and needs four times the CPU for a frame with checksums.
"""

import math
from collections.abc import Iterable, Sequence
from typing import Any, BinaryIO, TypeAlias

import numpy as np

from csstsim.base.types import AnyArray, PathLike
from csstsim.io.fits import open_fits, raw_cards
from csstsim.io.fits_checksum import BLOCK, CHUNK, LITTLE, encoded, folded, sum_of_bytes, sum_of_words

_BITPIX = {"uint8": 8, "uint16": 16, "int16": 16, "int32": 32, "float32": -32}
CardValue: TypeAlias = str | float | np.bool_ | np.integer[Any] | np.floating[Any]


def card(keyword: str, value: CardValue, comment: str = "") -> str:
    """Return the 80 characters of a header card; a string too long for one card continues in CONTINUE cards.

    A comment that does not fit is cut; characters outside ASCII are written as escapes. Raises ValueError for
    a keyword, number or type that FITS cannot hold.
    """
    if not (0 < len(keyword) <= 8 and all(c.isascii() and (c.isupper() or c.isdigit() or c in "-_") for c in keyword)):
        raise ValueError(f"not a FITS keyword: {keyword!r}")
    tail = f" / {as_ascii(comment)}" if comment else ""
    if isinstance(value, bool | np.bool_):
        text = f"{'T' if value else 'F':>20}"
    elif isinstance(value, int | np.integer):
        text = f"{int(value):>20}"
    elif isinstance(value, float | np.floating) and math.isfinite(value):
        text = f"{float(value)!r:>20}".upper()
    elif isinstance(value, str):
        return _string_card(keyword, as_ascii(value).replace("'", "''"), tail)
    else:
        raise ValueError(f"{keyword}: a FITS card cannot hold {value!r}")
    return f"{keyword:<8}= {text}{tail}"[:80].ljust(80)


def _string_card(keyword: str, text: str, tail: str) -> str:
    if len(text) <= 68:
        quoted = f"'{text:<8}'"
        return f"{keyword:<8}= {quoted:<20}{tail}"[:80].ljust(80)
    lines = []
    prefix = f"{keyword:<8}= "
    while len(text) > 67:
        cut = 67 - (text[:67].count("'") % 2)  # a doubled quote stays on one card
        lines.append(f"{prefix}'{text[:cut]}&'".ljust(80))
        text = text[cut:]
        prefix = "CONTINUE  "
    return "".join([*lines, f"{prefix}'{text}'{tail}"[:80].ljust(80)])


def remark(keyword: str, text: str = "") -> str:
    """Return COMMENT, HISTORY or blank cards for a text of any length."""
    text = as_ascii(text)
    return "".join(f"{keyword:<8}{text[i : i + 72]}".ljust(80) for i in range(0, max(len(text), 1), 72))


def as_ascii(text: str) -> str:
    """Return a text in the characters that FITS allows: escapes for others, blanks for those that do not print."""
    text = str(text).encode("ascii", "backslashreplace").decode()
    return "".join(c if 32 <= ord(c) < 127 else " " for c in text)


def write_hdus(path: PathLike, hdus: Iterable[tuple[str, Sequence[str], AnyArray | None]]) -> None:
    """Write a FITS file of a data-less primary HDU and image extensions.

    hdus: (name, cards, array) of each. The array of the first is None, those of the others have a type of _BITPIX and
    C order; cards: as made by `card` and `remark`. uint16 is stored as int16 with BZERO 32768.
    """
    with open(path, "wb") as file:
        for name, cards, array in hdus:
            header_cards = _structure(name, array) + list(cards)
            if any(text[80:90] == "CONTINUE  " for text in header_cards):
                header_cards.append(card("LONGSTRN", "OGIP 1.0", "strings go on in CONTINUE cards"))
            start = file.tell()
            file.seek(start + len(_header_with_checksum(header_cards, 0)))
            datasum = 0 if array is None else _write_data(file, array)
            end = file.tell()
            file.seek(start)
            file.write(_header_with_checksum(header_cards, datasum))
            file.seek(end)


def _structure(name: str, array: AnyArray | None) -> list[str]:
    if array is None:
        return [
            card("SIMPLE", True, "conforms to the FITS standard"),
            card("BITPIX", 8),
            card("NAXIS", 0),
            card("EXTEND", True, "extensions may follow"),
        ]
    cards = [card("XTENSION", "IMAGE", "image extension"), card("BITPIX", _BITPIX[array.dtype.name], "bits per value")]
    cards.append(card("NAXIS", array.ndim, "number of axes"))
    cards += [card(f"NAXIS{i + 1}", n, f"length of axis {i + 1}") for i, n in enumerate(array.shape[::-1])]
    cards += [card("PCOUNT", 0, "no parameters"), card("GCOUNT", 1, "one group")]
    if array.dtype == np.uint16:
        cards += [card("BSCALE", 1, "value = BSCALE x stored + BZERO"), card("BZERO", 32768, "unsigned 16 bits")]
    return [*cards, card("EXTNAME", name, "name of this extension")]


def _write_data(file: BinaryIO, array: AnyArray) -> int:
    flat = np.ascontiguousarray(array).reshape(-1)
    total = 0
    for start in range(0, flat.size, CHUNK):
        piece = flat[start : start + CHUNK]
        if piece.dtype == np.uint16:
            piece = piece ^ np.uint16(0x8000)
        data = piece.byteswap() if LITTLE and piece.itemsize > 1 else piece
        raw = data.view(np.uint8)
        if start + CHUNK >= flat.size:
            raw = np.concatenate([raw, np.zeros(-(flat.nbytes) % BLOCK, np.uint8)])
        total += sum_of_words(piece.view(np.uint32)) if piece.itemsize == 4 else sum_of_bytes(raw)
        file.write(raw)  # type: ignore[call-overload] # numpy calls its arrays buffers from Python 3.12 on
    return folded(total)


def _header_with_checksum(header_cards: Sequence[str], datasum: int) -> bytes:
    """Return the header's bytes with DATASUM and a CHECKSUM that makes the HDU's sum all ones."""
    data = card("DATASUM", str(datasum), "checksum of the data")
    without_sum = _pad([*header_cards, card("CHECKSUM", "0" * 16, "checksum of the HDU"), data])
    total = folded(sum_of_bytes(np.frombuffer(without_sum, np.uint8)) + datasum)
    return _pad([*header_cards, card("CHECKSUM", encoded(0xFFFFFFFF - total), "checksum of the HDU"), data])


def _pad(cards: Sequence[str]) -> bytes:
    text = "".join([*cards, "END".ljust(80)])
    return text.ljust(BLOCK * math.ceil(len(text) / BLOCK)).encode("ascii")


def compress(path: PathLike, without: Iterable[str] = ()) -> None:
    """Replace the image extensions of a FITS file by tile-compressed ones (RICE, one row per tile), without loss.

    without: keywords that are removed from the primary header.
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
    _rewrite_checksums(path)


def _rewrite_checksums(path: PathLike) -> None:
    """Replace the checksum cards of every header by those of this module: astropy's comments contain the time."""
    with open_fits(path) as file:
        headers = [(hdu.get_offsets()["header_start"], raw_cards(hdu, path)) for hdu in file]
    with open(path, "r+b") as raw:
        for start, cards in headers:
            datasum = next(int(text[11:].split("'")[0]) for text in cards if text.startswith("DATASUM "))
            raw.seek(start)
            raw.write(_header_with_checksum([c for c in cards if not c.startswith(("CHECKSUM", "DATASUM "))], datasum))
