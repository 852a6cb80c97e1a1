"""Gates: a number, its threshold, and whether it passes; None where it cannot be judged.

A gate is {name, band, value, threshold, n, passed}. It is not judged without a threshold, without a value, or from
fewer than FEW sources; n is None where sources have no part in it.
"""

import numpy as np

FEW = 20
CHANCE = 2.0  # sigma of chance that are forgiven
WORST = 4.0  # ... of bins and widths, of which a release has thousands: the worst lies beyond three by chance


def at_most(name, band, value, threshold, n, chance=0.0):
    """Gate of a number that may be of either sign and at most `threshold` in size, `chance` forgiven."""
    return _gate(name, band, value, threshold, n, lambda: abs(value) <= threshold + chance)


def at_least(name, band, value, threshold, n):
    """Gate of a fraction of n.

    One that truly is at the threshold falls short by chance: CHANCE sigma of it are forgiven.
    """
    return _gate(
        name, band, value, threshold, n, lambda: value + CHANCE * np.sqrt(threshold * (1 - threshold) / n) >= threshold
    )


def between(name, band, value, limits, n):
    """Gate of a width of n values within `limits` (low, high), WORST sigma of one at a limit forgiven."""
    threshold = None if limits is None else f"{limits[0]:g} to {limits[1]:g}"

    def passes():
        chance = WORST * 1.17 / np.sqrt(n)  # of a width from the median deviation: 1.17 / sqrt(n)
        return limits[0] * (1 - chance) <= value <= limits[1] * (1 + chance)

    return _gate(name, band, value, threshold, n, passes)


def _gate(name, band, value, threshold, n, passes):
    judged = value is not None and threshold is not None and (n is None or n >= FEW)
    return {
        "name": name, "band": band, "value": value, "threshold": threshold, "n": n,
        "passed": bool(passes()) if judged else None,
    }  # fmt: skip
