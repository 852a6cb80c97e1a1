"""Shells of matter in front of the sources: convergence spectra and weights (Limber; Bartelmann & Schneider 2001).

    C_l(z_s) = int_0^chi_s dchi q^2 / chi^2 P((l + 1/2) / chi, chi),   q = 3/2 Om (H0/c)^2 (1 + z) chi (1 - chi / chi_s)

Shell i holds the matter between chi_i and chi_i+1. Its spectrum D_i is for sources at infinity, and its weight is
w_i(z_s)^2 = C_l,i(z_s) / D_i at l = 1000. So the power is exact at l = 1000 and close elsewhere; the weight grows from
zero where the source enters the shell. Convergences of two sources at different depth in a shell are fully correlated.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from csstsim.base.types import FloatArray, IntArray

if TYPE_CHECKING:
    from csstsim.universe.lensing.cosmology import Cosmology
    from csstsim.universe.lensing.power_spectrum import MatterPower

_PIVOT_ELL = np.array([1000.0])  # multipole of the weights
_NODES, _GAUSS = np.polynomial.legendre.leggauss(12)  # of the integral through a shell


def even_edges(cosmology: Cosmology, z_max: float, count: int) -> FloatArray:
    """Return the edges [Mpc] of `count` shells to z_max, finer near the observer."""
    return cosmology.comoving_distance(z_max) * np.linspace(0.0, 1.0, count + 1) ** 1.5


class Shells:
    """Shells between comoving `edges` [Mpc], from 0 to the distance of z_end; power: power_spectrum.MatterPower.

    z_max: sources beyond it count as at z_max, so the shells between it and z_end do not lens. nodes: source distances
    per shell at which weights are computed; between them weights are linear in distance. Attributes: `sources` [Mpc],
    these distances, evenly spaced from 0, and `table` (sources, shells), their weights.
    """

    def __init__(
        self, power: MatterPower, edges: FloatArray, z_end: float, z_max: float | None = None, nodes: int = 20
    ) -> None:
        self.cosmology = power.cosmology
        self.power = power
        self.edges = edges
        self.count = len(edges) - 1
        self.z_max = z_end if z_max is None else z_max
        self._z = np.linspace(0.0, z_end, 4000)
        self._chi = self.cosmology.comoving_distance(self._z)
        last = float(self.cosmology.comoving_distance(self.z_max))
        self.sources = np.linspace(0.0, last, nodes * self.count + 1)
        spectra = np.stack([self._shell_spectra(_PIVOT_ELL, s)[:, 0] for s in self.sources])
        self.table = np.sqrt(spectra / self.spectra(_PIVOT_ELL)[:, 0])

    def spectra(self, ell: FloatArray | IntArray) -> FloatArray:
        """Return D_i (shells, len(ell)): the convergence spectra of the shells for sources at infinity."""
        return self._shell_spectra(ell, np.inf)

    def kernel(self) -> FloatArray:
        """Return K_i = int q dchi (shells,): the convergence of overdensity 1 for sources at infinity."""
        near = self.edges[:-1, None]
        far = self.edges[1:, None]
        chi = 0.5 * (near + far) + 0.5 * (far - near) * _NODES
        z = np.interp(chi, self._chi, self._z)
        return (0.5 * (far - near) * _GAUSS * self.strength(z) * chi).sum(axis=1)

    def strength(self, z: FloatArray) -> FloatArray:
        """Return q / chi [1 / Mpc^2] at redshift z for sources at infinity."""
        return 1.5 * self.cosmology.omega_m / self.cosmology.hubble_distance**2 * (1 + z)

    def limber(self, ell: FloatArray | IntArray, z: float) -> FloatArray:
        """Return C_l of the convergence of sources at redshift z (float, 0 < z <= z_max), without shell weights."""
        return self._shell_spectra(ell, float(self.cosmology.comoving_distance(z))).sum(axis=0)

    def weights(self, z: FloatArray) -> FloatArray:
        """Return w_i (len(z), shells) of source redshifts; constant beyond z_max, 0 where z <= 0 or NaN."""
        chi = self.source_distance(z)
        return np.stack([np.interp(chi, self.sources, column) for column in self.table.T], axis=1)

    def source_distance(self, z: FloatArray) -> FloatArray:
        """Return the distance [Mpc] of sources at z, that of z_max beyond it; 0 where z <= 0 or NaN."""
        return self.cosmology.comoving_distance(np.clip(np.nan_to_num(z, nan=0.0), 0.0, self.z_max))

    @property
    def distances(self) -> tuple[FloatArray, FloatArray]:
        """Tables of comoving distance [Mpc] and redshift."""
        return self._chi, self._z

    def _shell_spectra(self, ell: FloatArray | IntArray, source: float) -> FloatArray:
        """Return each shell's C_l (shells, len(ell)) for sources at the comoving distance `source` [Mpc]."""
        near = np.minimum(self.edges, source)[:-1, None]
        far = np.minimum(self.edges, source)[1:, None]
        chi = np.maximum(0.5 * (near + far) + 0.5 * (far - near) * _NODES, 1e-3)  # > 0 also for sources at 0
        z = np.interp(chi, self._chi, self._z)
        kernel = self.strength(z) * np.maximum(1 - chi / max(source, 1e-3), 0.0)
        power = self.power.nonlinear((ell + 0.5) / chi[..., None], z[..., None])
        return np.einsum("in,inl->il", 0.5 * (far - near) * _GAUSS * kernel**2, power)
