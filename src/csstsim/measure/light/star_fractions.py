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
PRIOR_SOURCES = 4.0  # number of sources with POINT_FRACTION that are added to each bin
ROUNDS = 100
_ODDS_MAX = 100.0  # ln


def with_star_fractions(point: FloatArray, mag: FloatArray, known: BoolArray) -> FloatArray:
    """Return the probabilities (n,) of a point, given those of total_light, `point` (n,), NaN where not known.

    mag (n,): PSF magnitudes, NaN where not known; known (n,): sources that count for the fractions. A source without a
    magnitude keeps its probability.
    """
    with np.errstate(divide="ignore"):
        log_odds = np.log(point) - np.log1p(-point)
    log_odds = np.clip(log_odds, -_ODDS_MAX, _ODDS_MAX) - _logit(POINT_FRACTION)
    usable = known & np.isfinite(mag) & np.isfinite(point)
    if not usable.any():
        return point
    bins = np.floor(mag[usable] / BIN).astype(int)
    first = bins.min()
    bins -= first
    sources = np.bincount(bins) + PRIOR_SOURCES
    fraction = np.full(len(sources), POINT_FRACTION)
    for _ in range(ROUNDS):
        probability = _expit(log_odds[usable] + _logit(fraction)[bins])
        fraction = (np.bincount(bins, probability) + PRIOR_SOURCES * POINT_FRACTION) / sources
    middles = (first + np.arange(len(sources)) + 0.5) * BIN
    return np.where(np.isfinite(mag), _expit(log_odds + np.interp(mag, middles, _logit(fraction))), point)


def _logit(p: FloatArray | float) -> FloatArray:
    return np.log(p / (1.0 - np.asarray(p)))


def _expit(log_odds: FloatArray) -> FloatArray:
    return 1.0 / (1.0 + np.exp(-log_odds))
