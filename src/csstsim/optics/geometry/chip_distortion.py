"""The distortion of one chip, point by point: compiled loops over the splines of optics.geometry.spline.

The models are those of optics.geometry.few_points.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numba import njit

from csstsim.base.types import FloatArray
from csstsim.optics.geometry.spline import ORDER, value

if TYPE_CHECKING:
    from csstsim.optics.geometry.few_points import Model

_CLOSE_PX = 1e-10  # tolerance of the inverse
_STEPS = 30


@njit(cache=True)
def _distorted(x: float, y: float, model: Model, work: FloatArray) -> tuple[float, float, float, float, float, float]:
    """Return (x', y', xx, xy, yx, yy): where ideal pixel x, y falls, and d(x', y')/d(x, y)."""
    rotation, origin, box, coefficients, chip_box, chip_coefficients = model
    c = rotation[0, 0]
    s = rotation[1, 0]
    u = x - origin[0]
    v = y - origin[1]
    f, g, fx, fy, gx, gy = value(box, coefficients, c * u - s * v, s * u + c * v, work)
    p, q, px, py, qx, qy = value(chip_box, chip_coefficients, x, y, work)
    # Mosaic to chip axes: a vector v becomes R^T v, a matrix M becomes R^T M R.
    fu = fx * c + fy * s
    fv = fy * c - fx * s
    gu = gx * c + gy * s
    gv = gy * c - gx * s
    return (
        x + c * f + s * g + p,
        y + c * g - s * f + q,
        1.0 + c * fu + s * gu + px,
        c * fv + s * gv + py,
        c * gu - s * fu + qx,
        1.0 + c * gv - s * fv + qy,
    )


@njit(cache=True)
def forward(x: FloatArray, y: FloatArray, model: Model) -> FloatArray:
    """Return (n, 6) of `_distorted` for ideal pixels x, y (n,)."""
    out = np.empty((x.size, 6))
    work = np.empty((4, ORDER + 1))
    for n in range(x.size):
        out[n] = _distorted(x[n], y[n], model, work)
    return out


@njit(cache=True)
def inverse(x: FloatArray, y: FloatArray, model: Model) -> FloatArray:
    """Return the ideal pixels (n, 2) whose light falls on pixels x, y (n,), by Newton's method; NaN gives NaN."""
    out = np.full((x.size, 2), np.nan)
    work = np.empty((4, ORDER + 1))
    for n in range(x.size):
        a = x[n]
        b = y[n]
        for _ in range(_STEPS):
            u, v, xx, xy, yx, yy = _distorted(a, b, model, work)
            dx = x[n] - u
            dy = y[n] - v
            det = xx * yy - xy * yx
            a += (yy * dx - xy * dy) / det
            b += (xx * dy - yx * dx) / det
            # The second term is the rounding error of positions far from the chip.
            if abs(dx) + abs(dy) < _CLOSE_PX + 1e-14 * (abs(x[n]) + abs(y[n])):
                out[n, 0] = a
                out[n, 1] = b
                break
    return out
