"""A FITS file of csstsim copied with other pixels: all cards are copied, and HISTORY records what was injected."""

from __future__ import annotations

from typing import TYPE_CHECKING, TypedDict

import numpy as np

from csstsim.base.errors import InputError
from csstsim.base.files.atomic import atomic_path
from csstsim.io.fits import open_fits, raw_cards, read_pixels
from csstsim.io.fits_writing import card, compress, remark, write_hdus

if TYPE_CHECKING:
    from collections.abc import Mapping

    from fitsio.hdu.base import HDUBase

    from csstsim.base.types import AnyArray, PathLike

# Written by io.fits, or of the table of a compressed image: not copied
_STRUCTURE = set(
    [
        "SIMPLE",
        "XTENSION",
        "BITPIX",
        "NAXIS",
        "NAXIS1",
        "NAXIS2",
        "EXTEND",
        "PCOUNT",
        "GCOUNT",
        "BSCALE",
        "BZERO",
        "EXTNAME",
        "CHECKSUM",
        "DATASUM",
        "LONGSTRN",
        "TFIELDS",
        "TTYPE1",
        "TFORM1",
        "THEAP",
        "ZIMAGE",
        "ZSIMPLE",
        "ZTENSION",
        "ZBITPIX",
        "ZNAXIS",
        "ZNAXIS1",
        "ZNAXIS2",
        "ZPCOUNT",
        "ZGCOUNT",
        "ZTILE1",
        "ZTILE2",
        "ZCMPTYPE",
        "ZNAME1",
        "ZNAME2",
        "ZVAL1",
        "ZVAL2",
        "ZHECKSUM",
        "ZDATASUM",
        "ZEXTEND",
        "ZQUANTIZ",
        "ZDITHER0",
    ]
)


class Record(TypedDict):
    """The record of an injection in the primary header: cards (keyword, value, comment), and texts of HISTORY."""

    cards: list[tuple[str, str | int, str]]
    history: list[str]


def rewrite(source: PathLike, target: PathLike, planes: Mapping[str, AnyArray], record: Record) -> None:
    """Write a copy of a FITS file with other pixels, in the same types; the source does not change.

    planes: {name of an extension: array of its shape}; record: {"cards": [(keyword, value, comment)], "history":
    [texts]} for the primary header. Raises InputError.
    """
    hdus: list[tuple[str, list[str], AnyArray | None]] = []
    compressed = False
    with open_fits(source) as file:
        for number, hdu in enumerate(file):
            name = hdu.get_extname()
            cards = _cards_to_copy(hdu, source)
            if not number:
                replaced = {keyword for keyword, *_ in record["cards"]}
                cards = [text for text in cards if text[:8].rstrip() not in replaced]
                cards += [card(*entry) for entry in record["cards"]]
                cards += [remark("HISTORY", f" injected {text}") for text in record["history"]]
                hdus.append(("", cards, None))
                continue
            compressed |= hdu.is_compressed()
            pixels = read_pixels(hdu, source) if hdu.has_data() else None
            data = planes.get(name, pixels)
            if pixels is None or data is None or data.shape != pixels.shape:
                raise InputError("not an image of the expected size", file=source, key=name)
            hdus.append((name, cards, np.ascontiguousarray(data, pixels.dtype)))
    with atomic_path(target) as temporary:
        write_hdus(temporary, hdus)
        if compressed:
            compress(temporary)


def _cards_to_copy(hdu: HDUBase, path: PathLike) -> list[str]:
    return [text for text in raw_cards(hdu, path) if text[:8].rstrip() not in _STRUCTURE]
