"""Gates: a number, its threshold, and whether it passes (None: cannot be judged).

A gate is {name, band, value, threshold, n, error, margin, passed}; a gate of one exposure also has {exposure, chip},
that of one readout channel {channel}. It is not judged without a threshold, without a value, or from fewer than FEW
sources; n is None if it does not depend on sources. margin: the number over the largest allowed one, which includes
chance; above 1 the gate fails.
"""

import numpy as np

# Columns of a table of gates
ABOUT = {
    "brick": (np.int32, "HEALPix pixel of NSIDE 256, nested"),
    "name": (np.str_, "what is judged"),
    "band": (np.str_, 'in lower case; "all": of all bands'),
    "value": (np.float64, "the number that is judged; null: there is none"),
    "threshold": (np.float64, 'the most or least it may be; of a width "low to high"; null: none is given'),
    "n": (np.int64, "sources it is from; null: it does not depend on sources"),
    "error": (np.float64, "one sigma of the value; null: not known, or none"),
    "margin": (np.float64, "the number over the largest allowed one, chance included: above 1 the gate fails"),
    "passed": (np.bool_, "null: it could not be judged"),
    "exposure": (np.str_, "obsid, of a gate of one exposure"),
    "chip": (np.int16, "its chip"),
    "channel": (np.int16, "readout channel, of a gate of one"),
}
FEW = 20
CHANCE = 2.0  # sigma of chance that are tolerated
WORST = 4.0  # ... of bins, widths and exposures: of a release's thousands some exceed three by chance
LARGEST = 999.0  # largest margin


def at_most(name, band, value, threshold, n, chance=0.0, sigmas=CHANCE, **where):
    """Return the gate of a number of either sign that is at most `threshold` + `chance` in size.

    chance: so many `sigmas` of the number's error.
    """
    error = chance / sigmas or None
    return _gate(name, band, value, threshold, n, error, where, lambda: (abs(value), threshold + chance))


def at_least(name, band, value, threshold, n, **where):
    """Return the gate of a fraction of n that is at least `threshold`; its margin compares the missing fractions.

    A fraction whose true value is at the threshold may fall short by chance: CHANCE sigma are tolerated.
    """
    error = float(np.sqrt(max(value * (1 - value), 1 / n) / n)) if n and value is not None else None
    return _gate(
        name, band, value, threshold, n, error, where,
        lambda: (1 - value, 1 - threshold + CHANCE * np.sqrt(threshold * (1 - threshold) / n)),
    )  # fmt: skip


def between(name, band, value, limits, n, **where):
    """Return the gate of a width of n values within `limits` (low, high), with a tolerance of WORST sigma."""
    threshold = None if limits is None else f"{limits[0]:g} to {limits[1]:g}"

    def sides():
        chance = WORST * 1.17 / np.sqrt(n)  # a width from the median deviation has a relative error of 1.17 / sqrt(n)
        low, high = limits[0] * (1 - chance), limits[1] * (1 + chance)
        return (value, high) if value > limits[0] else (low, value)

    error = value * 1.17 / np.sqrt(n) if n and value is not None else None
    return _gate(name, band, value, threshold, n, error and float(error), where, sides)


def of_exposures(gates):
    """Return all failing gates of single exposures; for a name and band without any, the gate closest to failing.

    If no gate of a name and band was judged, the one with the most sources is returned.
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


def _gate(name, band, value, threshold, n, error, where, sides):
    judged = value is not None and threshold is not None and (n is None or n >= FEW)
    margin = _margin(*sides()) if judged else None
    return {
        "name": name, "band": band, "value": value, "threshold": threshold, "n": n, "error": error, "margin": margin,
        "passed": None if margin is None else margin <= 1.0, **where,
    }  # fmt: skip


def _margin(size, allowed):
    """Return size over allowed, at most LARGEST, which it also is if `allowed` is zero or less; 0 without size."""
    if size <= 0:
        return 0.0
    return float(min(size / allowed, LARGEST)) if allowed > 0 else LARGEST
