"""Shells of matter in front of the sources: convergence spectra and weights (Limber; Bartelmann & Schneider 2001).

    C_l(z_s) = int_0^chi_s dchi q^2 / chi^2 P((l + 1/2) / chi, chi),   q = 3/2 Om (H0/c)^2 (1 + z) chi (1 - chi / chi_s)

Shell i holds the matter between chi_i and chi_i+1. Its spectrum D_i is for sources at infinity, and its weight is
w_i(z_s)^2 = C_l,i(z_s) / D_i at l = 1000. So the power is exact at l = 1000 and close elsewhere; the weight grows from
zero where the source enters the shell. Convergences of two sources at different depth in a shell are fully correlated.
"""

import numpy as np

from csstsim.universe.lensing.power_spectrum import MatterPower

_PIVOT = np.array([1000.0])  # multipole of the weights
_NODES, _GAUSS = np.polynomial.legendre.leggauss(12)  # of the integral through a shell
_TABLE = 20  # source distances tabulated per shell


class Shells:
    """`cosmology`: cosmology.Cosmology; the numbers are the mappings of cosmology.yaml and lensing.yaml."""

    def __init__(self, cosmology, cosmology_numbers, lensing_numbers):
        self.cosmology, self.power = cosmology, MatterPower(cosmology, cosmology_numbers)
        self.count, self.z_max = lensing_numbers["shells"], lensing_numbers["z_max"]
        self._z = np.linspace(0.0, self.z_max, 4000)
        self._chi = cosmology.comoving_distance(self._z)
        self.edges = self._chi[-1] * np.linspace(0.0, 1.0, self.count + 1) ** 1.5  # finer near the observer
        self._sources = np.linspace(0.0, self.edges[-1], _TABLE * self.count + 1)
        parts = np.stack([self._pieces(_PIVOT, s)[:, 0] for s in self._sources])
        self._table = np.sqrt(parts / self.spectra(_PIVOT)[:, 0])

    def spectra(self, ell):
        """Return D_i (shells, len(ell)): the convergence spectra of the shells for sources at infinity."""
        return self._pieces(ell, np.inf)

    def limber(self, ell, z):
        """Return C_l of the convergence of sources at redshift z (float, 0 < z <= z_max), without shell weights."""
        return self._pieces(ell, float(self.cosmology.comoving_distance(z))).sum(axis=0)

    def weights(self, z):
        """Return w_i (len(z), shells) of source redshifts; constant beyond z_max, 0 where z <= 0 or NaN."""
        chi = self.cosmology.comoving_distance(np.clip(np.nan_to_num(z, nan=0.0), 0.0, self.z_max))
        return np.stack([np.interp(chi, self._sources, column) for column in self._table.T], axis=1)

    def _pieces(self, ell, source):
        """Return each shell's part of C_l (shells, len(ell)) for sources at the comoving distance `source` [Mpc]."""
        near, far = np.minimum(self.edges, source)[:-1, None], np.minimum(self.edges, source)[1:, None]
        chi = np.maximum(0.5 * (near + far) + 0.5 * (far - near) * _NODES, 1e-3)  # > 0 also for sources at 0
        z = np.interp(chi, self._chi, self._z)
        cosmology = self.cosmology
        kernel = 1.5 * cosmology.omega_m / cosmology.hubble_distance**2 * (1 + z)
        kernel = kernel * np.maximum(1 - chi / max(source, 1e-3), 0.0)
        power = self.power.nonlinear((ell + 0.5) / chi[..., None], z[..., None])
        return np.einsum("in,inl->il", 0.5 * (far - near) * _GAUSS * kernel**2, power)
