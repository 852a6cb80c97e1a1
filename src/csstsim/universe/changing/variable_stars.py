"""Variable stars: which of the embedded sky's stars vary, how, and by how much at an epoch.

Class, period, amplitude and phase of a star depend only on the campaign's seed and the star's id. Left out: more than
one period, irregular changes, transient spots, flares, the second eclipse of a binary.
"""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numba
import numpy as np

from csstsim.base.counter import object_keys, unit, word
from csstsim.base.rng import counter_key
from csstsim.base.types import AnyArray, FloatArray, IntArray

_NUMBERS = 16  # random numbers of a star
# Durations of an eclipse and of a saw's rise, as fractions of the period
_ECLIPSE = 0.1
_RISE = 0.15
REFERENCE = 5500.0  # angstrom, of the amplitudes


class Variability(NamedTuple):
    """Stars (n,): index of the class (-1: constant), period [day], amplitude [mag], phase at MJD 0 [periods]."""

    kind: IntArray
    period: FloatArray
    amplitude: FloatArray
    phase: FloatArray


def star_changes(
    seed: int,
    table: Mapping[str, AnyArray],
    mjd: Sequence[float] | FloatArray,
    wavelength: float,
    numbers: Mapping[str, Any],
) -> FloatArray:
    """Return (n, times) mag by which stars are fainter than on average at MJDs (times,), at a wavelength [angstrom].

    table: id, teff, logg of stars. The mean of sine and saw is zero; an eclipse only dims.
    """
    classes = numbers["classes"]
    stars = assign_classes(table, _uniform_numbers(counter_key(seed, "variable stars"), table["id"]), classes)
    out = np.zeros((len(stars.kind), len(mjd)))
    for k, form in enumerate(classes["form"]):
        rows = np.flatnonzero(stars.kind == k)
        if not len(rows):
            continue
        phase = (np.asarray(mjd) / stars.period[rows, None] + stars.phase[rows, None]) % 1.0
        amplitude = stars.amplitude[rows] * (wavelength / REFERENCE) ** classes["slope"][k]
        out[rows] = amplitude[:, None] * _LIGHT_CURVES[form](phase)
    return out


def assign_classes(table: Mapping[str, AnyArray], uniform: FloatArray, classes: Mapping[str, Any]) -> Variability:
    """Return the Variability of stars from uniform numbers (n, 16)."""
    from scipy.special import ndtri

    kind = np.full(len(uniform), -1)
    unassigned = np.ones(len(uniform), bool)
    for k in range(len(classes["names"])):
        matches = unassigned
        for name in ("teff", "logg"):
            low, high = classes[name][k]
            matches = matches & (table[name] >= low) & (table[name] < high)
        assigned = matches & (uniform[:, k] < classes["share"][k])
        kind[assigned] = k
        unassigned = unassigned & ~assigned
    index = np.maximum(kind, 0)
    low, high = np.log(np.array(classes["period"])[index]).T
    median, scatter = np.array(classes["amplitude"])[index].T
    return Variability(
        kind=kind,
        period=np.exp(low + uniform[:, -1] * (high - low)),
        amplitude=median * 10 ** (scatter * ndtri(uniform[:, -2])),
        phase=uniform[:, -3],
    )


def _saw(phase: FloatArray) -> FloatArray:
    """Return the magnitude of a saw: it brightens from 1 to -1 for _RISE of the period, then fades; its mean is 0."""
    return np.where(phase < _RISE, 1 - 2 * phase / _RISE, -1 + 2 * (phase - _RISE) / (1 - _RISE))


def _eclipse(phase: FloatArray) -> FloatArray:
    """Return the magnitude of an eclipse at phase 0, up to 2: its depth is twice the amplitude."""
    distance = np.minimum(phase, 1 - phase) / (_ECLIPSE / 2)
    return np.where(distance < 1, 1 + np.cos(np.pi * distance), 0.0)


_LIGHT_CURVES = {"sine": lambda phase: np.sin(2 * np.pi * phase), "saw": _saw, "eclipse": _eclipse}


@numba.njit(cache=True)
def _fill(keys: IntArray, out: FloatArray) -> None:
    for i in range(len(keys)):
        for k in range(out.shape[1]):
            out[i, k] = unit(word(keys[i], np.uint64(k)))


def _uniform_numbers(key: np.uint64, ids: IntArray) -> FloatArray:
    """Return (n, _WORDS) uniform numbers of objects by their ids."""
    out = np.empty((len(ids), _NUMBERS))
    _fill(object_keys(key, np.asarray(ids, np.int64)), out)
    return out
