"""Charge of defective pixels whose places a laboratory map gives: the laws of csstsim.detector.defects.

The numbers of a pixel depend on its column and row in the chip alone (csstsim.base.counter), so that a window reads its
part of the map and has the defects of the chip. Rates, shares and levels are fixed by the chip's key; noise is the
exposure's. The pixels of a bad column in one half of the chip have one level. x, y: int (n,), pixels of the chip; keys:
uint64; `numbers` is instrument.defects.Defects.
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
    x: IntArray, y: IntArray, seconds: float, numbers: Defects, chip: np.uint64, exposure: np.uint64
) -> FloatArray:
    """Return (n,) electrons of hot pixels. chip, exposure: their keys."""
    from scipy.special import gammaincinv

    rate = gammaincinv(numbers.hot_shape, _uniform(x, y, chip)) * numbers.hot_scale / numbers.hot_time
    return _poisson(x, y, np.maximum(rate, numbers.hot_min) * seconds, exposure)


def dead_charge(
    x: IntArray, y: IntArray, level: float, numbers: Defects, chip: np.uint64, exposure: np.uint64
) -> FloatArray:
    """Return (n,) electrons of dead pixels under a background `level`."""
    share = numbers.dead_max * _uniform(x, y, chip)
    return np.maximum(share * level + numbers.dead_noise * _normal(x, y, exposure), 0.0)


def column_charge(
    x: IntArray,
    y: IntArray,
    half_rows: int,
    level: float,
    read_noise: float,
    numbers: Defects,
    chip: np.uint64,
    exposure: np.uint64,
) -> FloatArray:
    """Return (n,) electrons of pixels in bad columns; a half of the chip has `half_rows` rows."""
    from csstsim.detector.defects import column_level

    mean, sigma = column_level(_uniform(x, y // half_rows, chip), level, read_noise, numbers)
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
