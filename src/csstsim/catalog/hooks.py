"""Calls of the methods `dimming` and `component_shares` of a catalogue, with a check of what they return."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from csstsim.base.errors import InputError
from csstsim.catalog.base import name_of, users_code

if TYPE_CHECKING:
    from csstsim.base.types import FloatArray, IntArray
    from csstsim.catalog.base import CatalogBase
    from csstsim.catalog.changing.motion import Interval
    from csstsim.instrument.filter import Filter

FRACTIONS = ("bulge_frac", "knots_frac")


def dimming_of(catalog: CatalogBase, rows: IntArray, interval: Interval, filter: Filter) -> FloatArray | None:
    """Return `catalog.dimming`: (n,) mag, or None. Raises InputError for an exception and for another form."""
    where = f"{name_of(catalog)}.dimming"
    with users_code(where):
        dmag = catalog.dimming(rows, interval, filter)
    return None if dmag is None else _one_per_row(dmag, len(rows), where)


def fractions_of(catalog: CatalogBase, rows: IntArray, filter: Filter) -> dict[str, FloatArray]:
    """Return `catalog.component_shares`: {column: (n,)}, {} for None. Raises InputError for anything else."""
    where = f"{name_of(catalog)}.component_shares"
    with users_code(where):
        fractions: Any = catalog.component_shares(rows, filter)
    if fractions is None:
        return {}
    if not isinstance(fractions, Mapping):
        raise InputError("must return None or a dict of arrays", key=where, value=fractions)
    if unknown := [name for name in fractions if name not in FRACTIONS]:
        raise InputError("returned an unknown key", key=where, value=unknown[0], allowed=", ".join(FRACTIONS))
    return {name: _one_per_row(values, len(rows), f"{where}, {name}") for name, values in fractions.items()}


def _one_per_row(values: Any, count: int, where: str) -> FloatArray:
    """Return an array of numbers, (count,), masked values as NaN. Raises InputError for anything else."""
    try:
        numbers: FloatArray = np.ma.asarray(values)
    except (ValueError, TypeError):  # lists of several lengths
        raise InputError("must be one number for each row", key=where, value=values) from None
    if getattr(values, "unit", None) is not None:
        raise InputError("must be plain numbers, without a unit", key=where, value=values)
    if numbers.dtype.kind not in "biuf":
        raise InputError("must be one number for each row", key=where, value=values)
    if numbers.shape != (count,):
        message = f"must be one number for each row: its shape is {numbers.shape}, not {(count,)}"
        raise InputError(message, key=where, value=values)
    kind = numbers.dtype if numbers.dtype.kind == "f" else float
    filled: FloatArray = np.ma.filled(numbers.astype(kind), np.nan)
    return filled
