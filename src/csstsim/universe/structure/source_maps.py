"""Maps of convergence and shear for sources at evenly spaced distances, and values at sources in between.

Weights of shells are linear in a source's distance between these (lens_spectra.Shells). So two maps at each position
give the same value as the sum over all shells.
"""

import numpy as np
from numba import njit

from csstsim.base.types import FloatArray
from csstsim.universe.lensing.tangent_grid import TAPS, lagrange


@njit(cache=True)
def add_shells(values: FloatArray, weights: FloatArray) -> FloatArray:
    """Return maps (rows, columns, distances, 3): maps (rows, columns, 3, shells) times weights (shells, distances)."""
    rows, columns, _, shells = values.shape
    count = weights.shape[1]
    out = np.empty((rows, columns, count, 3), values.dtype)
    first = np.empty(shells, np.int64)  # weights before it are 0: the source is nearer than the shell
    for s in range(shells):
        first[s] = count
        for k in range(count - 1, -1, -1):
            if weights[s, k] != 0:
                first[s] = k
    total = np.empty(count, values.dtype)
    for y in range(rows):
        for x in range(columns):
            for c in range(3):
                total[:] = 0
                for s in range(shells):
                    value = values[y, x, c, s]
                    weight = weights[s, first[s] :]
                    behind = total[first[s] :]
                    for k in range(len(weight)):
                        behind[k] += value * weight[k]
                out[y, x, :, c] = total
    return out


@njit(cache=True)
def interpolate_depth(maps: FloatArray, coordinates: FloatArray, depth: FloatArray) -> FloatArray:
    """Return (n, 3): maps of add_shells at grid coordinates (n, 2) x, y, and depth (n,) in steps of distance.

    Linear in depth, Lagrange polynomials through 8 points along each axis. Depths beyond the last distance count as it.
    """
    out = np.zeros((len(coordinates), 3))
    wx = np.empty(TAPS)
    wy = np.empty(TAPS)
    for g in range(len(coordinates)):
        x0 = min(int(coordinates[g, 0]), maps.shape[1] - 1 - TAPS // 2) - TAPS // 2 + 1
        y0 = min(int(coordinates[g, 1]), maps.shape[0] - 1 - TAPS // 2) - TAPS // 2 + 1
        lagrange(coordinates[g, 0] - x0, TAPS, wx)
        lagrange(coordinates[g, 1] - y0, TAPS, wy)
        k = min(int(depth[g]), maps.shape[2] - 2)
        fraction = min(depth[g] - k, 1.0)
        for j in range(TAPS):
            for i in range(TAPS):
                w = wy[j] * wx[i]
                both = maps[y0 + j, x0 + i, k : k + 2]
                near = w * (1 - fraction)
                far = w * fraction
                out[g, 0] += near * both[0, 0] + far * both[1, 0]
                out[g, 1] += near * both[0, 1] + far * both[1, 1]
                out[g, 2] += near * both[0, 2] + far * both[1, 2]
    return out
