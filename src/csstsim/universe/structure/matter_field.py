"""Matter of the embedded universe: a smooth Gaussian field in shells, and haloes on it; lensing and clustering by both.

    kappa(n, z_s) = sum_i w_i(z_s) kappa_i(n) + sum_haloes kappa_h(n, z_s)          (Born approximation)

The shells are about 150 Mpc deep. Their smooth part is fitted such that it and the haloes together have the Limber
spectrum of halofit (halo_spectra); without haloes it has that spectrum alone. The same maps are the density that
haloes and galaxies follow (density), and the tidal field that aligns galaxies.
Left out: deflection of positions, lens-lens coupling, rotation, baryons, structure in depth within a shell.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.optimize import nnls

from csstsim.base.types import BoolArray, FloatArray, Floats, IntArray
from csstsim.universe.lensing.cosmology import Cosmology
from csstsim.universe.lensing.lens_spectra import Shells
from csstsim.universe.lensing.potential_field import Lensed, PotentialField
from csstsim.universe.lensing.power_spectrum import MatterPower
from csstsim.universe.structure.density import ShellDensity, kernel_order
from csstsim.universe.structure.halo_lensing import HaloLenses, halo_lenses, halo_shear
from csstsim.universe.structure.halo_profile import disc_radius
from csstsim.universe.structure.halo_spectra import HaloSpectra
from csstsim.universe.structure.haloes import Haloes, tier_orders
from csstsim.universe.structure.kernels import add_lensing
from csstsim.universe.structure.mass_function import HaloMassFunction
from csstsim.universe.structure.source_maps import add_shells, interpolate_depth

if TYPE_CHECKING:
    from csstsim.universe.lensing.potential_field import Kernels
    from csstsim.universe.lensing.tangent_grid import GridFrames, TangentGrid

_NODES = 2  # source distances per shell at which weights are computed
_MARGIN = 1e-6  # rad, of rounding
_MISFIT = 0.05  # maximum relative error of the spectrum of matter


class MatterField(PotentialField):
    """The matter of one campaign seed.

    cosmology_numbers, lensing_numbers, numbers: the mappings of cosmology.yaml, lensing.yaml and structure.yaml in
    config/universe; haloes: False for the smooth field alone. Attributes: `haloes` (haloes.Haloes, or None) and
    `mass_function`. Raises KeyError or ValueError for a number that is missing or out of range.
    """

    # Of the smooth maps, which err by 1e-3 of the narrowest kernel
    reach = 5.0
    samples = 2.7
    precision = np.float32

    def __init__(
        self,
        seed: int,
        cosmology_numbers: Mapping[str, Any],
        lensing_numbers: Mapping[str, Any],
        numbers: Mapping[str, Any],
        haloes: bool = True,
    ) -> None:
        check_numbers(lensing_numbers, numbers)
        self.numbers = numbers
        cosmology = Cosmology(cosmology_numbers)
        power = MatterPower(cosmology, cosmology_numbers)
        z_end = numbers["shells"]["z_end"]
        z_max = lensing_numbers["z_max"]
        chi_end = float(cosmology.comoving_distance(z_end))
        edges = np.linspace(0.0, chi_end, int(np.ceil(chi_end / numbers["shells"]["thickness"])) + 1)
        lenses = int(np.searchsorted(edges, float(cosmology.comoving_distance(z_max))))
        shells = Shells(power, edges, z_end, z_max, nodes=_NODES)
        super().__init__(seed, shells, lenses, lensing_numbers["l_max"], "structure" if haloes else "structure field")
        self.mass_function = HaloMassFunction(cosmology, power)
        wanted = shells.spectra(self.ell)
        self.spectra = HaloSpectra(self, self.mass_function, numbers) if haloes else None
        if self.spectra is not None:
            self.amplitude = self.spectra.fit(self.ell, wanted)
        else:
            self.amplitude = np.sqrt([nnls(self.powers(self.ell) / w[:, None], np.ones(len(w)))[0] for w in wanted])
        self._refuse_misfit(lensing_numbers)
        self._source_maps = lru_cache(maxsize=1)(self._make_source_maps)  # galaxies and quasars share them
        self.lens_haloes = lru_cache(maxsize=1)(self._lens_haloes)
        self._galaxy_order = kernel_order(self, numbers["galaxy_scale"])
        tiers = tier_orders(self, self.mass_function, numbers)
        self.shell_density = ShellDensity(
            self,
            np.maximum(self._galaxy_order, tiers.max(axis=0)),
            1.0 if self.spectra is None else self.spectra.weights,
        )
        self._variance = self.shell_density.variance(self._galaxy_order)
        self.haloes = Haloes(seed, self.shell_density, self.mass_function, numbers) if haloes else None

    def _refuse_misfit(self, lensing: Mapping[str, Any]) -> None:
        """Raise ValueError if the matter cannot have halofit's spectrum: in thin shells haloes alone exceed it."""
        ell = np.geomspace(30, lensing["l_max"], 12)
        z = lensing["z_max"]
        misfit = np.abs(self.spectrum(ell, z) / self.shells.limber(ell, z) - 1).max()
        if misfit > _MISFIT:
            raise ValueError(
                f"structure: the spectrum of matter is {misfit:.0%} off halofit's at z = {z:g}; "
                "it needs shells.thickness of 80 or more, and omega_m of 0.2 or more"
            )

    def lens(self, pix: int, ra: Floats, dec: Floats, z: Floats) -> Lensed:
        """Return the Lensed (float32) of sources in brick `pix`, as PotentialField.lens."""
        ra = np.atleast_1d(np.asarray(ra, float))
        dec = np.atleast_1d(np.asarray(dec, float))
        z = np.atleast_1d(np.asarray(z, float))
        chi = self.shells.source_distance(z)
        grid, maps = self._source_maps(pix)
        kappa, gamma1, gamma2 = interpolate_depth(maps, grid.coordinates(ra, dec), chi / self.shells.sources[1]).T
        total = np.stack([kappa, *grid.to_east_north(ra, dec, gamma1, gamma2)])
        if self.haloes is not None:
            total += halo_shear(self.lens_haloes(pix), ra, dec, chi)
        return Lensed(*total.astype(np.float32))

    def _make_source_maps(self, pix: int) -> tuple[TangentGrid, FloatArray]:
        """Return a brick's grid and smooth maps (rows, columns, distances, 3) for sources at shells.sources."""
        grid, values = self._grid_of(pix)
        return grid, add_shells(values, self.shells.table[:, : self.lenses].T.astype(np.float32))

    def _splat(self, values: FloatArray, frames: GridFrames, kernels: Kernels) -> None:
        add_lensing(values, frames, kernels)

    def _lens_haloes(self, pix: int) -> HaloLenses:
        """Return the haloes that lens sources in brick `pix`."""
        assert self.haloes is not None  # `lens` asks for them
        numbers = self.numbers["haloes"]
        return halo_lenses(
            self.haloes.near(pix, self.disc_angle, np.log10(numbers["lens_mass"])), self.mass_function, numbers
        )

    def disc_angle(self, z: Floats, log_mass: FloatArray) -> FloatArray:
        """Return the angle [rad] beyond which a halo does not lens."""
        radius = disc_radius(self.mass_function, 10.0**log_mass, self.numbers["haloes"])
        return 2 * np.arcsin(np.minimum(0.5 * radius / self.shells.cosmology.comoving_distance(z), 1.0)) + _MARGIN

    def density(self, ra: Floats, dec: Floats, z: Floats) -> tuple[FloatArray, FloatArray]:
        """Return delta, the smoothed overdensity of each position's shell, and its variance, each (n,).

        Galaxies of bias b that follow it have the intensity exp(b delta - b^2 variance / 2), of mean 1. Beyond the last
        shell, and where z is negative or NaN, both are 0.
        """
        ra = np.atleast_1d(np.asarray(ra, float))
        dec = np.atleast_1d(np.asarray(dec, float))
        z = np.atleast_1d(np.asarray(z, float))
        shell, valid = self._shell(z)
        delta = np.zeros(len(z))
        variance = np.where(valid, self._variance[shell], 0.0)
        delta[valid] = self.shell_density.at(ra[valid], dec[valid], shell[valid], self._galaxy_order)
        return delta, variance

    def tidal(self, pix: int, ra: Floats, dec: Floats, z: Floats) -> tuple[FloatArray, FloatArray]:
        """Return the two components (each (n,)) of the projected tidal field of each position's shell in brick `pix`.

        In Fourier space it is delta (l_E^2 - l_N^2, 2 l_E l_N) / l^2, as shear is to convergence, with axes east and
        north and the finest kernels of the field (0.3 arcmin). Linear alignment gives galaxies a shear of
        -A C1 rho / D times it. It is 0 beyond the shells that lens.
        """
        ra = np.atleast_1d(np.asarray(ra, float))
        dec = np.atleast_1d(np.asarray(dec, float))
        z = np.atleast_1d(np.asarray(z, float))
        shell, valid = self._shell(z)
        valid &= shell < self.lenses
        weights = np.zeros((len(z), self.lenses))
        weights[np.flatnonzero(valid), shell[valid]] = 1 / self.shells.kernel()[shell[valid]]
        return self._interpolated(pix, ra, dec, weights)[1:]

    def _shell(self, z: FloatArray) -> tuple[IntArray, BoolArray]:
        """Return the shell of each redshift (n,), and whether there is one."""
        chi = self.shells.cosmology.comoving_distance(np.nan_to_num(z, nan=-1.0).clip(0.0, 1000.0))
        valid = (z > 0) & (chi < self.shells.edges[-1])
        return np.clip(np.searchsorted(self.shells.edges, chi, side="right") - 1, 0, self.shells.count - 1), valid

    def spectrum(self, ell: FloatArray | IntArray, z: float) -> FloatArray:
        """Return the C_l of kappa of the maps, smooth part and haloes, for sources at redshift z."""
        weights = self.shells.weights(np.array([z]))[0] ** 2
        if self.spectra is None:
            return np.einsum("i,is,ls->l", weights, self.amplitude**2, self.powers(ell))
        parts = np.einsum("is,ils->il", self.amplitude**2, self.powers(ell) * self.spectra.factors(ell))
        return weights @ (parts + self.spectra.one_halo(ell) + self.spectra.lognormal(ell, self.amplitude))


def check_numbers(lensing: Mapping[str, Any], numbers: Mapping[str, Any]) -> None:
    """Raise ValueError for invalid numbers of lensing.yaml and structure.yaml."""
    haloes = numbers["haloes"]
    shells = numbers["shells"]
    tiers = haloes["tiers"]
    if not (0 < lensing["z_max"] <= shells["z_end"] <= 20 and 50 <= lensing["l_max"] <= 40000):
        raise ValueError("lensing: needs 0 < z_max <= structure.shells.z_end <= 20 and 50 <= l_max <= 40000")
    if not (20 <= shells["thickness"] <= 600 and 0.2 <= numbers["galaxy_scale"] <= 20):
        raise ValueError("structure: needs 20 <= shells.thickness <= 600 and 0.2 <= galaxy_scale <= 20")
    if not (0.02 <= haloes["z_min"] < haloes["z_max"] <= shells["z_end"]):
        raise ValueError("structure: needs 0.02 <= haloes.z_min < haloes.z_max <= shells.z_end")
    if not (1 < len(tiers) <= 9 and tiers[0] >= 1e9 and tiers[-1] <= 1e16 and (np.diff(tiers) > 0).all()):
        raise ValueError("structure: needs 2 to 9 rising haloes.tiers between 1e9 and 1e16")
    if haloes["lens_mass"] not in tiers[:-1]:
        raise ValueError("structure: haloes.lens_mass is the lower mass of a tier")
    placement = np.atleast_1d(haloes["placement"])
    if not (len(placement) == len(tiers) - 1 and min(placement) >= 0.2 and max(placement) <= 3):
        raise ValueError("structure: haloes.placement needs a number from 0.2 to 3 for each tier")
    if not 0.5 <= haloes["finest"] <= 60:
        raise ValueError("structure: haloes.finest needs 0.5 to 60 arcmin")
    cuts = haloes["cuts"]
    if not (1 <= len(cuts) <= 4 and min(cuts) >= 0.2 and max(cuts) <= 2.5):  # within the smallest disc, of 2.9
        raise ValueError("structure: haloes.cuts needs 1 to 4 numbers from 0.2 to 2.5")
    mass = np.atleast_1d(haloes["compensation"]["mass"])
    ratio = np.atleast_1d(haloes["compensation"]["ratio"])
    if not (len(mass) == len(ratio) and (np.diff(mass) > 0).all() and mass[0] > 0):
        raise ValueError("structure: haloes.compensation needs rising masses, and as many ratios")
    if not (min(ratio) >= 0.5 and max(ratio) <= 5):
        raise ValueError("structure: haloes.compensation.ratio needs numbers from 0.5 to 5")
