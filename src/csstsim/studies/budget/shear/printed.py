"""Formatted numbers: digits according to the error, m and c in 1e-4, alpha in 1e-2."""

import math
from collections.abc import Mapping
from typing import Any

PRINTED = {"m1": 1e-4, "m2": 1e-4, "c1": 1e-4, "c2": 1e-4, "alpha": 1e-2}  # units


def pair(value: float, error: float, sign: str = "+-") -> str:
    """Return "value sign error", the error with two significant digits; without one, the value with three."""
    if not (math.isfinite(value) and math.isfinite(error) and error > 0):
        return f"{value:+.3g} {sign} {error:.2g}"
    digits = max(0, 1 - math.floor(math.log10(error)))
    return f"{value:+.{digits}f} {sign} {error:.{digits}f}"


def of_row(row: Mapping[str, Any], name: str, sign: str = "+-") -> str:
    """Return the pair of a row of bars, in the unit of PRINTED."""
    return pair(row[name] / PRINTED[name], row[f"{name}_err"] / PRINTED[name], sign)


def hours(value: float) -> str:
    """Return a number with two significant digits, as 210 or 0.0021."""
    return f"{float(f'{value:.2g}'):g}"
