"""Wings far from their objects, where they are smooth: summed on coarse meshes and added to the chip once.

Near an object its wing is rendered pixel by pixel (render.wings). Further out it is rendered on five meshes of 8 to 128
px, one per range of radius. From each of the radii OVER to twice that radius one mesh fades into the next, twice as
coarse, by the step function that joins box and wing; the last mesh has no outer limit. Each mesh holds the sum of all
wings and is turned into coefficients of a cubic spline. A coarse spline is exactly a finer one with other coefficients,
so coarse meshes are refined, summed, and evaluated together at each pixel. Relative error of a wing: 4e-4 where one
mesh takes over from another, 3e-3 where the first one does so at 48 px, 1e-4 elsewhere.

Cost: about 40,000 mesh points per object, whatever its brightness, and one pass over the chip for all objects.

The electrons that each object puts on the window are returned too. They are linear in the mesh values: a sum weighted
by what a mesh point of value 1 puts on the window, response included (`_collect`, the transpose of spline evaluation).
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numba
import numpy as np

from csstsim.catalog.profiles.log_table import read

if TYPE_CHECKING:
    from collections.abc import Sequence

    from csstsim.base.types import FloatArray
    from csstsim.render.canvas import Canvas
    from csstsim.render.wing_tables import Annulus

MESH = 8  # px, of the finest mesh
FACTOR = 2  # from one mesh to the next
OVER = 192.0, 384.0, 768.0, 1536.0  # px: from each radius to twice that, the next mesh takes over
LEVELS = len(OVER) + 1
_MARGIN = 14  # mesh points beyond the window; the spline is zero at its ends, an effect of 0.27^14 = 1e-8 inside
_PHASE = np.arange(MESH) / MESH
_SPLINE = (
    np.stack(  # cubic B-splines at -1, 0, 1, 2 of each position between two mesh points
        [(1 - _PHASE) ** 3, 4 - 6 * _PHASE**2 + 3 * _PHASE**3, 1 + 3 * (_PHASE + _PHASE**2 - _PHASE**3), _PHASE**3]
    )
    / 6
)
_FINER = np.array([1, 4, 6, 4, 1]) / 8  # a cubic B-spline as a sum of those of half the width, -2 to 2 of them away


class Side(NamedTuple):
    """Limits [px] from an object, beyond which its light is cut off."""

    x0: float
    x1: float
    y0: float
    y1: float


WHOLE = Side(-math.inf, math.inf, -math.inf, math.inf)  # limits of a wing that no edge cuts


class FarWings:
    """The meshes of one render.canvas.Canvas. Call `add` for each wing, then `add_to_canvas` once."""

    def __init__(self, canvas: Canvas) -> None:
        self._canvas = canvas
        steps = [MESH * FACTOR**level for level in range(LEVELS)]
        self._meshes = [np.zeros([-(-n // step) + 2 * _MARGIN + 3 for n in canvas.window.shape]) for step in steps]
        self._weights: list[FloatArray] = []

    def add(
        self,
        level: int,
        at: Sequence[float],
        annulus: Annulus,
        side: Side = WHOLE,
        soft: float = 1.0,
    ) -> float:
        """Add the values of an annulus about `at` (x, y) [chip pixel] to the mesh `level`.

        annulus: render.wing_tables.Annulus, its table (n,); side: Side beyond which the values are cut off, over `soft`
        px. Returns the electrons on the window; for a wing outside the window, ripples of the spline may make them
        negative by 1e-8 of the light.
        """
        if not self._weights:
            self._weigh()
        step = MESH * FACTOR**level
        window = self._canvas.window
        x, y = at
        u = (x - window.x0) / step + _MARGIN
        v = (y - window.y0) / step + _MARGIN
        edges = Side(side.x0 / step, side.x1 / step, side.y0 / step, side.y1 / step)
        return _add(self._meshes[level], self._weights[level], u, v, annulus, edges, soft / step, float(step))

    def _weigh(self) -> None:
        self._weights = [np.zeros(mesh.shape) for mesh in self._meshes]
        _collect(self._weights[0], self._canvas.response_array, _SPLINE)
        for fine, coarse in zip(self._weights[:-1], self._weights[1:], strict=True):
            coarse[:] = _gathered(fine, *coarse.shape)
        for weight in self._weights:
            _coefficients(weight)

    def add_to_canvas(self) -> None:
        """Add the wings to the expected electrons."""
        if not self._weights:
            return
        total = None
        for mesh in reversed(self._meshes):
            _coefficients(mesh)
            if total is not None:
                mesh += _refined(total, *mesh.shape)
            total = mesh
        assert total is not None and self._canvas.expected is not None  # None: for photons alone
        _spread(self._canvas.expected, total, self._canvas.response_array, _SPLINE)


@numba.njit(cache=True)
def _refined(coarse: FloatArray, rows: int, columns: int) -> FloatArray:
    """Return the coefficients (rows, columns) of the same spline on the next finer mesh."""
    tall = _finer_rows(coarse, rows)
    return np.ascontiguousarray(_finer_rows(np.ascontiguousarray(tall.T), columns).T)


@numba.njit(cache=True)
def _gathered(fine: FloatArray, rows: int, columns: int) -> FloatArray:
    """Return (rows, columns): the transpose of `_refined`."""
    flat = _coarser_rows(fine, rows)
    return np.ascontiguousarray(_coarser_rows(np.ascontiguousarray(flat.T), columns).T)


@numba.njit(cache=True)
def _finer_rows(coarse: FloatArray, rows: int) -> FloatArray:
    out = np.zeros((rows, coarse.shape[1]))
    for k in range(coarse.shape[0]):
        for i in range(len(_FINER)):
            row = FACTOR * (k - _MARGIN) + _MARGIN + i - len(_FINER) // 2
            if 0 <= row < rows:
                out[row] += _FINER[i] * coarse[k]
    return out


@numba.njit(cache=True)
def _coarser_rows(fine: FloatArray, rows: int) -> FloatArray:
    out = np.zeros((rows, fine.shape[1]))
    for k in range(rows):
        for i in range(len(_FINER)):
            row = FACTOR * (k - _MARGIN) + _MARGIN + i - len(_FINER) // 2
            if 0 <= row < fine.shape[0]:
                out[k] += _FINER[i] * fine[row]
    return out


@numba.njit(cache=True)
def _coefficients(mesh: FloatArray) -> None:
    """Turn values in place into coefficients of the cubic B-spline that is zero beyond the mesh; a symmetric map."""
    _along(mesh)
    turned = np.ascontiguousarray(mesh.T)
    _along(turned)
    mesh[:] = turned.T


@numba.njit(cache=True)
def _along(mesh: FloatArray) -> None:
    """Solve c[k-1] + 4 c[k] + c[k+1] = 6 f[k] along axis 0, c zero beyond the ends."""
    n, width = mesh.shape
    ratio = np.empty(n)
    ratio[0] = 0.25
    for j in range(width):
        mesh[0, j] *= 6 * ratio[0]
    for k in range(1, n):
        ratio[k] = 1.0 / (4.0 - ratio[k - 1])
        for j in range(width):
            mesh[k, j] = (6 * mesh[k, j] - mesh[k - 1, j]) * ratio[k]
    for k in range(n - 2, -1, -1):
        for j in range(width):
            mesh[k, j] -= ratio[k] * mesh[k + 1, j]


@numba.njit(inline="always")
def between(at: float, low: float, high: float, soft: float) -> float:
    """Return 1 for a position between low and high, 0 outside, with a linear ramp of width `soft` at each limit."""
    return min(max((at - low) / soft + 0.5, 0.0), 1.0) * min(max((high - at) / soft + 0.5, 0.0), 1.0)


@numba.njit(cache=True)
def _add(
    mesh: FloatArray,
    weight: FloatArray,
    u: float,
    v: float,
    annulus: Annulus,
    side: Side,
    soft: float,
    step: float,
) -> float:
    """Add an annulus around mesh position u, v; return the weighted sum of the added values.

    step: of the mesh [px]; side, soft: in mesh steps.
    """
    ny, nx = mesh.shape
    table = annulus.table
    first = annulus.first
    reach = annulus.reach / step
    square = np.empty(1)
    total = 0.0
    across = np.empty(nx)
    for column in range(nx):
        across[column] = between(column - u, side.x0, side.x1, soft)
    bits = square.view(np.int64)
    for row in range(max(0, math.ceil(v - reach)), min(ny, math.floor(v + reach) + 1)):
        dy2 = (row - v) ** 2
        half = math.sqrt(max(reach**2 - dy2, 0.0))
        inside = between(row - v, side.y0, side.y1, soft)
        for column in range(max(0, math.ceil(u - half)), min(nx, math.floor(u + half) + 1)):
            square[0] = (dy2 + (column - u) ** 2) * step**2
            value = read(table, first, bits[0]) * inside * across[column]
            mesh[row, column] += value
            total += value * weight[row, column]
    return total


@numba.njit(cache=True)
def _spread(image: FloatArray, mesh: FloatArray, response: FloatArray, spline: FloatArray) -> None:
    """Add the spline's value at each pixel, times the response."""
    line = np.empty(mesh.shape[1])
    value = np.empty(MESH)
    for y in range(image.shape[0]):
        row = y // MESH + _MARGIN - 1
        phase = y % MESH
        for j in range(len(line)):
            line[j] = (
                spline[0, phase] * mesh[row, j]
                + spline[1, phase] * mesh[row + 1, j]
                + spline[2, phase] * mesh[row + 2, j]
                + spline[3, phase] * mesh[row + 3, j]
            )
        for x in range(0, image.shape[1], MESH):
            j = x // MESH + _MARGIN - 1
            a = line[j]
            b = line[j + 1]
            c = line[j + 2]
            d = line[j + 3]
            for k in range(MESH):
                value[k] = spline[0, k] * a + spline[1, k] * b + spline[2, k] * c + spline[3, k] * d
            part = image[y, x : x + MESH]
            seen = response[y, x : x + MESH]
            for k in range(len(part)):
                part[k] = max(part[k] + value[k] * seen[k], 0.0)  # the spline undershoots zero where light ends


@numba.njit(cache=True)
def _collect(weight: FloatArray, response: FloatArray, spline: FloatArray) -> None:
    """Add to `weight` the sum of response x spline of each mesh point: the transpose of `_spread`."""
    ny, nx = response.shape
    sums = np.empty((4, -(-nx // MESH) * MESH))
    for first in range(0, ny, MESH):
        sums[:] = 0.0
        for y in range(first, min(first + MESH, ny)):
            for i in range(4):
                factor = spline[i, y - first]
                line = sums[i, :nx]
                seen = response[y]
                for x in range(nx):
                    line[x] += factor * seen[x]
        row = first // MESH + _MARGIN - 1
        for i in range(4):
            for x in range(0, nx, MESH):
                part = sums[i, x : x + MESH]
                j = x // MESH + _MARGIN - 1
                for m in range(4):
                    for k in range(MESH):
                        weight[row + i, j + m] += spline[m, k] * part[k]
