"""A FITS file of csstsim written again with other pixels: all cards are kept, and HISTORY says what was injected."""

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

# Made anew by io.fits, or of the table that holds a compressed image
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
    """What the primary header says of an injection: cards (keyword, value, comment), and texts of HISTORY."""

    cards: list[tuple[str, str | int, str]]
    history: list[str]


def rewrite(source: PathLike, target: PathLike, planes: Mapping[str, AnyArray], record: Record) -> None:
    """Write a copy of a FITS file with other pixels, in the same types; the source stays as it is.

    planes: {name of an extension: array of its shape}; record: {"cards": [(keyword, value, comment)], "history":
    [texts]} for the primary header. Raises InputError.
    """
    hdus: list[tuple[str, list[str], AnyArray | None]] = []
    packed = False
    with open_fits(source) as file:
        for number, hdu in enumerate(file):
            name = hdu.get_extname()
            cards = _kept(hdu, source)
            if not number:
                old = {keyword for keyword, *_ in record["cards"]}
                cards = [text for text in cards if text[:8].rstrip() not in old]
                cards += [card(*entry) for entry in record["cards"]]
                cards += [remark("HISTORY", f" injected {text}") for text in record["history"]]
                hdus.append(("", cards, None))
                continue
            packed |= hdu.is_compressed()
            held = read_pixels(hdu, source) if hdu.has_data() else None
            new = planes.get(name, held)
            if held is None or new is None or new.shape != held.shape:
                raise InputError("not an image of the expected size", file=source, key=name)
            hdus.append((name, cards, np.ascontiguousarray(new, held.dtype)))
    with atomic_path(target) as temporary:
        write_hdus(temporary, hdus)
        if packed:
            compress(temporary)


def _kept(hdu: HDUBase, path: PathLike) -> list[str]:
    return [text for text in raw_cards(hdu, path) if text[:8].rstrip() not in _STRUCTURE]
