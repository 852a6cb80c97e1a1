"""Gates: a number, its threshold, and whether it passes (None: cannot be evaluated).

A gate is {name, band, value, threshold, n, error, margin, passed}; a gate of one exposure also has {exposure, chip},
that of one readout channel {channel}. It is not evaluated without a threshold, without a value, or from fewer than FEW
sources; n is None if it does not depend on sources. margin: the number over the largest allowed one, which includes
chance; above 1 the gate fails.
"""

from collections.abc import Callable, Iterable, Mapping
from typing import Any, TypeAlias

import numpy as np

Gate: TypeAlias = dict[str, Any]

# Columns of a table of gates
ABOUT = {
    "brick": (np.int32, "HEALPix pixel of NSIDE 256, nested"),
    "name": (np.str_, "what is evaluated"),
    "band": (np.str_, 'in lower case; "all": of all bands'),
    "value": (np.float64, "the number that is evaluated; null: there is none"),
    "threshold": (np.float64, 'the most or least it may be; of a width "low to high"; null: none is given'),
    "n": (np.int64, "sources it is from; null: it does not depend on sources"),
    "error": (np.float64, "one sigma of the value; null: not known, or none"),
    "margin": (np.float64, "the number over the largest allowed one, chance included: above 1 the gate fails"),
    "passed": (np.bool_, "null: it could not be evaluated"),
    "exposure": (np.str_, "obsid, of a gate of one exposure"),
    "chip": (np.int16, "its chip"),
    "channel": (np.int16, "readout channel, of a gate of one"),
}
FEW = 20
CHANCE = 2.0  # sigma of chance that are tolerated
WORST = 4.0  # ... of bins, widths and exposures: of a release's thousands some exceed three by chance
LARGEST = 999.0  # largest margin


def at_most(
    name: str,
    band: str,
    value: float | None,
    threshold: float | None,
    n: int | None,
    chance: float = 0.0,
    sigmas: float = CHANCE,
    **where: Any,
) -> Gate:
    """Return the gate of a number of either sign that is at most `threshold` + `chance` in size.

    chance: so many `sigmas` of the number's error.
    """
    error = chance / sigmas or None
    sides = None if value is None or threshold is None else lambda: (abs(value), threshold + chance)
    return _gate(name, band, value, threshold, n, error, where, sides)


def at_least(name: str, band: str, value: float | None, threshold: float | None, n: int, **where: Any) -> Gate:
    """Return the gate of a fraction of n that is at least `threshold`; its margin compares the missing fractions.

    A fraction whose true value is at the threshold may fall short by chance: CHANCE sigma are tolerated.
    """
    error = float(np.sqrt(max(value * (1 - value), 1 / n) / n)) if n and value is not None else None
    sides = (
        None
        if value is None or threshold is None
        else lambda: (
            1 - value,
            1 - threshold + CHANCE * np.sqrt(threshold * (1 - threshold) / n),
        )
    )
    return _gate(name, band, value, threshold, n, error, where, sides)


def between(
    name: str, band: str, value: float | None, limits: tuple[float, float] | None, n: int, **where: Any
) -> Gate:
    """Return the gate of a width of n values within `limits` (low, high), with a tolerance of WORST sigma."""
    threshold = None if limits is None else f"{limits[0]:g} to {limits[1]:g}"
    sides = None if value is None or limits is None else lambda: _nearer_side(value, limits, n)
    error = value * 1.17 / np.sqrt(n) if n and value is not None else None
    return _gate(name, band, value, threshold, n, error and float(error), where, sides)


def _nearer_side(width: float, limits: tuple[float, float], n: int) -> tuple[float, float]:
    """Return (size, allowed) of a width at the limit that it is nearer to failing."""
    chance = WORST * 1.17 / np.sqrt(n)  # a width from the median deviation has a relative error of 1.17 / sqrt(n)
    low = limits[0] * (1 - chance)
    high = limits[1] * (1 + chance)
    return (width, high) if width > limits[0] else (low, width)


def of_exposures(gates: Iterable[Gate]) -> list[Gate]:
    """Return all failing gates of single exposures; for a name and band without any, the gate closest to failing.

    If no gate of a name and band was judged, the one with the most sources is returned.
    """
    groups: dict[tuple[str, str], list[Gate]] = {}
    for gate in gates:
        groups.setdefault((gate["name"], gate["band"]), []).append(gate)
    out = []
    for group in groups.values():
        failing = [gate for gate in group if gate["passed"] is False]
        judged = [gate for gate in group if gate["passed"]]
        if failing or judged:
            out += failing or [max(judged, key=lambda gate: gate["margin"])]
        else:
            out.append(max(group, key=lambda gate: gate["n"] or 0))
    return out


def _gate(
    name: str,
    band: str,
    value: float | None,
    threshold: float | str | None,
    n: int | None,
    error: float | None,
    where: Mapping[str, Any],
    sides: Callable[[], tuple[float, float]] | None,
) -> Gate:
    margin = _margin(*sides()) if sides is not None and (n is None or n >= FEW) else None
    return {
        "name": name,
        "band": band,
        "value": value,
        "threshold": threshold,
        "n": n,
        "error": error,
        "margin": margin,
        "passed": None if margin is None else margin <= 1.0,
        **where,
    }


def _margin(size: float, allowed: float) -> float:
    """Return size over allowed, at most LARGEST, which it also is if `allowed` is zero or less; 0 without size."""
    if size <= 0:
        return 0.0
    return float(min(size / allowed, LARGEST)) if allowed > 0 else LARGEST
