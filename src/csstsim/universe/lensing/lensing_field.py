"""A Gaussian convergence and shear field on the whole sky; any brick can be computed on its own.

Matter between z = 0 and z_max lies in shells, each with its own random potential psi_i, and

    kappa(n, z_s) = sum_i w_i(z_s) kappa_i(n),   kappa_i = 1/2 laplacian psi_i,
    gamma1 = 1/2 (psi_EE - psi_NN),  gamma2 = psi_EN        (E east, N north on the sphere; Born approximation)

    psi_i(n) = sum_s a_is sum_p x_isp exp(-(1 - n . p) / sigma_s^2)

The x are independent normal deviates at the centres p of HEALPix pixels finer than sigma_s. The kernels are local, so a
brick needs only the deviates around it. They are differentiated in closed form, so the shear matches the convergence
exactly (no B mode), also at the poles. The widths run in steps of sqrt(2) from 40 deg to 0.3 arcmin; a_is is fitted
such that kappa_i has the shell's Limber spectrum of halofit. Values at galaxies are interpolated on a tangent grid.
Left out: everything beyond the two-point function (haloes, skewness), deflection, lens-lens coupling, rotation.
"""

import numpy as np
from numba import njit
from scipy.optimize import nnls
from scipy.special import ive

from csstsim.base.rng import stream
from csstsim.universe.lensing.cosmology import Cosmology
from csstsim.universe.lensing.lens_spectra import Shells
from csstsim.universe.lensing.tangent_grid import TangentGrid, interpolate, prolong

_FINEST = 1.65  # l_max x sigma of the narrowest kernel: its half power lies at l_max x 1.35
_WIDTHS = (1.3 * np.sqrt(2), 1.3)  # sigma in pixels; at 1.3 they change the local variance by 0.3 % at most
_REACH = 5.5  # sigma: the kernel of kappa is cut at 4e-6 of its peak
_SAMPLES = 3.0  # grid points per sigma, at least: interpolation errs by 1e-5 at most
_BLOCK_ORDERS = 4  # deviates are drawn in blocks of 4^4 pixels


class LensingField:
    """The lensing field of one campaign seed.

    cosmology_numbers, lensing_numbers: the mappings of config/universe/cosmology.yaml and lensing.yaml. Raises
    KeyError or ValueError for a number that is missing or out of range.
    """

    def __init__(self, seed, cosmology_numbers, lensing_numbers):
        z_max, shells, l_max = (lensing_numbers[name] for name in ("z_max", "shells", "l_max"))
        if not (0 < z_max <= 20 and 1 <= shells <= 100 and 50 <= l_max <= 40000):
            raise ValueError("lensing: needs 0 < z_max <= 20, 1 <= shells <= 100 and 50 <= l_max <= 40000")
        self.seed = seed
        self.shells = Shells(Cosmology(cosmology_numbers), cosmology_numbers, lensing_numbers)
        finest = int(np.ceil(np.log2(_WIDTHS[-1] * _pixel(0) * l_max / _FINEST)))
        self._sigma = [(order, width * _pixel(order)) for order in range(1, finest + 1) for width in _WIDTHS]
        ell = np.unique(np.geomspace(2, l_max, 160).astype(int))
        powers, ones = self._powers(ell), np.ones(len(ell))
        fits = [nnls(powers / wanted[:, None], ones)[0] for wanted in self.shells.spectra(ell)]
        self.amplitude = np.sqrt(fits)  # (shells, widths)
        self._brick = None, None  # the last brick and its maps: galaxies and quasars use the same

    def spectrum(self, ell, z):
        """Return the C_l of kappa from which the field is drawn, for sources at redshift z (float)."""
        weights = self.shells.weights(np.array([z]))[0]
        return np.einsum("i,is,ls->l", weights**2, self.amplitude**2, self._powers(ell))

    def _powers(self, ell):
        """Return C_l of kappa (len(ell), widths) for amplitude 1: deviates of variance 1 per pixel are white noise."""
        return np.stack([kernel_power(ell, sigma) / _pixel(order) ** 2 for order, sigma in self._sigma], axis=1)

    def lens(self, pix, ra, dec, z):
        """Return kappa, gamma1, gamma2 (float32, each (n,)) of sources in brick `pix`.

        ra, dec: deg, within 1 arcmin of the brick, else ValueError; z: redshift; beyond z_max it counts as z_max, and
        where it is zero, negative or NaN the values are 0. Axes: east, north.
        """
        ra, dec, z = (np.atleast_1d(np.asarray(v, float)) for v in (ra, dec, z))
        if self._brick[0] != pix:
            self._brick = pix, self._brick_grid(pix)
        grid, values = self._brick[1]
        kappa, gamma1, gamma2 = interpolate(values, grid.cells(ra, dec), self.shells.weights(z)).T
        gamma1, gamma2 = grid.to_east_north(ra, dec, gamma1, gamma2)
        return tuple(v.astype(np.float32) for v in (kappa, gamma1, gamma2))

    def _brick_grid(self, pix):
        """Return the finest TangentGrid and its maps (rows, columns, 3, shells): kappa, gamma1, gamma2 in its frame."""
        grids = TangentGrid.pyramid(pix, self._sigma[-1][1] / _SAMPLES)
        values, done = np.zeros((*grids[0].shape, 3, self.shells.count)), 0
        for k, grid in enumerate(grids):
            if k:
                values = prolong(values, grids[k - 1], grid)
            while done < len(self._sigma) and self._sigma[done][1] > 0.999 * _SAMPLES * grid.step:
                self._add(values, grid, done)
                done += 1
        return grids[-1], values

    def _add(self, values, grid, s):
        order, sigma = self._sigma[s]
        reach = min(_REACH * sigma, np.pi)
        points, deviates = self._deviates(grid, s, order, reach)
        deviates = deviates * self.amplitude[:, s]
        splat(values, *grid.frames, points, grid.boxes(points, reach), deviates, 1 / sigma**2, reach)

    def _deviates(self, grid, s, order, reach):
        """Return the pixel centres (m, 3) within `reach` of the grid and their deviates (m, shells)."""
        import healpy

        nside, shells = 2**order, self.shells.count
        wide = min(grid.radius + reach, np.pi)
        pixels = np.sort(healpy.query_disc(nside, grid.centre, wide, nest=True))
        bits = 2 * min(order, _BLOCK_ORDERS)
        deviates = np.empty((len(pixels), shells))
        blocks, start = np.unique(pixels >> bits, return_index=True)
        for block, rows in zip(blocks, np.split(np.arange(len(pixels)), start[1:]), strict=True):
            drawn = stream(self.seed, "lensing", s, block).standard_normal((1 << bits, shells))
            deviates[rows] = drawn[pixels[rows] & ((1 << bits) - 1)]
        return np.stack(healpy.pix2vec(nside, pixels, nest=True), axis=1), deviates


def kernel_power(ell, sigma):
    """Return C_l of kappa if the potential is noise of C_l = 1 convolved with exp((n.p - 1) / sigma^2)."""
    ell, u = np.asarray(ell, float), sigma**-2
    if u < 1e4:  # the Legendre transform 4 pi e^-u i_l(u) ...
        kernel = 4 * np.pi * np.sqrt(np.pi / (2 * u)) * ive(ell + 0.5, u)
    else:  # ... is a Gaussian for narrow kernels
        kernel = 2 * np.pi / u * np.exp(-ell * (ell + 1) / (2 * u))
    return (0.5 * ell * (ell + 1) * kernel) ** 2


def _pixel(order):
    """Side of a HEALPix pixel [rad]."""
    return np.sqrt(4 * np.pi / 12) / 2**order


@njit(cache=True)
def splat(values, n, t1, t2, points, boxes, deviates, u, reach):
    """Add kappa, gamma1, gamma2 of psi = deviate exp(-u (1 - n . p)) of every point p to values.

    values: (rows, columns, 3, shells); n, t1, t2: direction and tangent frame of each grid point (rows, columns, 3);
    points (m, 3), deviates (m, shells); boxes: TangentGrid.boxes of the points and `reach` [rad], where kernels end.
    """
    far = 2 * np.sin(0.5 * reach) ** 2  # 1 - cos(reach)
    for j in range(len(points)):
        p = points[j]
        for y in range(boxes[j, 0], boxes[j, 1]):
            for x in range(boxes[j, 2], boxes[j, 3]):
                # From p - n, because 1 - n . p of near directions loses digits.
                d0, d1, d2 = p[0] - n[y, x, 0], p[1] - n[y, x, 1], p[2] - n[y, x, 2]
                gap = 0.5 * (d0 * d0 + d1 * d1 + d2 * d2)
                if gap > far:
                    continue
                a = d0 * t1[y, x, 0] + d1 * t1[y, x, 1] + d2 * t1[y, x, 2]
                b = d0 * t2[y, x, 0] + d1 * t2[y, x, 1] + d2 * t2[y, x, 2]
                kernel = u * np.exp(-u * gap)
                kappa = kernel * (0.5 * u * (a * a + b * b) - (1.0 - gap))
                gamma1, gamma2 = 0.5 * u * kernel * (a * a - b * b), u * kernel * a * b
                for i in range(deviates.shape[1]):
                    values[y, x, 0, i] += kappa * deviates[j, i]
                    values[y, x, 1, i] += gamma1 * deviates[j, i]
                    values[y, x, 2, i] += gamma2 * deviates[j, i]
