"""Two-dimensional splines on a regular lattice of cells: the functions of the distortion model.

On a box cut into equal cells, a spline of order n = 4 is a polynomial of degree 4 in x times one of degree 4 in y
in each cell, three times continuously differentiable across cells. Its B-spline coefficients have shape
(cells_y + 4, cells_x + 4, 2): two functions, the displacements along x and y, share the lattice.

Beyond the box the value is that of the nearest point of the box; polynomials are not extrapolated.
"""

import numpy as np
from numba import njit
from numpy.typing import ArrayLike

from csstsim.base.types import FloatArray

ORDER = 4


@njit(cache=True)
def _basis(t: float, b: FloatArray, slope: FloatArray) -> None:
    """Fill `b` with the ORDER + 1 B-splines not zero at `t` (0..1 within the cell), `slope` with d/dt (de Boor)."""
    b[0] = 1.0
    for d in range(1, ORDER + 1):
        if d == ORDER:
            slope[0] = -b[0]
            for j in range(1, d):
                slope[j] = b[j - 1] - b[j]
            slope[d] = b[d - 1]
        saved = 0.0
        for r in range(d):
            term = b[r] / d
            b[r] = saved + (r + 1 - t) * term
            saved = (t + d - 1 - r) * term
        b[d] = saved


@njit(cache=True)
def _axis(x: float, low: float, high: float, cells: int, b: FloatArray, slope: FloatArray) -> tuple[int, float]:
    """Return (first coefficient, d(cell coordinate)/dx) at x, with `b` and `slope` filled; 0 slope beyond the box."""
    per_px = cells / (high - low)
    s = (min(max(x, low), high) - low) * per_px
    cell = min(int(s), cells - 1)
    _basis(s - cell, b, slope)
    return cell, per_px if low <= x <= high else 0.0


@njit(cache=True)
def value(
    box: FloatArray, coefficients: FloatArray, x: float, y: float, work: FloatArray
) -> tuple[float, float, float, float, float, float]:
    """Return (f, g, f_x, f_y, g_x, g_y): the two functions at a point and their derivatives.

    box: (x0, x1, y0, y1); coefficients: see the module; work: (4, ORDER + 1) scratch array. NaN gives NaN.
    """
    if not (np.isfinite(x) and np.isfinite(y)):
        return np.nan, np.nan, np.nan, np.nan, np.nan, np.nan
    bx, sx, by, sy = work
    i, per_x = _axis(x, box[0], box[1], coefficients.shape[1] - ORDER, bx, sx)
    j, per_y = _axis(y, box[2], box[3], coefficients.shape[0] - ORDER, by, sy)
    f = g = fx = fy = gx = gy = 0.0
    for row in range(ORDER + 1):
        f_line = g_line = f_slope = g_slope = 0.0
        for column in range(ORDER + 1):
            a, b = coefficients[j + row, i + column]
            f_line += bx[column] * a
            g_line += bx[column] * b
            f_slope += sx[column] * a
            g_slope += sx[column] * b
        f += by[row] * f_line
        g += by[row] * g_line
        fx += by[row] * f_slope
        gx += by[row] * g_slope
        fy += sy[row] * f_line
        gy += sy[row] * g_line
    return f, g, fx * per_x, fy * per_y, gx * per_x, gy * per_y


@njit(cache=True)
def _values(box: FloatArray, coefficients: FloatArray, x: FloatArray, y: FloatArray) -> FloatArray:
    out = np.empty((x.size, 2))
    work = np.empty((4, ORDER + 1))
    for n in range(x.size):
        f, g, _, _, _, _ = value(box, coefficients, x[n], y[n], work)
        out[n, 0] = f
        out[n, 1] = g
    return out


def values(box: ArrayLike, coefficients: FloatArray, x: ArrayLike, y: ArrayLike) -> FloatArray:
    """Return the two functions at points x, y (n,), as (n, 2)."""
    return _values(np.asarray(box, float), coefficients, np.asarray(x, float), np.asarray(y, float))
