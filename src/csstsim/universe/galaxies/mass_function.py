"""Stellar mass functions of star-forming and quiescent galaxies, evolving with redshift.

    phi(M) = ln 10 exp(-x) (phi1 x^(1 + alpha1) + phi2 x^(1 + alpha2)),  x = M / M*      Mpc-3 dex-1

with the parameters published at some redshifts; ln phi is linear in z between them. Beyond z = 1 the published
parameters are corrected for errors of measured masses, so they give fewer massive galaxies than were counted. phi is
smoothed by `spread` [dex], the part of these errors that the counts require. Below `pivot`, the end of the published
counts, phi continues as a power law of slope `faint_slope(z)`. Masses are those of living stars and remnants, as log10
of solar masses.
"""

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np

from csstsim.base.types import FloatArray, Floats, IntArray
from csstsim.universe.lensing.cosmology import Cosmology

TYPES = ("star_forming", "quiescent")  # index = gal_type
_DLOGM = 0.05
_DX = 0.01  # of ln(1 + z)
_NODES, _WEIGHTS = np.polynomial.hermite_e.hermegauss(9)  # smoothing by 0.2 dex is exact to 0.3% at 1e11.5


def double_schechter(
    log_mass: Floats, log_mstar: float, phi1: float, alpha1: float, phi2: float, alpha2: float
) -> FloatArray:
    """Return phi [Mpc-3 dex-1] at log10 masses (array)."""
    x = 10 ** (np.asarray(log_mass, float) - log_mstar)
    return np.log(10) * np.exp(-x) * (phi1 * x ** (1 + alpha1) + phi2 * x ** (1 + alpha2))


def smoothed_schechter(
    log_mass: FloatArray, log_mstar: float, phi1: float, alpha1: float, phi2: float, alpha2: float, spread: float
) -> FloatArray:
    """Return double_schechter at log10 masses (n,), convolved with a Gaussian of `spread` [dex]."""
    if spread == 0:
        return double_schechter(log_mass, log_mstar, phi1, alpha1, phi2, alpha2)
    shifted = np.asarray(log_mass, float)[:, None] + spread * _NODES
    return double_schechter(shifted, log_mstar, phi1, alpha1, phi2, alpha2) @ _WEIGHTS / np.sqrt(2 * np.pi)


def mass_function(log_mass: FloatArray, z: float, kind: str, numbers: Mapping[str, Any], h0: float) -> FloatArray:
    """Return phi [Mpc-3 dex-1] at log_mass (n,) and one redshift, for h = h0 / 100 (published: numbers["h"]).

    kind: name in TYPES; numbers: the section `mass_function` of galaxies.yaml.
    """
    rescale = np.log10(h0 / 100.0 / numbers["h"])
    log_mass = np.asarray(log_mass, float) + 2 * rescale  # M ~ h^-2: the mass for the h of the published table
    table = np.asarray(numbers[kind], float)
    tabulated_mass = np.maximum(log_mass, numbers["pivot"])
    row_index = np.interp(z, table[:, 0], np.arange(len(table)))
    below = min(int(row_index), len(table) - 2)
    spread = np.interp(table[below : below + 2, 0], *np.transpose(np.asarray(numbers["spread"], float)))
    log_phis = [
        np.log(smoothed_schechter(tabulated_mass, *(*row[1:], s)) + 1e-300)
        for row, s in zip(table[below : below + 2], spread, strict=True)
    ]
    log_phi = log_phis[0] + (row_index - below) * (log_phis[1] - log_phis[0])
    slope = np.interp(z, *np.transpose(np.asarray(numbers["faint_slope"], float)))
    log_phi += (1 + slope) * np.log(10) * np.minimum(log_mass - numbers["pivot"], 0.0)
    return np.exp(log_phi) * 10 ** (3 * rescale)


class GalaxySample(NamedTuple):
    """Galaxies (n,): redshift, log10 of the stellar mass [solar], type (0 star-forming, 1 quiescent)."""

    z: FloatArray
    log_mass: FloatArray
    kind: IntArray


class MassGrid:
    """Galaxies per deg2 in cells of (type, z, log mass), for drawing samples.

    lightest: function of z (n,) that returns log10 of the minimum mass.
    """

    def __init__(
        self, numbers: Mapping[str, Any], cosmology: Cosmology, lightest: Callable[[FloatArray], FloatArray]
    ) -> None:
        self.cosmology = cosmology
        self.z = np.expm1(np.arange(0.0, np.log1p(numbers["z_max"]) + _DX, _DX))
        middle = 0.5 * (self.z[1:] + self.z[:-1])
        lightest_mass = np.floor(np.asarray(lightest(middle)) / _DLOGM) * _DLOGM
        self.log_mass = np.arange(lightest_mass.min(), numbers["log_mass_max"], _DLOGM)  # lower edges
        self.volume = cosmology.volume(self.z[:-1], self.z[1:])  # of each redshift step [Mpc3 per deg2]
        density = np.stack(
            [
                [mass_function(self.log_mass + _DLOGM / 2, z, kind, numbers, cosmology.h0) for z in middle]
                for kind in TYPES
            ]
        )
        density *= self.volume[:, None] * _DLOGM * (self.log_mass >= lightest_mass[:, None] - 1e-9)
        self.density = density  # (types, redshifts, masses), per deg2
        self._cumulative = np.cumsum(density.ravel())

    @property
    def step(self) -> float:
        """Width of a cell in log mass [dex]."""
        return _DLOGM

    @property
    def total(self) -> float:
        """Galaxies per deg2."""
        return self._cumulative[-1]

    def draw(self, generator: np.random.Generator, count: int) -> GalaxySample:
        """Return `count` galaxies."""
        cell = np.searchsorted(self._cumulative, generator.random(count) * self.total, side="right")
        return self.draw_in_cells(
            generator, *np.unravel_index(np.minimum(cell, self.density.size - 1), self.density.shape)
        )

    def draw_in_cells(
        self, generator: np.random.Generator, kind: IntArray, row: IntArray, column: IntArray
    ) -> GalaxySample:
        """Return galaxies in given cells (indices), uniform in volume and log mass within each."""
        cube = self.cosmology.comoving_distance(self.z) ** 3
        distance = np.cbrt(cube[row] + generator.random(len(row)) * (cube[row + 1] - cube[row]))
        z = np.linspace(0.0, self.z[-1], 20_001)  # linear between nodes: errs by 1e-6
        z = np.interp(distance, self.cosmology.comoving_distance(z), z)
        return GalaxySample(z, self.log_mass[column] + _DLOGM * generator.random(len(row)), kind.astype(np.int8))
