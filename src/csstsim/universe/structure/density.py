"""The overdensity of a shell of matter, smoothed, at any position on the sky: what haloes and galaxies follow.

    delta_i = kappa_i / K_i,   K_i = int_shell q dchi     (q: lensing kernel for sources at infinity, lens_spectra)

kappa_i is the shell's convergence with only those kernels whose width at the shell is not much below a given scale,
each times the weight with which haloes follow it (halo_spectra).
Maps are made in HEALPix cells, each cell for itself: a cell of order o has the kernels up to order o + 4. It takes the
wider ones from the cell around it, by interpolation, and adds two widths. So a value depends on the cell that holds the
position, and on nothing else: whoever asks gets the same bits. Cells of the lowest order begin with the widest kernels.
Interpolation takes some variance of narrow kernels, 1% in all. `variance` is what is left: with more, haloes of bias b
would be too few by about b^2 / 2 times the difference.
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

_FINER = 4  # orders of the kernels below that of their cell
_ROOT = 1  # order of the widest cells; they have all wider kernels
_WIDEST = 3  # order of the kernels at which the smoothest maps end
_REACH = 3.7  # sigma: the kernel is cut at 6e-3 of its peak
_SAMPLES = 2.0  # grid points per sigma
_CELLS = 96  # maps kept
_TOGETHER = 32  # shells of which the compiler adds maps without a remainder: a third faster
TAPS = 4  # points of the interpolation along an axis
_ELL = np.geomspace(0.5, 3e5, 4000)  # of the variances
_lagrange = njit()(lagrange_weights)


def kernel_order(field: PotentialField, scale: float) -> FloatArray:
    """Return for each shell the order of the kernels down to which matter is smooth on `scale` [Mpc, sigma].

    Orders step by a factor of two. Of a fractional order 5.3, kernels up to order 5 count in full and those of order 6
    with a weight of 0.3. Orders run from 3 (9 degrees) to the finest of the field but one.
    """
    chi = 0.5 * (field.shells.edges[1:] + field.shells.edges[:-1])
    return angular_order(field, scale / chi)


def angular_order(field: PotentialField, sigma: Floats) -> FloatArray:
    """Return the order, as kernel_order, of the kernels down to an angular scale [rad, sigma]."""
    return np.clip(np.log2(WIDTHS[-1] * pixel(0) / sigma), _WIDEST, field.orders - 1)


def kernel_weights(field: PotentialField, order: FloatArray) -> FloatArray:
    """Return the weights (shells, widths) of the kernels in matter smooth down to each shell's `order` (shells,)."""
    return np.clip(np.asarray(order)[:, None] + 1 - np.array([o for o, _ in field.widths]), 0.0, 1.0)


def cell_order(order: int) -> int:
    """Return the HEALPix order of the cells in which maps of kernels up to `order` are made."""
    return max(order - _FINER, _ROOT)


class ShellDensity:
    """`field`: lensing.potential_field.PotentialField with its amplitudes; finest: the finest `kernel_order` in use.

    weights: factors (shells, widths) of the amplitudes, of what is followed over the smooth field (halo_spectra).
    """

    def __init__(self, field: PotentialField, finest: FloatArray, weights: Floats = 1.0) -> None:
        self.field = field
        self._finest = np.ceil(finest)
        self._scale = weights * field.amplitude / field.shells.kernel()[:, None]  # of delta (shells, widths)
        step = np.gradient(np.log(_ELL)) * _ELL**2 / (2 * np.pi)
        self._variances = np.einsum("ls,l->s", field.powers(_ELL), step)  # of kappa for amplitude 1
        self._kept = self._variance_kept()
        self.maps = lru_cache(maxsize=_CELLS)(self._make)

    def variance(self, order: FloatArray) -> FloatArray:
        """Return the variance of delta for each shell, of kernels up to its `order` (shells,), mean over positions."""
        left = self._kept[:, np.ceil(order).astype(int)].T  # (shells, widths)
        return (self._scale**2 * self._variances * left * kernel_weights(self.field, order) ** 2).sum(axis=1)

    def _variance_kept(self) -> FloatArray:
        """Return the fraction (widths, orders) of each width's variance in maps of kernels up to each order."""
        left = np.ones((len(self.field.widths), self.field.orders + 1))
        for s, (own, sigma) in enumerate(self.field.widths):
            for order in range(_ROOT + _FINER, self.field.orders + 1):
                if order >= own:
                    left[s, order:] *= _kept(WIDTHS[-1] * pixel(order) / _SAMPLES / sigma)
            left[s, : _ROOT + _FINER] = left[s, _ROOT + _FINER]  # these share the grids of the lowest order
        return left

    def at(self, ra: FloatArray, dec: FloatArray, shell: IntArray, order: FloatArray) -> FloatArray:
        """Return delta (n,) at ra, dec [deg] in `shell` (n,), with kernels up to `order` (shells,)."""
        ra = np.asarray(ra, float)
        dec = np.asarray(dec, float)
        shell = np.asarray(shell)
        delta = np.zeros(len(ra))
        vectors = unit_vectors(ra, dec)
        orders = np.ceil(order)[shell]
        for o in np.unique(orders):
            rows = np.flatnonzero(orders == o)
            nside = 2 ** cell_order(int(o))
            cells = pixel_of(nside, ra[rows], dec[rows])
            ranked = np.argsort(cells, kind="stable")
            found, start = np.unique(cells[ranked], return_index=True)
            for cell, part in zip(found, np.split(rows[ranked], start[1:]), strict=True):
                grid, maps = self.smooth(int(o), int(cell), np.arange(self.field.shells.count), order)
                delta[part] = interpolate_one(maps, grid.vector_coordinates(vectors[part], TAPS), shell[part])
        return delta

    def smooth(self, highest: int, cell: int, shells: IntArray, order: FloatArray) -> tuple[TangentGrid, FloatArray]:
        """Return the TangentGrid of a cell and maps of delta (rows, columns, len(shells)), smooth down to `order`.

        order: of all shells (shells,); those asked for have the same next whole order, `highest`.
        """
        grid, maps = self.maps(highest, cell)
        share = np.clip(np.asarray(order)[shells] + 1 - highest, 0.0, 1.0).astype(np.float32)
        wide = self._wide(highest, cell, grid, shells)
        return grid, wide + share * (maps[:, :, shells] - wide)

    def _make(self, order: int, cell: int) -> tuple[TangentGrid, FloatArray]:
        """Return the TangentGrid of a cell and its maps of delta (rows, columns, shells)."""
        field = self.field
        at = cell_order(order)
        grid = TangentGrid.around(at, cell, WIDTHS[-1] * pixel(at + _FINER) / _SAMPLES, _ROOT)
        first = int(np.argmax(self._finest >= order))  # nearer shells are smooth on these scales
        count = field.shells.count - first
        padded = -(-count // _TOGETHER) * _TOGETHER
        added = np.zeros((*grid.shape, padded), np.float32)
        for o in range(1, _WIDEST + 1) if order == _WIDEST else [order]:
            widths = [(s, sigma, min(_REACH * sigma, np.pi)) for s, (at, sigma) in enumerate(field.widths) if at == o]
            pixels, points = field.pixels(grid, o, widths[0][2])  # within the reach of the wider
            for s, sigma, reach in widths:
                scaled = np.zeros((len(pixels), padded), np.float32)
                scaled[:, :count] = field.deviates(s, pixels)[:, first:] * self._scale[first:, s].astype(np.float32)
                kernels = Kernels(points, grid.boxes(points, reach), scaled, sigma**-2, reach)
                add_density(added, grid.frames.direction, kernels)
        maps = self._wide(order, cell, grid, np.arange(field.shells.count))
        maps[..., first:] += added[..., :count]
        return grid, maps

    def _wide(self, order: int, cell: int, grid: TangentGrid, shells: IntArray) -> FloatArray:
        """Return the maps (rows, columns, len(shells)) of the kernels of lower orders, on the grid of a cell."""
        if order > _ROOT + _FINER:
            around, maps = self.maps(order - 1, cell >> 2)
            places = around.vector_coordinates(grid.frames.direction.reshape(-1, 3), TAPS)
            return interpolate_all(np.ascontiguousarray(maps[:, :, shells]), places).reshape(*grid.shape, -1)
        if order > _WIDEST:
            return self.maps(order - 1, cell)[1][:, :, shells]
        return np.zeros((*grid.shape, len(shells)), np.float32)


@cache  # steps are few: widths and grids go by powers of two
def _kept(step: float) -> float:
    """Return the mean fraction of a kernel's variance left by interpolation from points `step` x sigma apart.

    The variance is of kappa, whose spectrum is l^4 exp(-l^2 sigma^2) on small scales.
    """
    t = (np.arange(16) + 0.5) / 16
    weights = np.empty((16, TAPS))
    for place, row in zip(t, weights, strict=True):
        lagrange_weights(1 + place, TAPS, row)
    x, w = np.polynomial.laguerre.laggauss(24)  # x = l^2 sigma^2
    angle = np.pi / 2 * (np.arange(16) + 0.5) / 16
    left = np.ones((len(x), len(angle)))
    for along in (np.cos(angle), np.sin(angle)):
        phase = np.multiply.outer(step * np.sqrt(x)[:, None] * along, np.arange(TAPS) - 1 - t[:, None])
        left *= (np.abs((np.exp(1j * phase) * weights).sum(axis=-1)) ** 2).mean(axis=-1)
    return (0.5 * w * x**2) @ left.mean(axis=1)


@njit(cache=True)
def interpolate_all(maps: FloatArray, places: FloatArray) -> FloatArray:
    """Return (n, shells): maps (rows, columns, shells) at grid coordinates (n, 2) x, y, as `interpolate_one`."""
    out = np.zeros((len(places), maps.shape[2]), maps.dtype)
    wx = np.empty(TAPS)
    wy = np.empty(TAPS)
    for g in range(len(places)):
        x0 = min(int(places[g, 0]), maps.shape[1] - 3) - 1
        y0 = min(int(places[g, 1]), maps.shape[0] - 3) - 1
        _lagrange(places[g, 0] - x0, TAPS, wx)
        _lagrange(places[g, 1] - y0, TAPS, wy)
        row = out[g]
        for j in range(TAPS):
            for i in range(TAPS):
                w = np.float32(wy[j] * wx[i])
                from_ = maps[y0 + j, x0 + i]
                for s in range(maps.shape[2]):
                    row[s] += w * from_[s]
    return out


@njit(cache=True)
def interpolate_one(maps: FloatArray, places: FloatArray, shell: IntArray) -> FloatArray:
    """Return (n,): maps (rows, columns, shells) of each position's shell, cubic through 4 points along each axis."""
    out = np.empty(len(places))
    wx = np.empty(TAPS)
    wy = np.empty(TAPS)
    for g in range(len(places)):
        x0 = min(int(places[g, 0]), maps.shape[1] - 3) - 1
        y0 = min(int(places[g, 1]), maps.shape[0] - 3) - 1
        _lagrange(places[g, 0] - x0, TAPS, wx)
        _lagrange(places[g, 1] - y0, TAPS, wy)
        total = 0.0
        for j in range(TAPS):
            for i in range(TAPS):
                total += wy[j] * wx[i] * maps[y0 + j, x0 + i, shell[g]]
        out[g] = total
    return out
