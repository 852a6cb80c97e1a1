"""Random numbers of injected light, by pixel: they do not depend on other objects, the window or the order of work.

The simulator's own Poisson numbers run along whole rows (detector.random.poisson). Injected light covers a few pixels
in a hundred, so its numbers are drawn for these alone.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numba
import numpy as np

from csstsim.base.counter import poisson, word
from csstsim.base.types import FloatArray, IntArray

if TYPE_CHECKING:
    from csstsim.instrument.chip import Window

_ZERO = np.uint64(0)


@numba.njit(cache=True)
def shot(mean: FloatArray, place: IntArray, key: np.uint64) -> IntArray:
    """Return (n,) int64 Poisson numbers of means (n,) >= 0 [e-] at places (n,) uint64 on the chip; key: uint64."""
    counts = np.empty(len(mean), np.int64)
    for i in range(len(mean)):
        counts[i] = poisson(np.float64(mean[i]), word(key, place[i]), _ZERO)[0]
    return counts


def places(pixel: IntArray, window: Window, nx: int) -> IntArray:
    """Return (n,) uint64: numbers on a chip of nx columns of flat indices (n,) of a Window's pixels."""
    row, column = np.divmod(np.asarray(pixel, np.int64), window.nx)
    return ((row + window.y0) * nx + column + window.x0).astype(np.uint64)
