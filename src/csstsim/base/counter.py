"""Random numbers for compiled loops. A key and a counter give a number, so objects may be rendered in any order.

word(key, counter) is SplitMix64 (Steele, Lea & Flood 2014, OOPSLA) with the key mixed in twice, so that different keys
never give the same sequence. `object_keys` computes the key of each object from its id, so ids must be unique.
Functions that use several numbers take the counter and return the advanced counter.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numba
import numpy as np

import csstsim.base.process.no_blas  # noqa: F401

if TYPE_CHECKING:
    from csstsim.base.types import IntArray

_GAMMA = np.uint64(0x9E3779B97F4A7C15)
_MIX1 = np.uint64(0xBF58476D1CE4E5B9)
_MIX2 = np.uint64(0x94D049BB133111EB)
_ONE = np.uint64(1)
_S27, _S30, _S31, _S32 = (np.uint64(s) for s in (27, 30, 31, 32))
_LOW32 = np.uint64(0xFFFFFFFF)
_S12 = np.uint64(12)
_UNIT32 = 2.0**-32
_UNIT52 = 2.0**-52
_INVERSION_MAX = 10.0  # mean above which rejection is faster than inversion
_INVERSION_LAST = 100  # end of the search, which rounding errors could make endless: P(more) < 1e-60


@numba.njit(inline="always")
def word(key: np.uint64, counter: np.uint64) -> np.uint64:
    """Return 64 random bits."""
    z = key + counter * _GAMMA
    z = (z ^ (z >> _S30)) * _MIX1
    z = (z ^ key ^ (z >> _S27)) * _MIX2
    return z ^ (z >> _S31)


@numba.njit(inline="always")
def high(bits: np.uint64) -> float:
    """Return a uniform number in (0, 1) from the upper 32 bits."""
    return (np.float64(bits >> _S32) + 0.5) * _UNIT32


@numba.njit(inline="always")
def low(bits: np.uint64) -> float:
    """Return a uniform number in (0, 1) from the lower 32 bits."""
    return (np.float64(bits & _LOW32) + 0.5) * _UNIT32


@numba.njit(inline="always")
def unit(bits: np.uint64) -> float:
    """Return a uniform number in (0, 1) of 52 bits (with 53 bits it could round to 1)."""
    return (np.float64(bits >> _S12) + 0.5) * _UNIT52


@numba.njit(cache=True)
def object_keys(base: np.uint64, ids: IntArray) -> IntArray:
    """Return (n,) uint64 keys of integer ids under a base key (uint64)."""
    keys = np.empty(len(ids), np.uint64)
    for i in range(len(ids)):
        keys[i] = word(base, np.uint64(ids[i]))
    return keys


@numba.njit(cache=True)
def poisson(mean: float, key: np.uint64, counter: np.uint64) -> tuple[int, np.uint64]:
    """Return (Poisson number of this mean, advanced counter).

    Small means use inversion, large ones transformed rejection (Hoermann 1993, PTRS).
    """
    if mean < _INVERSION_MAX:
        p = math.exp(-mean)
        u = unit(word(key, counter))
        counter += _ONE
        k = 0
        while u > p and k < _INVERSION_LAST:
            u -= p
            k += 1
            p *= mean / k
        return k, counter
    root = math.sqrt(mean)
    b = 0.931 + 2.53 * root
    a = -0.059 + 0.02483 * b
    inverse_alpha = 1.1239 + 1.1328 / (b - 3.4)
    v_r = 0.9277 - 3.6224 / (b - 2.0)
    log_mean = math.log(mean)
    while True:
        bits = word(key, counter)
        counter += _ONE
        u = high(bits) - 0.5
        v = low(bits)
        us = 0.5 - abs(u)
        k = math.floor((2 * a / us + b) * u + mean + 0.43)
        if us >= 0.07 and v <= v_r:
            return int(k), counter
        if k < 0 or (us < 0.013 and v > us):
            continue
        if math.log(v) + math.log(inverse_alpha) - math.log(a / (us * us) + b) <= (
            k * log_mean - mean - math.lgamma(k + 1)
        ):
            return int(k), counter
