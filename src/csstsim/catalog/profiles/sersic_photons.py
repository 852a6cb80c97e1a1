"""Radii of electrons from a circular Sersic profile, I(r) ~ exp(-b (r / r_e)^(1/n)).

With x = b (r / r_e)^(1/n) the flux within r is the gamma distribution of shape 2n. `ring` replaces the profile by 4096
rings of uniform brightness, each with the exact flux and mean r^2, so that flux and <r^2> are those of the profile. A
ring has at most 1/32 of the flux inside it (inner half of the flux) or outside it (outer half), down to 2^-32 of the
flux.

Disk (n = 1) and bulge (n = 4), nearly all components of a catalogue, have rings of their own. Any other index lies
between two of NODES, 16 to an octave. The r^2 of its rings is interpolated between theirs, with the weight that keeps
<r^2> exact. At a radius the enclosed flux is then wrong by at most 1e-4 of the total.
"""

import math
from functools import cache
from typing import NamedTuple

import numba
import numpy as np
from numpy.typing import ArrayLike
from scipy.special import gammainc, gammaincc, gammainccinv, gammaincinv, gammaln

from csstsim.base.types import FloatArray, IntArray
from csstsim.catalog.profiles.sersic import BULGE, DISK, INDEX_MAX, INDEX_MIN

RINGED = DISK, BULGE  # Sersic indices whose rings need no interpolation
NODES = INDEX_MIN * 2 ** (np.arange(np.ceil(16 * np.log2(INDEX_MAX / INDEX_MIN)) + 1) / 16)
# rings per factor of 2 in flux; number of such factors
_STEPS = 32
_OCTAVES = 32
_SHIFT = np.int64(47)  # leaves the exponent and log2(_STEPS) bits of the fraction of a float64
_FIRST = (1023 - 1) * _STEPS  # index of the number 0.5
_HALF = np.uint64(0x7FFFFFFF)
_S31 = np.uint64(31)
_ONE = np.uint64(1)


def _rings(n: float) -> FloatArray:
    """Return (2, rings, 2): a, b of r^2 / r_e^2 = a + b t; t / 2^32, t < 2^31, is the flux inside, then outside, r."""
    octave, step = np.divmod(np.arange(_STEPS * _OCTAVES + 1), _STEPS)
    edges = 2.0 ** (octave - 1) * (1 + step / _STEPS)
    light = edges * 2.0**-32
    b = gammaincinv(2 * n, 0.5)
    # r^2 ~ x^(2n) raises the shape of the gamma distribution from 2n to 4n
    scale = np.exp(gammaln(4 * n) - gammaln(2 * n) - 2 * n * np.log(b))
    halves = []
    for inverse, moment in ((gammaincinv, gammainc), (gammainccinv, gammaincc)):
        x = inverse(2 * n, light)
        mean = scale * np.diff(moment(4 * n, x)) / np.diff(light)
        slope = np.diff((x / b) ** (2 * n)) / np.diff(edges)
        halves.append(np.stack([mean - slope * (edges[1:] + edges[:-1]) / 2, slope], axis=1))
    return np.stack(halves)


RINGS = np.stack([_rings(n) for n in RINGED])


@cache
def _all_rings() -> FloatArray:
    return np.concatenate([RINGS, np.stack([_rings(n) for n in NODES])])


class Rings(NamedTuple):
    """The arguments of `ring` for profiles.

    * rings: (k, 2, rings, 2), of all profiles
    * which: (...) int64, number of a profile's rings; -1: no profile
    * fraction: (...), of the next rings, between which and those of `which` the profile's rings are interpolated
    """

    rings: FloatArray
    which: IntArray
    fraction: FloatArray


def rings_for(index: ArrayLike) -> Rings:
    """Return the Rings for Sersic indices (...).

    Raises ValueError for an index outside INDEX_MIN..INDEX_MAX; 0 stands for no profile, and gets which = -1.
    """
    index = np.asarray(index, float)
    which = np.where(index == DISK, 0, np.where(index == BULGE, 1, -1))
    fraction = np.zeros(index.shape)
    free = (which < 0) & (index != 0)
    if not free.any():
        return Rings(RINGS, which, fraction)
    n = index[free]
    if not ((n >= INDEX_MIN) & (n <= INDEX_MAX)).all():
        raise ValueError(f"a Sersic index is outside {INDEX_MIN} to {INDEX_MAX}")
    k = np.clip(np.searchsorted(NODES, n, side="right") - 1, 0, len(NODES) - 2)
    low = _mean_square(NODES[k])
    high = _mean_square(NODES[k + 1])
    which[free] = k + len(RINGED)
    fraction[free] = (_mean_square(n) - low) / (high - low)
    return Rings(_all_rings(), which, fraction)


def _mean_square(n: FloatArray) -> FloatArray:
    """Return <r^2> in r_e^2."""
    return np.exp(gammaln(4 * n) - gammaln(2 * n) - 2 * n * np.log(gammaincinv(2 * n, 0.5)))


@numba.njit(inline="always")
def ring(rings: FloatArray, which: int | np.int64, fraction: float, bits: np.uint64) -> float:
    """Return a radius in r_e from the lower 32 bits; rings, which, fraction: of Rings."""
    t = np.float64(bits & _HALF) + 0.5
    i = (np.float64(t).view(np.int64) >> _SHIFT) - _FIRST
    half = np.int64((bits >> _S31) & _ONE)
    line = rings[which, half, i]
    square = line[0] + line[1] * t
    if fraction > 0.0:
        line = rings[which + 1, half, i]
        square += fraction * (line[0] + line[1] * t - square)
    return math.sqrt(square)
