"""Square grids on the plane tangent to a brick, and interpolation between their points.

A direction is n = (c + x e1 + y e2) / |...|, where c is the brick's centre and e1 is along one of its sides. Shear
components on the grid are in the frame that is carried from c to n along the great circle, and is smooth everywhere,
also around a pole. They are rotated to local east and north only at the sources.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numba import njit

from csstsim.base.arrays.polynomial_weights import lagrange_weights
from csstsim.base.healpix import NSIDE, pixel_border, pixel_vector
from csstsim.base.sphere import ra_dec, unit_vectors
from csstsim.base.types import FloatArray, IntArray

_PAD = np.radians(1 / 60)  # around the brick
TAPS = 8  # points of the Lagrange interpolation along an axis
lagrange = njit()(lagrange_weights)
_HALFWAY = np.array([-5.0, 49.0, -245.0, 1225.0, 1225.0, -245.0, 49.0, -5.0]) / 2048  # its weights at mid-cell
_CHILDREN = 7  # points around a cell: half of 7 for a cell inside it, 2 for cubic interpolation, 1 for its rotation
_LEVELS = 6  # grids of a pyramid


class GridFrames(NamedTuple):
    """The direction of every point of a grid and the carried frame t1, t2 at it, each (rows, columns, 3)."""

    direction: FloatArray
    t1: FloatArray
    t2: FloatArray


@dataclass(frozen=True, eq=False)
class TangentGrid:
    """Points (x, y) = step x (-columns..columns, -rows..rows) [rad] on a plane. `axes` (3, 3): e1, e2, centre."""

    axes: FloatArray
    step: float
    rows: int
    columns: int

    @staticmethod
    def pyramid(pix: int, step: float) -> list[TangentGrid]:
        """Return grids around brick `pix` with steps ... 4, 2, 1 x `step`, each larger than the next."""
        axes, inner = _frame(NSIDE, pix, _side(NSIDE, pix))
        half: Iterable[float] = inner + _PAD
        grids: list[TangentGrid] = []
        for _ in range(_LEVELS):
            columns, rows = (np.ceil(np.asarray(half) / step).astype(int) + TAPS // 2).tolist()
            grids.append(TangentGrid(axes, step, rows, columns))
            half = (columns * step, rows * step)
            step = 2 * step
        return grids[::-1]

    @staticmethod
    def around(order: int, pix: int, step: float, root: int) -> TangentGrid:
        """Return the grid of a HEALPix cell. It extends beyond the grids, of `step` / 2, of the four cells in it.

        All cells in one cell of order `root` have its orientation, so a cell's grid is inside that of its parent cell.
        """
        axes, half = _frame(2**order, pix, _side(2**root, pix >> 2 * (order - root)))
        columns, rows = (np.ceil(half / step).astype(int) + _CHILDREN).tolist()
        return TangentGrid(axes, step, rows, columns)

    @property
    def shape(self) -> tuple[int, int]:
        """(rows, columns) of points."""
        return 2 * self.rows + 1, 2 * self.columns + 1

    @cached_property
    def frames(self) -> GridFrames:
        """Direction and carried frame of every point."""
        e1, e2, centre = self.axes
        x = self.step * np.arange(-self.columns, self.columns + 1)[None, :, None]
        y = self.step * np.arange(-self.rows, self.rows + 1)[:, None, None]
        n = (centre + x * e1 + y * e2) / np.sqrt(1 + x**2 + y**2)
        return GridFrames(n, *_carry(self.axes, n))

    @property
    def centre(self) -> FloatArray:
        """(3,) unit vector of the middle."""
        return self.axes[2]

    @property
    def radius(self) -> float:
        """Angle from the centre to the corners [rad]."""
        return np.arctan(self.step * np.hypot(self.rows, self.columns))

    def boxes(self, points: FloatArray, reach: float) -> IntArray:
        """Return (m, 4) y0, y1, x0, x1: index ranges of all grid points within `reach` [rad] of `points` (m, 3)."""
        rows, columns = self.shape
        angle = np.arccos(np.clip(np.einsum("mk,k->m", points, self.centre), -1, 1))
        if angle.max(initial=0.0) + reach > 1.0:  # the plane ends at pi / 2; wide kernels cover the grid anyway
            return np.tile([0, rows, 0, columns], (len(points), 1))
        centre = _project(points, self.axes) / self.step
        half = ((np.tan(angle + reach) - np.tan(angle)) / self.step)[:, None]
        low = np.ceil(centre - half).astype(int)
        high = np.floor(centre + half).astype(int) + 1
        y0 = np.clip(low[:, 1] + self.rows, 0, rows)
        y1 = np.clip(high[:, 1] + self.rows, 0, rows)
        x0 = np.clip(low[:, 0] + self.columns, 0, columns)
        x1 = np.clip(high[:, 0] + self.columns, 0, columns)
        return np.stack([y0, y1, x0, x1], axis=1)

    def coordinates(self, ra: FloatArray, dec: FloatArray) -> FloatArray:
        """Return grid coordinates (n, 2) x, y [steps from the first point]. Raises ValueError outside and for NaN."""
        return self.vector_coordinates(unit_vectors(ra, dec))

    def vector_coordinates(self, vectors: FloatArray, taps: int = TAPS) -> FloatArray:
        """Return `coordinates` (n, 2) of unit vectors (n, 3); taps: points of the interpolation along an axis."""
        coordinates = _project(vectors, self.axes) / self.step + (self.columns, self.rows)
        inside = (coordinates >= taps // 2 - 1) & (coordinates <= np.array(self.shape)[::-1] - 1 - taps // 2)
        if not inside.all():
            ra, dec = ra_dec(vectors[np.flatnonzero(~inside.all(axis=1))[0]])
            raise ValueError(f"position ra {ra} dec {dec} lies outside the brick")
        return coordinates

    def to_east_north(
        self, ra: FloatArray, dec: FloatArray, gamma1: FloatArray, gamma2: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Return shear (n,) along east and north at each position, from that in the carried frame."""
        t1, t2 = _carry(self.axes, unit_vectors(ra, dec))
        ra = np.radians(ra)
        cosine = t1[:, 1] * np.cos(ra) - t1[:, 0] * np.sin(ra)  # east . t1
        sine = t2[:, 1] * np.cos(ra) - t2[:, 0] * np.sin(ra)
        c2 = cosine**2 - sine**2
        s2 = 2 * sine * cosine
        return gamma1 * c2 + gamma2 * s2, gamma2 * c2 - gamma1 * s2


def prolong(values: FloatArray, coarse: TangentGrid, fine: TangentGrid) -> FloatArray:
    """Return maps (rows, columns, ...) interpolated from the `coarse` grid to the `fine` one of half its step."""
    for axis, (n, m) in enumerate([(coarse.rows, fine.rows), (coarse.columns, fine.columns)]):
        v = np.moveaxis(values, axis, 0)
        count = len(v) - TAPS + 1
        finer = np.empty((2 * len(v) - 1, *v.shape[1:]), v.dtype)
        finer[0::2] = v
        finer[TAPS - 1 : 2 * count + TAPS - 2 : 2] = sum(w * v[k : k + count] for k, w in enumerate(_HALFWAY.tolist()))
        values = np.moveaxis(finer[2 * n - m : 2 * n + m + 1], 0, axis)
    return np.ascontiguousarray(values)


@njit(cache=True)
def interpolate(values: FloatArray, coordinates: FloatArray, weights: FloatArray) -> FloatArray:
    """Return (n, 3): maps (rows, columns, 3, shells), weighted by (n, shells), at grid coordinates (n, 2) x, y.

    Lagrange polynomials through 8 points along each axis.
    """
    shells = values.shape[3]
    out = np.zeros((len(coordinates), 3))
    wx = np.empty(TAPS)
    wy = np.empty(TAPS)
    maps = np.empty((3, shells))
    for g in range(len(coordinates)):
        x0 = min(int(coordinates[g, 0]), values.shape[1] - 1 - TAPS // 2) - TAPS // 2 + 1
        y0 = min(int(coordinates[g, 1]), values.shape[0] - 1 - TAPS // 2) - TAPS // 2 + 1
        lagrange(coordinates[g, 0] - x0, TAPS, wx)
        lagrange(coordinates[g, 1] - y0, TAPS, wy)
        first, last = _span(weights[g])
        maps[:] = 0.0
        for j in range(TAPS):
            for i in range(TAPS):
                w = wy[j] * wx[i]
                for c in range(3):
                    for s in range(first, last):
                        maps[c, s] += w * values[y0 + j, x0 + i, c, s]
        for c in range(3):
            for s in range(first, last):
                out[g, c] += weights[g, s] * maps[c, s]
    return out


@njit(cache=True)
def _span(weights: FloatArray) -> tuple[int, int]:
    """Return the first weight that is not 0, and the one after the last."""
    first = 0
    last = len(weights)
    while first < last and weights[first] == 0:
        first += 1
    while last > first and weights[last - 1] == 0:
        last -= 1
    return first, last


def _frame(nside: int, pix: int, along: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the axes (3, 3) of a HEALPix pixel, the first towards `along`, and its half-widths (2,) in them [rad]."""
    centre = pixel_vector(nside, pix)
    border = pixel_border(nside, pix, step=8)
    side = np.cross(np.cross(centre, along), centre)
    side /= np.linalg.norm(side)
    axes = np.stack([side, np.cross(centre, side), centre])
    return axes, np.abs(_project(border, axes)).max(axis=0)


def _side(nside: int, pix: int) -> FloatArray:
    """Return the vector along the first side of a HEALPix pixel."""
    border = pixel_border(nside, pix, step=8)
    return border[8] - border[0]


def _carry(axes: FloatArray, n: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return e1 and e2, carried from the centre to n (..., 3) by the shortest rotation."""
    e1, e2, centre = axes
    middle = (centre + n) / (1 + np.einsum("...k,k->...", n, centre)[..., None])
    t1 = e1 - np.einsum("...k,k->...", n, e1)[..., None] * middle
    t2 = e2 - np.einsum("...k,k->...", n, e2)[..., None] * middle
    return t1, t2


def _project(vectors: FloatArray, axes: FloatArray) -> FloatArray:
    """Return x, y (m, 2) on the tangent plane of vectors (m, 3) in the hemisphere of its centre."""
    along = np.einsum("mk,ak->ma", vectors, axes)
    return along[:, :2] / along[:, 2:]
