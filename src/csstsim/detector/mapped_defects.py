"""Charge of defective pixels at the positions of a laboratory map: the laws of csstsim.detector.defects.

The random numbers of a pixel depend only on its column and row in the chip (csstsim.base.counter), so a window has the
defects of the chip. The chip's key fixes rates, fractions and levels; noise is the exposure's. The pixels of a bad
column in one half of the chip have one level. x, y: int (n,), pixels of the chip; keys: uint64; `parameters` is
instrument.defects.Defects.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numba
import numpy as np

from csstsim.base.counter import poisson, unit, word
from csstsim.base.types import FloatArray, IntArray
from csstsim.detector.random.normal import pixel_counter

if TYPE_CHECKING:
    from csstsim.instrument.defects import Defects


def hot_charge(
    x: IntArray, y: IntArray, seconds: float, parameters: Defects, chip: np.uint64, exposure: np.uint64
) -> FloatArray:
    """Return (n,) electrons of hot pixels. chip, exposure: their keys."""
    from scipy.special import gammaincinv

    rate = gammaincinv(parameters.hot_shape, _uniform(x, y, chip)) * parameters.hot_scale / parameters.hot_time
    return _poisson(x, y, np.maximum(rate, parameters.hot_min) * seconds, exposure)


def dead_charge(
    x: IntArray, y: IntArray, level: float, parameters: Defects, chip: np.uint64, exposure: np.uint64
) -> FloatArray:
    """Return (n,) electrons of dead pixels under a background `level`."""
    fraction = parameters.dead_max * _uniform(x, y, chip)
    return np.maximum(fraction * level + parameters.dead_noise * _normal(x, y, exposure), 0.0)


def column_charge(
    x: IntArray,
    y: IntArray,
    half_rows: int,
    level: float,
    read_noise: float,
    parameters: Defects,
    chip: np.uint64,
    exposure: np.uint64,
) -> FloatArray:
    """Return (n,) electrons of pixels in bad columns; a half of the chip has `half_rows` rows."""
    from csstsim.detector.defects import column_level

    mean, sigma = column_level(_uniform(x, y // half_rows, chip), level, read_noise, parameters)
    return np.maximum(mean + sigma * _normal(x, y, exposure), 0.0)


def _normal(x: IntArray, y: IntArray, key: np.uint64) -> FloatArray:
    from scipy.special import ndtri

    return ndtri(_uniform(x, y, key))


@numba.njit(cache=True)
def _uniform(x: IntArray, y: IntArray, key: np.uint64) -> FloatArray:
    out = np.empty(len(x))
    for i in range(len(x)):
        out[i] = unit(word(key, pixel_counter(x[i], y[i])))
    return out


@numba.njit(cache=True)
def _poisson(x: IntArray, y: IntArray, mean: FloatArray, key: np.uint64) -> FloatArray:
    out = np.empty(len(x))
    for i in range(len(x)):
        out[i], _ = poisson(mean[i], word(key, pixel_counter(x[i], y[i])), np.uint64(0))
    return out
