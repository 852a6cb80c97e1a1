"""Gaussian random potentials on the whole sky, one per shell of matter; each position can be computed independently.

    kappa_i = 1/2 laplacian psi_i,   gamma1 = 1/2 (psi_EE - psi_NN),   gamma2 = psi_EN   (E east, N north on the sphere)

    psi_i(n) = sum_s a_is sum_p x_isp exp(-(1 - n . p) / sigma_s^2)

The x are independent normal deviates at the centres p of HEALPix pixels finer than sigma_s. The kernels are local, so a
brick needs only the deviates around it. They are differentiated in closed form, so the shear matches the convergence
exactly (no B mode), also at the poles. The widths run in steps of sqrt(2) from 40 deg to 0.3 arcmin. Values at galaxies
are interpolated on a tangent grid. The spectra of the kappa_i are set by the amplitudes a_is, which a subclass fits.
"""

from __future__ import annotations

from functools import lru_cache
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numba import njit
from scipy.special import ive

from csstsim.base.healpix import disc, pixel_vector
from csstsim.base.rng import stream
from csstsim.base.types import FloatArray, Floats, IntArray
from csstsim.universe.lensing.tangent_grid import GridFrames, TangentGrid, interpolate, prolong

if TYPE_CHECKING:
    from csstsim.universe.lensing.lens_spectra import Shells

_FINEST = 1.65  # l_max x sigma of the narrowest kernel: it has half its power at l_max x 1.35
WIDTHS = (1.3 * np.sqrt(2), 1.3)  # sigma in pixels; at 1.3 they change the local variance by 0.3 % at most
_REACH = 5.5  # sigma: the kernel of kappa is cut at 4e-6 of its peak
_SAMPLES = 3.0  # minimum number of grid points per sigma: interpolation errs by 1e-5 at most
_BLOCK_ORDERS = 4  # deviates are sampled in blocks of 4^4 pixels
_BLOCKS = 640  # size of the cache: neighbouring cells and bricks share most blocks


class Kernels(NamedTuple):
    """Kernels deviate x exp(-u (1 - n . p)) about points p.

    points (m, 3); boxes (m, 4): TangentGrid.boxes of the points; deviates (m, shells); u: 1 / sigma^2; reach [rad]:
    radius at which kernels end.
    """

    points: FloatArray
    boxes: IntArray
    deviates: FloatArray
    u: float
    reach: float


class Width(NamedTuple):
    """A width of kernels: sigma [rad], and the HEALPix order of the pixels at whose centres they are."""

    order: int
    sigma: float


class Lensed(NamedTuple):
    """Convergence and shear (n,) of sources. The axes of the shear are east and north."""

    kappa: FloatArray
    gamma1: FloatArray
    gamma2: FloatArray


class PotentialField:
    """The potentials of one campaign seed. `amplitude` (shells, widths): set by the subclass before first use.

    shells: lens_spectra.Shells; lenses: number of shells, from the nearest, that lens; l_max: multipole up to which the
    spectra are fitted; name: of the random streams.
    """

    # Of the maps; a subclass may set others: radius of a kernel [sigma], grid points per sigma, type
    reach: float = _REACH
    samples: float = _SAMPLES
    precision: type[float | np.float32] = float
    amplitude: FloatArray

    def __init__(self, seed: int, shells: Shells, lenses: int, l_max: float, name: str) -> None:
        self.seed = seed
        self.shells = shells
        self.lenses = lenses
        self._name = name
        self.orders = int(np.ceil(np.log2(WIDTHS[-1] * pixel(0) * l_max / _FINEST)))
        self.widths = [Width(order, width * pixel(order)) for order in range(1, self.orders + 1) for width in WIDTHS]
        self.ell = np.unique(np.geomspace(2, l_max, 160).astype(int))  # at which spectra are fitted
        # The last brick and its maps, which galaxies and quasars share
        self._brick: tuple[int, tuple[TangentGrid, FloatArray]] | None = None
        self._block = lru_cache(maxsize=_BLOCKS)(self._sample_block)

    def powers(self, ell: FloatArray | IntArray) -> FloatArray:
        """Return C_l of kappa (len(ell), widths) for amplitude 1: deviates of variance 1 per pixel are white noise."""
        return np.stack([kernel_power(ell, sigma) / pixel(order) ** 2 for order, sigma in self.widths], axis=1)

    def lens(self, pix: int, ra: Floats, dec: Floats, z: Floats) -> Lensed:
        """Return the Lensed (float32) of sources in brick `pix`.

        ra, dec: deg, within 1 arcmin of the brick, else ValueError; z: redshift. Beyond z_max it counts as z_max; where
        it is zero, negative or NaN the values are 0.
        """
        ra = np.atleast_1d(np.asarray(ra, float))
        dec = np.atleast_1d(np.asarray(dec, float))
        z = np.atleast_1d(np.asarray(z, float))
        return Lensed(*(v.astype(np.float32) for v in self._interpolated(pix, ra, dec, self.shells.weights(z))))

    def _interpolated(self, pix: int, ra: FloatArray, dec: FloatArray, weights: FloatArray) -> Lensed:
        """Return the Lensed (float64) of the maps at positions in a brick; weights (n, shells)."""
        grid, values = self._grid_of(pix)
        kappa, gamma1, gamma2 = interpolate(values, grid.coordinates(ra, dec), weights[:, : self.lenses]).T
        return Lensed(kappa, *grid.to_east_north(ra, dec, gamma1, gamma2))

    def _grid_of(self, pix: int) -> tuple[TangentGrid, FloatArray]:
        """Return _brick_grid of a brick; that of the last one is cached."""
        if self._brick is None or self._brick[0] != pix:
            self._brick = pix, self._brick_grid(pix)
        return self._brick[1]

    def _brick_grid(self, pix: int) -> tuple[TangentGrid, FloatArray]:
        """Return the finest TangentGrid and its maps (rows, columns, 3, shells): kappa, gamma1, gamma2 in its frame."""
        grids = TangentGrid.pyramid(pix, self.widths[-1].sigma / self.samples)
        values = np.zeros((*grids[0].shape, 3, self.lenses), self.precision)
        added = 0
        for k, grid in enumerate(grids):
            if k:
                values = prolong(values, grids[k - 1], grid)
            while added < len(self.widths) and self.widths[added].sigma > 0.999 * self.samples * grid.step:
                self._add(values, grid, added)
                added += 1
        return grids[-1], values

    def _add(self, values: FloatArray, grid: TangentGrid, s: int) -> None:
        order, sigma = self.widths[s]
        reach = min(self.reach * sigma, np.pi)
        pixels, points = self.pixels(grid, order, reach)
        deviates = self.deviates(s, pixels)[:, : self.lenses] * self.amplitude[: self.lenses, s].astype(self.precision)
        kernels = Kernels(points, grid.boxes(points, reach), deviates, 1 / sigma**2, reach)
        self._splat(values, grid.frames, kernels)

    def _splat(self, values: FloatArray, frames: GridFrames, kernels: Kernels) -> None:
        splat(values, frames, kernels)

    def pixels(self, grid: TangentGrid, order: int, reach: float) -> tuple[IntArray, FloatArray]:
        """Return the HEALPix pixels (m,), rising, within `reach` [rad] of the grid, and their centres (m, 3)."""
        nside = 2**order
        disc_radius = min(grid.radius + reach, np.pi)
        pixels = disc(nside, grid.centre, disc_radius)
        return pixels, pixel_vector(nside, pixels)

    def deviates(self, s: int, pixels: IntArray) -> FloatArray:
        """Return the deviates (m, shells) of width s at `pixels`, in rising order."""
        bits = 2 * min(self.widths[s].order, _BLOCK_ORDERS)
        deviates = np.empty((len(pixels), self.shells.count), self.precision)
        blocks, start = np.unique(pixels >> bits, return_index=True)
        rows = pixels & ((1 << bits) - 1)
        for block, first, end in zip(blocks.tolist(), start, [*start[1:], len(pixels)], strict=True):
            deviates[first:end] = self._block(s, block)[rows[first:end]]
        return deviates

    def _sample_block(self, s: int, block: int) -> FloatArray:
        bits = 2 * min(self.widths[s].order, _BLOCK_ORDERS)
        return stream(self.seed, self._name, s, block).standard_normal((1 << bits, self.shells.count), self.precision)


def kernel_power(ell: FloatArray | IntArray, sigma: float) -> FloatArray:
    """Return C_l of kappa if the potential is noise of C_l = 1 convolved with exp((n.p - 1) / sigma^2)."""
    ell = np.asarray(ell, float)
    u = sigma**-2
    if u < 1e4:  # the Legendre transform 4 pi e^-u i_l(u) ...
        kernel = 4 * np.pi * np.sqrt(np.pi / (2 * u)) * ive(ell + 0.5, u)
    else:  # ... is a Gaussian for narrow kernels
        kernel = 2 * np.pi / u * np.exp(-ell * (ell + 1) / (2 * u))
    return (0.5 * ell * (ell + 1) * kernel) ** 2


def pixel(order: int) -> float:
    """Side of a HEALPix pixel [rad]."""
    return np.sqrt(4 * np.pi / 12) / 2**order


@njit(cache=True)
def splat(values: FloatArray, frames: GridFrames, kernels: Kernels) -> None:
    """Add kappa, gamma1, gamma2 of the potential of `kernels` to values (rows, columns, 3, shells)."""
    n = frames.direction
    t1 = frames.t1
    t2 = frames.t2
    u = kernels.u
    gap_max = 2 * np.sin(0.5 * kernels.reach) ** 2  # 1 - cos(reach)
    for j in range(len(kernels.points)):
        p = kernels.points[j]
        deviate = kernels.deviates[j]
        y0, y1, x0, x1 = kernels.boxes[j]
        for y in range(y0, y1):
            for x in range(x0, x1):
                # From p - n, because 1 - n . p of near directions loses digits.
                d0 = p[0] - n[y, x, 0]
                d1 = p[1] - n[y, x, 1]
                d2 = p[2] - n[y, x, 2]
                gap = 0.5 * (d0 * d0 + d1 * d1 + d2 * d2)
                if gap > gap_max:
                    continue
                a = d0 * t1[y, x, 0] + d1 * t1[y, x, 1] + d2 * t1[y, x, 2]
                b = d0 * t2[y, x, 0] + d1 * t2[y, x, 1] + d2 * t2[y, x, 2]
                kernel = u * np.exp(-u * gap)
                kappa = kernel * (0.5 * u * (a * a + b * b) - (1.0 - gap))
                gamma1 = 0.5 * u * kernel * (a * a - b * b)
                gamma2 = u * kernel * a * b
                maps = values[y, x]
                for i in range(len(deviate)):  # separate loops, because the compiler vectorises them
                    maps[0, i] += kappa * deviate[i]
                for i in range(len(deviate)):
                    maps[1, i] += gamma1 * deviate[i]
                for i in range(len(deviate)):
                    maps[2, i] += gamma2 * deviate[i]
