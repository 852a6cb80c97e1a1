"""Find the column of csstsim that a misspelt name is meant to be."""

from __future__ import annotations

import re
from difflib import get_close_matches
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Collection

SIMILARITY = 0.81  # minimum for a misspelt name; that of typ and type is higher
_ONE_LETTER = re.compile(r"mag[^a-z0-9]?[a-z]")  # mag_v is another survey's band, not a misspelt mag_nuv
_MAGNITUDE = re.compile(r"(^|[^a-z])mag([^a-z]|$)")


def closest_name(name: str, known: Collection[str]) -> str | None:
    """Return the name of `known` that `name` misspells, or None.

    A name with the same letters in another order is misspelt, too: siez, rmag and R_MAG for size and mag_r.
    """
    letters = _letters(name)
    same = next((other for other in sorted(known) if _letters(other) == letters), None)
    if same or _ONE_LETTER.fullmatch(name.lower()):
        return same
    return next(iter(get_close_matches(name.lower(), known, 1, SIMILARITY)), None)


def unused_magnitude(name: str, bands: Collection[str]) -> str | None:
    """Return a message on a column that looks like a magnitude and is not used; None for other columns.

    bands: names of the camera's. There is none on mag_norm and on errors of magnitudes.
    """
    word = name.lower()
    if word in bands:
        return f"{name} is not used; did you mean mag_{word}?"
    if not _MAGNITUDE.search(word) or "err" in word or word == "mag_norm":
        return None
    return f"{name} is not used: the camera's magnitudes are {', '.join(f'mag_{band}' for band in bands)}"


def _letters(name: str) -> list[str]:
    return sorted(re.sub(r"[^a-z0-9]", "", name.lower()))
