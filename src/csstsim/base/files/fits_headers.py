"""Checks of FITS headers before a library reads a file: damaged headers crash cfitsio or hang astropy."""

from __future__ import annotations

import math
import os
import re
from typing import TYPE_CHECKING

from csstsim.base.errors import InputError

if TYPE_CHECKING:
    from typing import BinaryIO

    from csstsim.base.types import PathLike

BLOCK = 2880
CARD = 80
MAX_TILE = 1 << 28  # values along an axis of a compressed image or its tiles
MAX_FIELDS = 999  # columns, by the FITS standard
MAX_AXES = 999  # by the FITS standard
_LENGTH = re.compile(r"(BITPIX|NAXIS\d*|PCOUNT|GCOUNT|TFIELDS|ZNAXIS\d*|ZTILE\d+)")
_INTEGER = re.compile(r"[+-]?\d{1,18}")


def check_headers(path: PathLike) -> None:
    """Raise InputError for null characters and impossible lengths in headers, for pipes, devices and truncated files.

    A length must be a whole number, not negative, not too large, and not 0 if it is a divisor. Files that are missing
    or not FITS are refused by the reader.
    """
    if not os.path.exists(path):
        return
    if not os.path.isfile(path):
        raise InputError("not a file", file=path)
    size = os.stat(path).st_size
    start = 0
    with open(path, "rb") as file:
        while start < size:
            file.seek(start)
            lengths, blocks = _lengths(file, path)
            if lengths is None:
                return
            sides = [value for key, value in lengths.items() if re.fullmatch(r"NAXIS\d+", key)]
            values = math.prod(sides) * lengths.get("GCOUNT", 1) if sides else 0
            data = abs(lengths.get("BITPIX", 8)) // 8 * (values + lengths.get("PCOUNT", 0))
            if start + blocks * BLOCK + data > size:
                raise InputError("the FITS file is cut short", file=path)
            start += (blocks + math.ceil(data / BLOCK)) * BLOCK


def _lengths(file: BinaryIO, path: PathLike) -> tuple[dict[str, int] | None, int]:
    """Return ({keyword: length}, blocks) of the header at the file's position; (None, blocks) if it does not end."""
    lengths: dict[str, int] = {}
    blocks = 0
    while len(block := file.read(BLOCK)) == BLOCK:
        blocks += 1
        if blocks == 1 and not block.strip(b"\0"):  # padding after the last HDU
            return None, blocks
        for at in range(0, BLOCK, CARD):
            card = block[at : at + CARD].decode("latin-1")
            key = card[:8].strip()
            if "\0" in card:  # cfitsio ends the card at it, and fitsio then raises errors of many types
                raise InputError("a header is damaged: a null character", file=path, key=key)
            if card.rstrip() == "END":
                return lengths, blocks
            if card[8] == "=" and _LENGTH.fullmatch(key):
                lengths[key] = _length(key, card[9:].split("/")[0].strip(), path)
    return None, blocks


def _length(key: str, text: str, path: PathLike) -> int:
    value = int(text) if _INTEGER.fullmatch(text) else None
    tile = MAX_TILE if key.startswith("Z") else value
    largest = MAX_FIELDS if key == "TFIELDS" else MAX_AXES if key.endswith("NAXIS") else tile
    if (
        value is None
        or (largest is not None and value > largest)
        or (key != "BITPIX" and value < 0)
        or (key.startswith("Z") and value == 0)
    ):
        raise InputError("a header is damaged: no length", file=path, key=key, value=text)
    return value
