"""Variable stars: which of the embedded sky's stars vary, how, and by how much at an epoch.

Class, period, amplitude and phase of a star depend on the campaign's seed and the star's id alone. Left out: more than
one period, irregular changes, spots that come and go, flares, the second eclipse of a binary.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numba
import numpy as np

from csstsim.base.counter import object_keys, unit, word
from csstsim.base.rng import counter_key
from csstsim.base.types import AnyArray, FloatArray, IntArray

_WORDS = 16  # of a star
_ECLIPSE = 0.1  # of a period
_RISE = 0.15  # of a period, of a saw
REFERENCE = 5500.0  # angstrom, of the amplitudes


def star_changes(
    seed: int,
    table: Mapping[str, AnyArray],
    mjd: Sequence[float] | FloatArray,
    wavelength: float,
    numbers: Mapping[str, Any],
) -> FloatArray:
    """Return (n, times) mag by which stars are fainter than on average at MJDs (times,), at a wavelength [angstrom].

    table: ids, teff, logg of stars. The mean of sine and saw is zero; an eclipse only dims.
    """
    classes = numbers["classes"]
    draws = _uniforms(counter_key(seed, "variable stars"), table["id"])
    which, period, size, phase = drawn(table, draws, classes)
    out = np.zeros((len(which), len(mjd)))
    for k, form in enumerate(classes["form"]):
        some = np.flatnonzero(which == k)
        if not len(some):
            continue
        turn = (np.asarray(mjd) / period[some, None] + phase[some, None]) % 1.0
        here = size[some] * (wavelength / REFERENCE) ** classes["slope"][k]
        out[some] = here[:, None] * _FORMS[form](turn)
    return out


def drawn(
    table: Mapping[str, AnyArray], draws: FloatArray, classes: Mapping[str, Any]
) -> tuple[IntArray, FloatArray, FloatArray, FloatArray]:
    """Return (class, -1: none; period [day]; amplitude [mag]; phase [turns]) of stars from uniform numbers (n, 16)."""
    from scipy.special import ndtri

    which = np.full(len(draws), -1)
    left = np.ones(len(draws), bool)
    for k in range(len(classes["names"])):
        inside = left
        for name in ("teff", "logg"):
            low, high = classes[name][k]
            inside = inside & (table[name] >= low) & (table[name] < high)
        taken = inside & (draws[:, k] < classes["share"][k])
        which[taken] = k
        left = left & ~taken
    at = np.maximum(which, 0)
    low, high = np.log(np.array(classes["period"])[at]).T
    median, scatter = np.array(classes["amplitude"])[at].T
    period = np.exp(low + draws[:, -1] * (high - low))
    return which, period, median * 10 ** (scatter * ndtri(draws[:, -2])), draws[:, -3]


def _saw(turn: FloatArray) -> FloatArray:
    """Brightens for _RISE of the period, then fades: 1 to -1 and back, mean 0."""
    return np.where(turn < _RISE, 1 - 2 * turn / _RISE, -1 + 2 * (turn - _RISE) / (1 - _RISE))


def _eclipse(turn: FloatArray) -> FloatArray:
    """Dims by up to 2 (twice the amplitude is the depth) around turn 0."""
    away = np.minimum(turn, 1 - turn) / (_ECLIPSE / 2)
    return np.where(away < 1, 1 + np.cos(np.pi * away), 0.0)


_FORMS = {"sine": lambda turn: np.sin(2 * np.pi * turn), "saw": _saw, "eclipse": _eclipse}


@numba.njit(cache=True)
def _fill(keys: IntArray, out: FloatArray) -> None:
    for i in range(len(keys)):
        for k in range(out.shape[1]):
            out[i, k] = unit(word(keys[i], np.uint64(k)))


def _uniforms(key: np.uint64, ids: IntArray) -> FloatArray:
    """Return (n, _WORDS) uniform numbers of objects by their ids."""
    out = np.empty((len(ids), _WORDS))
    _fill(object_keys(key, np.asarray(ids, np.int64)), out)
    return out
