"""Traps of a column of pixels: number, row and level, the charge above which they act (paper, section 5.5.4).

A packet of N electrons fills the fraction V = [max(N - notch, 0) / full_well]^beta of its pixel. The number of traps of
a species in a pixel is Poisson with mean rho. Each has a watermark u, uniform in 0..1, and interacts with the packet if
u < V, that is if N reaches its level, floor(notch + full_well u^(1 / beta)) + 1 electrons.

The traps are drawn as one Poisson process in (row, watermark): their number in each stratum of the watermark, then a
row and a watermark for each. Strata above the largest packet of a column are not drawn, and a trap gets a level only if
a packet of its row, or of a row behind it, reaches it. So it is cheap to draw the traps again for each exposure. They
depend only on the column's key: nothing is stored on disk, and a window has the traps of the whole chip.
"""

from typing import NamedTuple

import numba
import numpy as np

from csstsim.base.counter import low, poisson, word
from csstsim.base.types import FloatArray, Floats, IntArray
from csstsim.detector.charge_transfer.parameters import TrapModel

EDGES = np.array([0.0, *2.0 ** np.arange(-6.0, 1.0)])  # of the strata; other edges give other traps for the same key
_STRATUM = np.uint64(32)  # bits for the number of a trap in its stratum
_ONE = np.uint64(1)


class TrapLists(NamedTuple):
    """The traps of a line, a linked list for each of its rows. Arrays are used up to the number of traps drawn."""

    head: IntArray  # (n_rows,) int32: the first trap of each row, -1: none
    next_: IntArray  # int32: the trap after it in its row, -1: none
    level: IntArray  # int32 [e-]
    tau: FloatArray  # float64 [transfers]
    bits: IntArray  # uint64, random


def volume(electrons: Floats, beta: float, full_well: float, notch: float) -> Floats:
    """Return the fraction V of a pixel that `electrons` fill (array or scalar; above 1 beyond the full well)."""
    return (np.maximum(electrons - notch, 0.0) / full_well) ** beta


def trap_lists(density: FloatArray, n_rows: int) -> TrapLists:
    """Return TrapLists to be filled: head (n_rows,), the others (size,), for the traps of any line.

    The number of traps is Poisson; the size is 12 standard deviations above its mean.
    """
    mean = float(np.sum(density)) * n_rows
    size = int(mean + 12 * np.sqrt(mean) + 64)
    return TrapLists(
        head=np.empty(n_rows, np.int32),
        next_=np.empty(size, np.int32),
        level=np.empty(size, np.int32),
        tau=np.empty(size),
        bits=np.empty(size, np.uint64),
    )


@numba.njit(cache=True)
def draw_traps(key: np.uint64, model: TrapModel, filled: FloatArray, traps: TrapLists) -> int:
    """Fill `traps` with those of a column that packets can reach; return their number.

    key: uint64 of the column; filled: (n_rows,), the fraction of a pixel that the largest packet of a row, or behind
    it, fills; it does not increase with the row.
    """
    density, timescale, well = model
    beta, full_well, notch = well
    head, next_, level, tau, words = traps
    n_rows = np.uint64(len(head))
    head[:] = -1
    n = 0
    for stratum in range(len(EDGES) - 1):
        bottom = EDGES[stratum]
        width = EDGES[stratum + 1] - EDGES[stratum]
        if bottom >= filled[0]:
            break
        for species in range(len(density)):
            stratum_key = word(key, np.uint64(stratum * len(density) + species))
            count, _ = poisson(density[species] * n_rows * width, stratum_key, np.uint64(0))
            for i in range(min(count, len(level) - n)):
                bits = word(stratum_key, (_ONE << _STRATUM) + np.uint64(i))
                watermark = bottom + width * low(bits)
                row = ((bits >> _STRATUM) * n_rows) >> _STRATUM
                if watermark < filled[row]:
                    level[n] = int(notch + full_well * watermark ** (1.0 / beta)) + 1
                    tau[n] = timescale[species]
                    words[n] = bits
                    next_[n] = head[row]
                    head[row] = n
                    n += 1
    return n
