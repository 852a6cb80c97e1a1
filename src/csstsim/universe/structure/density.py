"""The smoothed overdensity of a shell of matter at any position on the sky, which haloes and galaxies follow.

    delta_i = kappa_i / K_i,   K_i = int_shell q dchi     (q: lensing kernel for sources at infinity, lens_spectra)

kappa_i is the shell's convergence by those kernels whose width at the shell is not much below a given scale, each times
the weight with which haloes follow it (halo_spectra).
Maps are made independently in each HEALPix cell. A cell of order o has the kernels up to order o + 4. It takes the
wider ones from its parent cell, by interpolation, and adds two widths. So a value depends only on the cell that
contains the position, and has the same bits in any brick. Cells of the lowest order start with the widest kernels.
Interpolation reduces the variance of narrow kernels, by 1% in all. `variance` accounts for this: without it, haloes of
bias b would be too few by about b^2 / 2 times the difference.
"""

from __future__ import annotations

from functools import cache, lru_cache
from typing import TYPE_CHECKING

import numpy as np
from numba import njit

from csstsim.base.arrays.polynomial_weights import lagrange_weights
from csstsim.base.healpix import pixel_of
from csstsim.base.sphere import unit_vectors
from csstsim.base.types import FloatArray, Floats, IntArray
from csstsim.universe.lensing.potential_field import WIDTHS, Kernels, pixel
from csstsim.universe.lensing.tangent_grid import TangentGrid
from csstsim.universe.structure.kernels import add_density

if TYPE_CHECKING:
    from csstsim.universe.lensing.potential_field import PotentialField

_ORDERS_BELOW = 4  # orders from a cell to its finest kernels
_ROOT = 1  # order of the largest cells; they have all wider kernels
_WIDEST = 3  # order of the kernels at which the smoothest maps end
_REACH = 3.7  # sigma: the kernel is cut at 6e-3 of its peak
_SAMPLES = 2.0  # grid points per sigma
_CELLS = 96  # maps in the cache
_PADDED_TO = 32  # multiple of shells that the compiler adds without a remainder: a third faster
TAPS = 4  # points of the interpolation along an axis
_ELL = np.geomspace(0.5, 3e5, 4000)  # of the variances
_lagrange = njit()(lagrange_weights)


def kernel_order(field: PotentialField, scale: float) -> FloatArray:
    """Return for each shell the order of the kernels down to which matter is smooth on `scale` [Mpc, sigma].

    Orders step by a factor of two. For a fractional order of 5.3, kernels up to order 5 have weight 1 and those of
    order 6 weight 0.3. Orders run from 3 (9 degrees) to one below the finest of the field.
    """
    chi = 0.5 * (field.shells.edges[1:] + field.shells.edges[:-1])
    return angular_order(field, scale / chi)


def angular_order(field: PotentialField, sigma: Floats) -> FloatArray:
    """Return the order, as kernel_order, of the kernels down to an angular scale [rad, sigma]."""
    return np.clip(np.log2(WIDTHS[-1] * pixel(0) / sigma), _WIDEST, field.orders - 1)


def kernel_weights(field: PotentialField, order: FloatArray) -> FloatArray:
    """Return the weights (shells, widths) of the kernels in matter smooth down to each shell's `order` (shells,)."""
    return np.clip(np.asarray(order)[:, None] + 1 - np.array([width.order for width in field.widths]), 0.0, 1.0)


def cell_order(order: int) -> int:
    """Return the HEALPix order of the cells in which maps of kernels up to `order` are made."""
    return max(order - _ORDERS_BELOW, _ROOT)


class ShellDensity:
    """`field`: lensing.potential_field.PotentialField with its amplitudes; finest: the finest `kernel_order` in use.

    weights: factors (shells, widths) of the amplitudes, from the smooth field to the followed one (halo_spectra).
    """

    def __init__(self, field: PotentialField, finest: FloatArray, weights: Floats = 1.0) -> None:
        self.field = field
        self._finest = np.ceil(finest)
        self._scale = weights * field.amplitude / field.shells.kernel()[:, None]  # of delta (shells, widths)
        step = np.gradient(np.log(_ELL)) * _ELL**2 / (2 * np.pi)
        self._variances = np.einsum("ls,l->s", field.powers(_ELL), step)  # of kappa for amplitude 1
        self._left = self._variance_left()
        self.maps = lru_cache(maxsize=_CELLS)(self._make)

    def variance(self, order: FloatArray) -> FloatArray:
        """Return the variance (shells,) of delta by kernels up to `order` (shells,), averaged on the sky."""
        left = self._left[:, np.ceil(order).astype(int)].T  # (shells, widths)
        return (self._scale**2 * self._variances * left * kernel_weights(self.field, order) ** 2).sum(axis=1)

    def _variance_left(self) -> FloatArray:
        """Return the fraction (widths, orders) of each width's variance in maps of kernels up to each order."""
        left = np.ones((len(self.field.widths), self.field.orders + 1))
        for s, width in enumerate(self.field.widths):
            for order in range(_ROOT + _ORDERS_BELOW, self.field.orders + 1):
                if order >= width.order:
                    left[s, order:] *= _fraction_left(WIDTHS[-1] * pixel(order) / _SAMPLES / width.sigma)
            left[s, : _ROOT + _ORDERS_BELOW] = left[s, _ROOT + _ORDERS_BELOW]  # they have the grids of the lowest order
        return left

    def at(self, ra: FloatArray, dec: FloatArray, shell: IntArray, order: FloatArray) -> FloatArray:
        """Return delta (n,) at ra, dec [deg] in `shell` (n,), with kernels up to `order` (shells,)."""
        ra = np.asarray(ra, float)
        dec = np.asarray(dec, float)
        shell = np.asarray(shell)
        delta = np.zeros(len(ra))
        vectors = unit_vectors(ra, dec)
        orders = np.ceil(order)[shell]
        for highest in np.unique(orders):
            rows = np.flatnonzero(orders == highest)
            nside = 2 ** cell_order(int(highest))
            cells = pixel_of(nside, ra[rows], dec[rows])
            by_cell = np.argsort(cells, kind="stable")
            cells_found, start = np.unique(cells[by_cell], return_index=True)
            for cell, members in zip(cells_found, np.split(rows[by_cell], start[1:]), strict=True):
                grid, maps = self.smooth(int(highest), int(cell), np.arange(self.field.shells.count), order)
                delta[members] = interpolate_one(maps, grid.vector_coordinates(vectors[members], TAPS), shell[members])
        return delta

    def smooth(self, highest: int, cell: int, shells: IntArray, order: FloatArray) -> tuple[TangentGrid, FloatArray]:
        """Return the TangentGrid of a cell and maps of delta (rows, columns, len(shells)), smooth down to `order`.

        order (shells,): of all shells; rounded up, that of `shells` is `highest`.
        """
        grid, maps = self.maps(highest, cell)
        fraction = np.clip(np.asarray(order)[shells] + 1 - highest, 0.0, 1.0).astype(np.float32)
        wider = self._wider_kernels(highest, cell, grid, shells)
        return grid, wider + fraction * (maps[:, :, shells] - wider)

    def _make(self, order: int, cell: int) -> tuple[TangentGrid, FloatArray]:
        """Return the TangentGrid of a cell and its maps of delta (rows, columns, shells)."""
        field = self.field
        level = cell_order(order)
        grid = TangentGrid.around(level, cell, WIDTHS[-1] * pixel(level + _ORDERS_BELOW) / _SAMPLES, _ROOT)
        first_shell = int(np.argmax(self._finest >= order))  # nearer shells are smooth on these scales
        count = field.shells.count - first_shell
        padded = -(-count // _PADDED_TO) * _PADDED_TO
        added = np.zeros((*grid.shape, padded), np.float32)
        for new_order in range(1, _WIDEST + 1) if order == _WIDEST else [order]:
            widths = [s for s, width in enumerate(field.widths) if width.order == new_order]
            widest = min(_REACH * field.widths[widths[0]].sigma, np.pi)
            pixels, points = field.pixels(grid, new_order, widest)
            for s in widths:
                sigma = field.widths[s].sigma
                reach = min(_REACH * sigma, np.pi)
                scale = self._scale[first_shell:, s].astype(np.float32)
                scaled = np.zeros((len(pixels), padded), np.float32)
                scaled[:, :count] = field.deviates(s, pixels)[:, first_shell:] * scale
                kernels = Kernels(points, grid.boxes(points, reach), scaled, sigma**-2, reach)
                add_density(added, grid.frames.direction, kernels)
        maps = self._wider_kernels(order, cell, grid, np.arange(field.shells.count))
        maps[..., first_shell:] += added[..., :count]
        return grid, maps

    def _wider_kernels(self, order: int, cell: int, grid: TangentGrid, shells: IntArray) -> FloatArray:
        """Return the maps (rows, columns, len(shells)) of the kernels of lower orders, on the grid of a cell."""
        if order > _ROOT + _ORDERS_BELOW:
            parent, maps = self.maps(order - 1, cell >> 2)
            coordinates = parent.vector_coordinates(grid.frames.direction.reshape(-1, 3), TAPS)
            return interpolate_all(np.ascontiguousarray(maps[:, :, shells]), coordinates).reshape(*grid.shape, -1)
        if order > _WIDEST:
            return self.maps(order - 1, cell)[1][:, :, shells]
        return np.zeros((*grid.shape, len(shells)), np.float32)


@cache  # there are few steps: widths and grids are powers of two apart
def _fraction_left(step: float) -> float:
    """Return the mean fraction of a kernel's variance that is left by interpolation from points `step` x sigma apart.

    The variance is of kappa, whose spectrum is l^4 exp(-l^2 sigma^2) on small scales.
    """
    t = (np.arange(16) + 0.5) / 16
    weights = np.empty((16, TAPS))
    for position, row in zip(t, weights, strict=True):
        lagrange_weights(1 + position, TAPS, row)
    x, w = np.polynomial.laguerre.laggauss(24)  # x = l^2 sigma^2
    angle = np.pi / 2 * (np.arange(16) + 0.5) / 16
    left = np.ones((len(x), len(angle)))
    for component in (np.cos(angle), np.sin(angle)):
        phase = np.multiply.outer(step * np.sqrt(x)[:, None] * component, np.arange(TAPS) - 1 - t[:, None])
        left *= (np.abs((np.exp(1j * phase) * weights).sum(axis=-1)) ** 2).mean(axis=-1)
    return (0.5 * w * x**2) @ left.mean(axis=1)


@njit(cache=True)
def interpolate_all(maps: FloatArray, coordinates: FloatArray) -> FloatArray:
    """Return (n, shells): maps (rows, columns, shells) at grid coordinates (n, 2) x, y, as `interpolate_one`."""
    out = np.zeros((len(coordinates), maps.shape[2]), maps.dtype)
    wx = np.empty(TAPS)
    wy = np.empty(TAPS)
    for g in range(len(coordinates)):
        x0 = min(int(coordinates[g, 0]), maps.shape[1] - 3) - 1
        y0 = min(int(coordinates[g, 1]), maps.shape[0] - 3) - 1
        _lagrange(coordinates[g, 0] - x0, TAPS, wx)
        _lagrange(coordinates[g, 1] - y0, TAPS, wy)
        row = out[g]
        for j in range(TAPS):
            for i in range(TAPS):
                w = np.float32(wy[j] * wx[i])
                point = maps[y0 + j, x0 + i]
                for s in range(maps.shape[2]):
                    row[s] += w * point[s]
    return out


@njit(cache=True)
def interpolate_one(maps: FloatArray, coordinates: FloatArray, shell: IntArray) -> FloatArray:
    """Return (n,): maps (rows, columns, shells) of each position's shell, cubic through 4 points along each axis."""
    out = np.empty(len(coordinates))
    wx = np.empty(TAPS)
    wy = np.empty(TAPS)
    for g in range(len(coordinates)):
        x0 = min(int(coordinates[g, 0]), maps.shape[1] - 3) - 1
        y0 = min(int(coordinates[g, 1]), maps.shape[0] - 3) - 1
        _lagrange(coordinates[g, 0] - x0, TAPS, wx)
        _lagrange(coordinates[g, 1] - y0, TAPS, wy)
        total = 0.0
        for j in range(TAPS):
            for i in range(TAPS):
                total += wy[j] * wx[i] * maps[y0 + j, x0 + i, shell[g]]
        out[g] = total
    return out
