"""A chip's distortion without compiled code, bit for bit the same as optics.geometry.chip_distortion.

numpy evaluates all points at once, each sum in the order of the compiled loops. It is slower for many calls, but saves
0.8 s of numba's start in a process that evaluates only one window or one chip's objects. Arguments, models and results
are those of that module.
"""

from typing import NamedTuple

import numpy as np

from csstsim.base.types import FloatArray, IntArray

_ORDER = 4  # of the splines: optics.geometry.spline, which compiles
# tolerance and steps of the inverse
_CLOSE_PX = 1e-10
_STEPS = 30
_BLOCK = 2000  # points at a time, so that their sums stay in cache


class Model(NamedTuple):
    """A chip's distortion: its position in the mosaic, and two splines (optics.geometry.spline), float64 arrays.

    rotation (2, 2) and origin (2,): of optics.geometry.wcs.chip_plane. box (4,), coefficients (rows, columns, 2): the
    global spline, of mosaic positions [px]. chip_box, chip_coefficients: the residual spline, of the chip's ideal
    pixels.
    """

    rotation: FloatArray
    origin: FloatArray
    box: FloatArray
    coefficients: FloatArray
    chip_box: FloatArray
    chip_coefficients: FloatArray


class _SplineValues(NamedTuple):
    """A spline's functions f, g and their derivatives, (n,) each."""

    f: FloatArray
    g: FloatArray
    fx: FloatArray
    fy: FloatArray
    gx: FloatArray
    gy: FloatArray


class _Distorted(NamedTuple):
    """Where n ideal pixels x, y fall [px], and the derivatives: xy is dx'/dy."""

    x: FloatArray
    y: FloatArray
    xx: FloatArray
    xy: FloatArray
    yx: FloatArray
    yy: FloatArray


class _Axis(NamedTuple):
    """The B-splines along one axis at n points."""

    first: IntArray  # (n,) first coefficient
    basis: list[FloatArray]  # (ORDER + 1, n)
    slope: list[FloatArray]  # (ORDER + 1, n), d(basis)/d(cell coordinate)
    per_px: FloatArray  # (n,) d(cell coordinate)/dx, 0 beyond the box


def forward(x: FloatArray, y: FloatArray, model: Model) -> FloatArray:
    """Return (n, 6): where ideal pixels x, y (n,) fall, and d(x', y')/d(x, y)."""
    out = np.empty((x.size, 6))
    with np.errstate(invalid="ignore", over="ignore"):
        for first in range(0, x.size, _BLOCK):
            block = slice(first, first + _BLOCK)
            out[block] = np.stack(_distorted(x[block], y[block], model), axis=-1)
    return out


def _distorted(x: FloatArray, y: FloatArray, model: Model) -> _Distorted:
    """Return the _Distorted of ideal pixels x, y (n,)."""
    rotation, origin, box, coefficients, chip_box, chip_coefficients = model
    c = rotation[0, 0]
    s = rotation[1, 0]
    u = x - origin[0]
    v = y - origin[1]
    f, g, fx, fy, gx, gy = _value(box, coefficients, c * u - s * v, s * u + c * v)
    p, q, px, py, qx, qy = _value(chip_box, chip_coefficients, x, y)
    fu = fx * c + fy * s
    fv = fy * c - fx * s
    gu = gx * c + gy * s
    gv = gy * c - gx * s
    return _Distorted(
        x + c * f + s * g + p,
        y + c * g - s * f + q,
        1.0 + c * fu + s * gu + px,
        c * fv + s * gv + py,
        c * gu - s * fu + qx,
        1.0 + c * gv - s * fv + qy,
    )


def inverse(x: FloatArray, y: FloatArray, model: Model) -> FloatArray:
    """Return the ideal pixels (n, 2) whose light falls on pixels x, y (n,), by Newton's method; NaN gives NaN."""
    out = np.full((x.size, 2), np.nan)
    left = np.arange(x.size)
    a = x
    b = y
    with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
        for _ in range(_STEPS):
            u, v, xx, xy, yx, yy = forward(a, b, model).T
            dx = x[left] - u
            dy = y[left] - v
            det = xx * yy - xy * yx
            a = a + (yy * dx - xy * dy) / det
            b = b + (xx * dy - yx * dx) / det
            close = np.abs(dx) + np.abs(dy) < _CLOSE_PX + 1e-14 * (np.abs(x[left]) + np.abs(y[left]))
            out[left[close]] = np.stack([a[close], b[close]], axis=-1)
            left = left[~close]
            a = a[~close]
            b = b[~close]
            if not len(left):
                break
    return out


def _value(box: FloatArray, coefficients: FloatArray, x: FloatArray, y: FloatArray) -> _SplineValues:
    """Return the _SplineValues at points x, y (n,). NaN gives NaN."""
    known = np.isfinite(x) & np.isfinite(y)
    x0, x1, y0, y1 = box
    cells_x = coefficients.shape[1] - _ORDER
    cells_y = coefficients.shape[0] - _ORDER
    i, bx, sx, per_x = _axis(np.where(known, x, x0), x0, x1, cells_x)
    j, by, sy, per_y = _axis(np.where(known, y, y0), y0, y1, cells_y)
    after = np.arange(_ORDER + 1)
    near = coefficients[(j[:, None] + after)[:, :, None], (i[:, None] + after)[:, None, :]]  # (n, rows, columns, 2)
    near = np.ascontiguousarray(np.transpose(near, (2, 1, 3, 0)))  # (columns, rows, 2, n)
    line = slope = np.zeros(())
    for column in after:
        line = line + bx[column] * near[column]
        slope = slope + sx[column] * near[column]
    value = along = across = np.zeros(())
    for row in after:
        value = value + by[row] * line[row]
        along = along + by[row] * slope[row]
        across = across + sy[row] * line[row]
    f, g = value
    f_along, g_along = along
    f_across, g_across = across
    out = _SplineValues(f, g, f_along * per_x, f_across * per_y, g_along * per_x, g_across * per_y)
    return out if known.all() else _SplineValues(*(np.where(known, part, np.nan) for part in out))


def _axis(x: FloatArray, low: float, high: float, cells: int) -> _Axis:
    """Return the _Axis at x (n,), of `cells` cells from low to high."""
    per_px = cells / (high - low)
    position = (np.minimum(np.maximum(x, low), high) - low) * per_px
    cell = np.minimum(position.astype(int), cells - 1)
    basis, slope = _basis(position - cell)
    return _Axis(cell, basis, slope, np.where((low <= x) & (x <= high), per_px, 0.0))


def _basis(t: FloatArray) -> tuple[list[FloatArray], list[FloatArray]]:
    """Return the ORDER + 1 B-splines that are not zero at `t` (0..1 within the cell) and their d/dt (de Boor)."""
    b = [np.ones_like(t)]
    for d in range(1, _ORDER + 1):
        if d == _ORDER:
            slope = [-b[0], *(b[j - 1] - b[j] for j in range(1, d)), b[d - 1]]
        saved = np.zeros(())
        terms = []
        for r in range(d):
            term = b[r] / d
            terms.append(saved + (r + 1 - t) * term)
            saved = (t + d - 1 - r) * term
        b = [*terms, saved]
    return b, slope
