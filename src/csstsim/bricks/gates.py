"""Gates: a number, its threshold, and whether it passes (None: cannot be judged).

A gate is {name, band, value, threshold, n, margin, passed}; that of one exposure also has {exposure, chip}, that of one
readout channel {channel}. It is not judged without a threshold, without a value, or from fewer than FEW sources; n is
None if it does not depend on sources. margin: the number over what is allowed, chance included; above 1 a gate fails.
"""

import numpy as np

FEW = 20
CHANCE = 2.0  # sigma of chance that are forgiven
WORST = (
    4.0  # ... of bins, widths and exposures, of which a release has thousands: the worst lies beyond three by chance
)
LARGEST = 999.0  # of a margin


def at_most(name, band, value, threshold, n, chance=0.0, **where):
    """Gate of a number that may be of either sign and at most `threshold` in size, `chance` forgiven."""
    return _gate(name, band, value, threshold, n, where, lambda: (abs(value), threshold + chance))


def at_least(name, band, value, threshold, n, **where):
    """Gate of a fraction of n; its margin is of what is missing.

    One that truly is at the threshold falls short by chance: CHANCE sigma of it are forgiven.
    """
    return _gate(
        name, band, value, threshold, n, where,
        lambda: (1 - value, 1 - threshold + CHANCE * np.sqrt(threshold * (1 - threshold) / n)),
    )  # fmt: skip


def between(name, band, value, limits, n, **where):
    """Gate of a width of n values within `limits` (low, high), WORST sigma of one at a limit forgiven."""
    threshold = None if limits is None else f"{limits[0]:g} to {limits[1]:g}"

    def sides():
        chance = WORST * 1.17 / np.sqrt(n)  # of a width from the median deviation: 1.17 / sqrt(n)
        low, high = limits[0] * (1 - chance), limits[1] * (1 + chance)
        return (value, high) if value > limits[0] else (low, value)

    return _gate(name, band, value, threshold, n, where, sides)


def of_exposures(gates):
    """Return the failing gates of single exposures; for a name and band without failure, the gate closest to failing.

    If no gate of a name and band was judged, the one with the most sources is kept.
    """
    groups = {}
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


def _gate(name, band, value, threshold, n, where, sides):
    judged = value is not None and threshold is not None and (n is None or n >= FEW)
    margin = _margin(*sides()) if judged else None
    return {
        "name": name, "band": band, "value": value, "threshold": threshold, "n": n, "margin": margin,
        "passed": None if margin is None else margin <= 1.0, **where,
    }  # fmt: skip


def _margin(size, allowed):
    """Return size over allowed, LARGEST at most; nothing is allowed where `allowed` is zero or less."""
    if size <= 0:
        return 0.0
    return float(min(size / allowed, LARGEST)) if allowed > 0 else LARGEST
