"""Placeholders of unknown values in catalogues: -99, 99, 9999, -1.

A placeholder is recognised as a value that the quantity cannot have, or as an axis or declination of whole nines.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Mapping

    from csstsim.base.types import BoolArray, FloatArray

NINES = np.array([99.0, 999.0, 9999.0, 99999.0])
# values at or beyond these are placeholders
MAGNITUDE = 90.0
REDSHIFT = 90.0
ELLIPTICITY = 9.0
RATIO = 9.0
NAMES = {
    "z": "redshifts",
    "pa": "position angles",
    "a": "major axes",
    "b": "minor axes",
    "q": "axis ratios",
    "dec": "declinations",
}


def without_missing(columns: Mapping[str, FloatArray]) -> tuple[dict[str, FloatArray], list[str]]:
    """Return ({quantity: (n,)} with NaN for placeholders, sentences with their numbers).

    columns: quantities of csstsim.studies.release.score.quantities, in their first unit, with magnitudes for fluxes.
    """
    known = dict(columns)
    notes = []
    for name, values in columns.items():
        missing = np.isfinite(values) & _missing(name, np.nan_to_num(values))
        if missing.any():
            known[name] = np.where(missing, np.nan, values)
            quantity = f"magnitudes in {name[4:]}" if name.startswith("mag_") else NAMES.get(name, name)
            example = values[np.flatnonzero(missing)[0]]
            notes.append(f"{missing.sum()} {quantity} are no values, as {example:g}: not known")
    return known, notes


def _missing(name: str, values: FloatArray) -> BoolArray:
    """Return bool (n,): finite values that a quantity cannot have."""
    nines = np.isin(np.abs(values), NINES)
    if name.startswith("mag_"):
        return np.abs(values) >= MAGNITUDE
    if name == "z":
        return (values <= -1.0) | (values >= REDSHIFT)
    if name in ("e1", "e2"):
        return np.abs(values) >= ELLIPTICITY
    if name == "q":
        return (values < 0.0) | (values >= RATIO)
    if name in ("a", "b"):
        return (values < 0.0) | nines
    if name == "pa":
        return np.abs(values) > 360.0
    return nines if name == "dec" else np.zeros(len(values), bool)
