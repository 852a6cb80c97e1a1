"""Probabilities of a point with the fraction of points at each magnitude, which the frame itself gives.

`total_light` compares a point with a galaxy at one fraction of points, POINT_FRACTION. At r = 25.5 it is ten times
less, and most sources called stars would be galaxies. The fraction in each bin of magnitude is the one that makes the
data most likely, by expectation and maximisation (Dempster, Laird & Rubin 1977, JRSS B 39, 1). Where points and
galaxies cannot be told apart, no source has a high probability.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from csstsim.measure.light.total_light import POINT_FRACTION

if TYPE_CHECKING:
    from csstsim.base.types import BoolArray, FloatArray

BIN = 0.5  # mag
PRIOR_SOURCES = 4.0  # sources with the fraction of the brighter bin, POINT_FRACTION at first, that are added to a bin
ROUNDS = 100
RARE = 1e-4  # minimum fraction of points, and of galaxies
_ODDS_MAX = 100.0  # ln


def with_star_fractions(point: FloatArray, mag: FloatArray, known: BoolArray) -> FloatArray:
    """Return the probabilities (n,) of a point, given those of total_light, `point` (n,), NaN where not known.

    mag (n,): PSF magnitudes, NaN where the flux is not positive, which counts as faintest; known (n,): sources that
    tell the fractions.
    """
    with np.errstate(divide="ignore"):
        log_odds = np.log(point) - np.log1p(-point)
    log_odds = np.clip(log_odds, -_ODDS_MAX, _ODDS_MAX) - _logit(POINT_FRACTION)
    usable = known & np.isfinite(mag) & np.isfinite(point)
    if not usable.any():
        return point
    bins = np.floor(mag[usable] / BIN).astype(int)
    numbers = np.arange(bins.min(), bins.max() + 1)
    fractions = []
    brighter = POINT_FRACTION
    for number in numbers:
        brighter = _fraction(log_odds[usable][bins == number], brighter)
        fractions.append(brighter)
    middles = (numbers + 0.5) * BIN
    return _expit(log_odds + np.interp(np.where(np.isfinite(mag), mag, np.inf), middles, _logit(np.array(fractions))))


def _fraction(log_odds: FloatArray, prior: float) -> float:
    """Return the most likely fraction of points among sources whose odds are these at equal numbers of both kinds."""
    fraction = prior
    for _ in range(ROUNDS):
        points = _expit(log_odds + _logit(fraction)).sum() + PRIOR_SOURCES * prior
        fraction = float(points / (len(log_odds) + PRIOR_SOURCES))
    return min(max(fraction, RARE), 1.0 - RARE)


def _logit(p: FloatArray | float) -> FloatArray:
    return np.log(p / (1.0 - np.asarray(p)))


def _expit(log_odds: FloatArray) -> FloatArray:
    return 1.0 / (1.0 + np.exp(-log_odds))
