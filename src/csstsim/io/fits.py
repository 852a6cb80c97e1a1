"""Read FITS images bit by bit and verify their checksums (io.fits_writing writes them)."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import fitsio
import numpy as np

from csstsim.base.errors import InputError
from csstsim.base.files.file_log import logged
from csstsim.base.files.fits_headers import check_headers
from csstsim.base.types import AnyArray, IntArray, PathLike
from csstsim.io.fits_checksum import BLOCK, CHUNK, LITTLE, folded, sum_of_bytes, sum_of_words

if TYPE_CHECKING:
    from io import FileIO

    from fitsio.hdu.base import HDUBase

PIXELS_MAX = 1 << 28  # of an image that is read: three chips
_DTYPES = {8: "u1", 16: "i2", 32: "i4", -32: "f4"}


def open_fits(path: PathLike) -> fitsio.FITS:
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


def read_header(hdu: HDUBase, path: PathLike) -> dict[str, Any]:
    """Return an HDU's header {keyword: value}. Raises InputError for a header with something that is not a value."""
    try:
        cards = raw_cards(hdu, path)
        if any(text.startswith("CONTINUE") for text in cards):
            return dict(hdu.read_header())  # slow: for each keyword, cfitsio searches from the first card
        header = dict(fitsio.FITSHDR(cards))
    except (OSError, ValueError) as exc:  # also bytes that are not text
        raise InputError(f"a header is damaged: {type(exc).__name__}", file=path) from exc
    return {key: value.rstrip() if isinstance(value, str) else value for key, value in header.items()}


def raw_cards(hdu: HDUBase, path: PathLike) -> list[str]:
    """Return the cards of an HDU's header, without END. Raises ValueError if they are not text, or have no END."""
    offsets = hdu.get_offsets()
    with open(path, "rb") as file:
        file.seek(offsets["header_start"])
        text = file.read(offsets["data_start"] - offsets["header_start"]).decode("ascii")
    cards = [text[i : i + 80] for i in range(0, len(text), 80)]
    return cards[: cards.index("END".ljust(80))]


def verify_hdu(hdu: HDUBase, path: PathLike) -> None:
    """Raise InputError if the checksum of an HDU of the file `path` is missing or wrong."""
    offsets = hdu.get_offsets()
    _check_sum(hdu, path, _sum_of(path, offsets["header_start"], offsets["data_end"]))


def _sum_of(path: PathLike, start: int, stop: int) -> int:
    """Return the sum of the 32-bit words in bytes start..stop of a file."""
    total = 0
    remaining = stop - start
    with open(path, "rb") as file:
        file.seek(start)
        while remaining and (raw := np.fromfile(file, np.uint8, min(remaining, CHUNK * 4))).size:
            total += sum_of_bytes(raw)
            remaining -= raw.size
    return total


def _check_sum(hdu: HDUBase, path: PathLike, total: int) -> None:
    """Raise InputError if the checksum of an HDU whose words sum to `total` is missing or wrong."""
    key = f"HDU {hdu.get_extname() or 'primary'}"
    try:
        has_checksum = any(text.startswith("CHECKSUM=") for text in raw_cards(hdu, path))
    except ValueError:
        raise InputError("a header is damaged", file=path, key=key) from None
    if not has_checksum:
        raise InputError("there is no CHECKSUM", file=path, key=key)
    if folded(total) != 0xFFFFFFFF:
        raise InputError("the file is damaged: wrong CHECKSUM", file=path, key=key)


def image_header(hdu: HDUBase, path: PathLike) -> dict[str, Any]:
    """Return an image extension's header {keyword: value}; that of a compressed one is as before its compression."""
    header = read_header(hdu, path)
    if not hasattr(hdu, "is_compressed"):
        raise InputError("a table where an image belongs", file=path, key=hdu.get_extname())
    shape_keywords = ("BITPIX", "NAXIS", "NAXIS1", "NAXIS2", "PCOUNT")
    return header | {key: header[f"Z{key}"] for key in shape_keywords if hdu.is_compressed() and f"Z{key}" in header}


def read_pixels(hdu: HDUBase, path: PathLike, verify: bool = False) -> AnyArray:
    """Return an image extension's array with the bits that were written (uint16 if BZERO is 32768).

    verify: check its checksum as verify_hdu does, while reading. Raises InputError for an image that does not match
    its header, or compressed data that cannot be unpacked.
    """
    header = image_header(hdu, path)
    bitpix: Any = header.get("BITPIX")
    shape: list[Any] = [header.get(f"NAXIS{i}") for i in range(_number(header.get("NAXIS")), 0, -1)]
    stored = _DTYPES.get(bitpix)
    size = math.prod(map(_number, shape))
    if stored is None or not 0 <= size <= PIXELS_MAX:
        raise InputError("not an image that csstsim writes", file=path, key="BITPIX, NAXIS", value=(bitpix, shape))
    if hdu.is_compressed():
        if verify:
            verify_hdu(hdu, path)
        _check_tiles(read_header(hdu, path), shape, path)
        try:
            return hdu.read()
        except OSError as exc:
            raise InputError(f"cannot be unpacked: {exc}", file=path) from None
    unsigned = header.get("BZERO") == 32768 and stored == "i2"
    data = np.empty(shape, "=u2" if unsigned else f"={stored}")
    offsets = hdu.get_offsets()
    total = _fill(data.reshape(-1), path, offsets["data_start"], verify)
    if verify:
        _check_sum(hdu, path, total + _sum_of(path, offsets["header_start"], offsets["data_start"]))
    return data


def _fill(data: AnyArray, path: PathLike, start: int, verify: bool) -> int:
    """Fill `data` (1-D) from byte `start` of a file; return the sum of its 32-bit words if `verify`, else 0.

    Raises InputError if the file ends too early.
    """
    raw = data.view(np.uint8)
    total = 0
    whole_words = data.itemsize == 4  # each value is a word of the sum
    with open(path, "rb", buffering=0) as file:
        file.seek(start)
        for first in range(0, raw.size, CHUNK):
            piece = raw[first : first + CHUNK]  # stays in the cache between reading, sum and swap
            if _read_into(piece, file) < piece.size:
                raise InputError("the FITS file is cut short", file=path)
            if verify and not whole_words:
                total += sum_of_bytes(piece)
            if LITTLE and data.itemsize > 1:
                piece.view(data.dtype).byteswap(inplace=True)
            if verify and whole_words:
                total += sum_of_words(piece.view(np.uint32))
            if data.dtype == np.uint16:
                piece.view(np.uint16)[:] ^= np.uint16(0x8000)
        if verify:  # the bytes that fill the last block
            padding = np.zeros(-raw.size % BLOCK, np.uint8)
            _read_into(padding, file)
            total += sum_of_bytes(np.concatenate([np.zeros(raw.size % 4, np.uint8), padding]))
    return total


def _read_into(buffer: IntArray, file: FileIO) -> int:
    """Fill `part` (uint8) from a raw file; return the number of bytes, fewer at its end."""
    filled = 0
    # numpy calls its arrays buffers from Python 3.12 on
    while filled < buffer.size and (count := file.readinto(buffer[filled:])):  # type: ignore[arg-type]
        filled += count
    return filled


def _number(value: object) -> int:
    """Return a length in a header; -1 if it is not a number."""
    return value if type(value) is int else -1


def _check_tiles(header: Mapping[str, Any], shape: Sequence[int], path: PathLike) -> None:
    """Raise InputError for tile sizes that would crash cfitsio."""
    sides = [_number(header.get(f"ZTILE{i}", 1 if i > 1 else shape[-1])) for i in range(len(shape), 0, -1)]
    parameters = {header[f"ZNAME{i}"]: header.get(f"ZVAL{i}") for i in range(1, 10) if f"ZNAME{i}" in header}
    valid = all(0 < side <= length for side, length in zip(sides, shape, strict=True))
    valid = valid and header.get("NAXIS2") == math.prod(-(-n // side) for n, side in zip(shape, sides, strict=True))
    valid = valid and parameters.get("BLOCKSIZE", 32) in (16, 32) and parameters.get("BYTEPIX", 2) in (1, 2, 4)
    if not valid:
        raise InputError("its tiles do not make up the image", file=path, key="ZTILE, ZNAME", value=(sides, parameters))
