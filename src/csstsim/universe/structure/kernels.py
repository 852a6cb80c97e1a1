"""Sums of the potentials' kernels on grids (potential_field), in single precision and from tables of exp(-u gap).

The tables are linear between nodes and err by 4e-6 of the peak.
"""

import numpy as np
from numba import njit

from csstsim.base.types import FloatArray
from csstsim.universe.lensing.potential_field import Kernels
from csstsim.universe.lensing.tangent_grid import GridFrames

_NODES = 2048  # of a table, from the kernel's centre to its end


@njit(cache=True)
def _table(u: float, gap_max: float) -> tuple[FloatArray, float]:
    """Return u^2 exp(-u gap) at evenly spaced gaps from 0 to beyond `gap_max`, and the nodes per unit of gap."""
    table = np.empty(_NODES + 2)
    for i in range(_NODES + 2):
        table[i] = u * u * np.exp(-u * gap_max * i / _NODES)
    return table, _NODES / gap_max


@njit(inline="always")
def _offset(p: FloatArray, n: FloatArray) -> tuple[float, float, float, float]:
    """Return p - n and the gap 1 - n . p of unit vectors, from p - n because the product loses digits."""
    d0 = p[0] - n[0]
    d1 = p[1] - n[1]
    d2 = p[2] - n[2]
    return d0, d1, d2, 0.5 * (d0 * d0 + d1 * d1 + d2 * d2)


@njit(inline="always")
def _at(table: FloatArray, position: float) -> float:
    """Return a table, linear between nodes, at a position in nodes."""
    k = int(position)
    return table[k] + (position - k) * (table[k + 1] - table[k])


@njit(cache=True)
def add_density(values: FloatArray, directions: FloatArray, kernels: Kernels) -> None:
    """Add kappa of the potential of `kernels` to values (rows, columns, shells), float32 like the deviates.

    directions (rows, columns, 3): of the grid points.
    """
    u = kernels.u
    gap_max = 2 * np.sin(0.5 * kernels.reach) ** 2  # 1 - cos(reach)
    table, scale = _table(u, gap_max)
    for i in range(len(table)):  # of kappa, which depends on the gap alone
        gap = i / scale
        table[i] *= gap * (1.0 - 0.5 * gap) - (1.0 - gap) / u
    for j in range(len(kernels.points)):
        p = kernels.points[j]
        deviate = kernels.deviates[j]
        y0, y1, x0, x1 = kernels.boxes[j]
        for y in range(y0, y1):
            for x in range(x0, x1):
                _, _, _, gap = _offset(p, directions[y, x])
                if gap > gap_max:
                    continue
                kappa = np.float32(_at(table, gap * scale))
                maps = values[y, x]
                for i in range(len(deviate)):
                    maps[i] += kappa * deviate[i]


@njit(cache=True)
def add_lensing(values: FloatArray, frames: GridFrames, kernels: Kernels) -> None:
    """Add kappa, gamma1, gamma2 in the same way to values (rows, columns, 3, shells)."""
    n = frames.direction
    t1 = frames.t1
    t2 = frames.t2
    u = kernels.u
    gap_max = 2 * np.sin(0.5 * kernels.reach) ** 2
    table, scale = _table(u, gap_max)
    for j in range(len(kernels.points)):
        p = kernels.points[j]
        deviate = kernels.deviates[j]
        y0, y1, x0, x1 = kernels.boxes[j]
        for y in range(y0, y1):
            for x in range(x0, x1):
                d0, d1, d2, gap = _offset(p, n[y, x])
                if gap > gap_max:
                    continue
                kernel = _at(table, gap * scale)
                a = d0 * t1[y, x, 0] + d1 * t1[y, x, 1] + d2 * t1[y, x, 2]
                b = d0 * t2[y, x, 0] + d1 * t2[y, x, 1] + d2 * t2[y, x, 2]
                kappa = np.float32(kernel * (0.5 * (a * a + b * b) - (1.0 - gap) / u))
                gamma1 = np.float32(0.5 * kernel * (a * a - b * b))
                gamma2 = np.float32(kernel * a * b)
                maps = values[y, x]
                for i in range(len(deviate)):  # separate loops, because the compiler vectorises them
                    maps[0, i] += kappa * deviate[i]
                for i in range(len(deviate)):
                    maps[1, i] += gamma1 * deviate[i]
                for i in range(len(deviate)):
                    maps[2, i] += gamma2 * deviate[i]
