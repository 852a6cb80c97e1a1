"""Radii of electrons from a circular Sersic profile, I(r) ~ exp(-b (r / r_e)^(1/n)).

With x = b (r / r_e)^(1/n) the light within r is the gamma distribution of shape 2n, so r = r_e (x / b)^n is exact for
every index n: `gamma` follows Marsaglia & Tsang (2000, ACM TOMS 26, 363).

For disk (n = 1) and bulge (n = 4), nearly all components of a catalogue, `ring` is several times faster. It replaces
the profile by 4096 rings of uniform brightness, each with the exact light and mean r^2, so that flux and <r^2> are
those of the profile. A ring has at most 1/32 of the light inside it (inner half of the light) or outside it (outer
half), down to 2^-32 of the light.
"""

import math

import numba
import numpy as np
from scipy.special import gammainc, gammaincc, gammainccinv, gammaincinv, gammaln

from csstsim.base.counter import high, low, word
from csstsim.profiles.sersic import BULGE, DISK

RINGED = DISK, BULGE  # Sersic indices that have rings
_STEPS, _OCTAVES = 32, 32  # rings per factor of 2 in light; number of such factors
_SHIFT = np.int64(47)  # leaves the exponent and log2(_STEPS) bits of the fraction of a float64
_FIRST = (1023 - 1) * _STEPS  # index of the number 0.5
_HALF = np.uint64(0x7FFFFFFF)
_S31 = np.uint64(31)
_ONE, _TWO = np.uint64(1), np.uint64(2)


def _rings(n):
    """Return (2, rings, 2): a, b of r^2 / r_e^2 = a + b t; t / 2^32, t < 2^31, is the light inside, then outside, r."""
    octave, step = np.divmod(np.arange(_STEPS * _OCTAVES + 1), _STEPS)
    edges = 2.0 ** (octave - 1) * (1 + step / _STEPS)
    light, b = edges * 2.0**-32, gammaincinv(2 * n, 0.5)
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


@numba.njit(inline="always")
def ring(which, bits):
    """Return a radius in r_e from the lower 32 bits; `which`: index in RINGED."""
    t = np.float64(bits & _HALF) + 0.5
    i = (np.float64(t).view(np.int64) >> _SHIFT) - _FIRST
    line = RINGS[which, np.int64((bits >> _S31) & _ONE), i]
    return math.sqrt(line[0] + line[1] * t)


@numba.njit(cache=True)
def gamma(shape, key, counter):
    """Return (gamma variate of this shape > 0, counter)."""
    boost = 1.0
    if shape < 1.0:
        boost = high(word(key, counter)) ** (1.0 / shape)
        counter += _ONE
        shape += 1.0
    d = shape - 1.0 / 3.0
    c = 1.0 / math.sqrt(9.0 * d)
    while True:
        bits = word(key, counter)
        u = high(word(key, counter + _ONE))
        counter += _TWO
        normal = math.sqrt(-2.0 * math.log(high(bits))) * math.cos(2 * math.pi * low(bits))
        v = 1.0 + c * normal
        if v <= 0:
            continue
        v = v * v * v
        square = normal * normal
        if u < 1.0 - 0.0331 * square * square or math.log(u) < 0.5 * square + d - d * v + d * math.log(v):
            return d * v * boost, counter
