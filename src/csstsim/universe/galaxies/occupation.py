"""The haloes of galaxies: rank matching of stellar masses to haloes and subhaloes, and fractions of types.

At each redshift the number of galaxies above a stellar mass M* is that of haloes and subhaloes above a proxy x
(universe.galaxies.subhaloes). This gives M* = F(x, z), and mass functions that are exact for any haloes. Only haloes
above a minimum mass are drawn one by one. The remainder, galaxies of other haloes, follows the smooth density. A
satellite's probability of being quiescent is raised by its halo (Peng et al. 2010, ApJ 721, 193) and that of a central
is lowered, so both mass functions by type are exact, too:

    q_sat = f + (1 - f) eps(M_h, z),     q_cen = f - S / (1 - S) (1 - f) mean(eps)

with f the quiescent fraction and S the fraction of satellites at (M*, z). Where q_cen would be negative, eps is reduced
until it is zero. Rows are the redshift steps of the MassGrid, columns its masses. Left out: assembly bias,
conformity.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from csstsim.base.types import FloatArray, Floats
from csstsim.universe.galaxies.subhaloes import (
    STEP,
    host_masses,
    proxies,
    proxy_above,
    satellite_counts,
    scatter_in_proxy,
    surviving_fraction,
)

if TYPE_CHECKING:
    from csstsim.universe.galaxies.mass_function import MassGrid
    from csstsim.universe.structure.mass_function import HaloMassFunction


class _Counts(NamedTuple):
    """Galaxies (rows, columns) per deg2: centrals, satellites, and satellites times the eps of their haloes."""

    central: FloatArray
    satellite: FloatArray
    quenched: FloatArray


class Occupation:
    """Tables of galaxies in haloes. Raises KeyError or ValueError for a number that is missing or out of range.

    numbers: occupation.yaml; drawn: limits (minimum log10 mass, minimum z, maximum z) of haloes that are drawn one by
    one, or None if none are.
    """

    def __init__(
        self,
        numbers: Mapping[str, Any],
        grid: MassGrid,
        haloes: HaloMassFunction,
        drawn: tuple[float, float, float] | None = None,
    ) -> None:
        self.numbers = numbers
        self.grid = grid
        self.mass = host_masses()
        self.proxies = proxies()
        self.central = proxy_above(numbers)
        self.satellite = satellite_counts(numbers, self.central)
        self.scatter = scatter_in_proxy(self.mass, numbers["stellar_to_halo"])
        z = 0.5 * (grid.z[1:] + grid.z[:-1])
        self.surviving = surviving_fraction(self.mass, z[:, None], numbers["surviving"])
        host = 10.0**self.mass
        density = STEP * np.log(10) * haloes.dn_dlnm(host, z[:, None]) * grid.volume[:, None]  # per deg2, row, bin
        self._bias = haloes.bias(host, z[:, None])
        self.eps = quenching(self.mass, z[:, None], numbers["quenching"])
        self._density, self._drawn = density, density * self._drawn_fractions(drawn)
        self._match()
        self._types()

    def _drawn_fractions(self, drawn: tuple[float, float, float] | None) -> FloatArray:
        """Return (rows, H): the fraction of haloes that are drawn."""
        if drawn is None:
            return np.zeros((len(self.grid.volume), len(self.mass)))
        log_mass_min, z_min, z_max = drawn
        volume = self.grid.cosmology.volume
        z = np.clip(self.grid.z, z_min, z_max)
        rows = volume(z[:-1], z[1:]) / self.grid.volume
        return rows[:, None] * np.clip((self.mass - log_mass_min) / STEP + 0.5, 0.0, 1.0)

    def _counts(self, haloes: FloatArray, eps: Floats = 1.0) -> tuple[FloatArray, FloatArray]:
        """Return the centrals above each proxy, and the satellites times eps, each (rows, X), of haloes (rows, H)."""
        return haloes @ self.central, (haloes * eps * self.surviving) @ self.satellite

    def _match(self) -> None:
        """Set F as `log_mass` (rows, X), and the proxies of the lightest galaxy (rows,) and of the columns' edges."""
        galaxies = self.grid.density.sum(axis=0)
        above = np.concatenate([np.cumsum(galaxies[:, ::-1], axis=1)[:, ::-1], np.zeros((len(galaxies), 1))], axis=1)
        edges = np.append(self.grid.log_mass, self.grid.log_mass[-1] + self.grid.step)
        central, satellite = self._counts(self._density)
        total = central + satellite
        self.log_mass = np.empty(total.shape)
        self._edge = np.empty(above.shape)  # proxy of each column's lower edge
        for row, (galaxies_above, haloes_above) in enumerate(zip(above, total, strict=True)):
            lightest_mass = (
                edges[np.flatnonzero(galaxies_above < galaxies_above[0])[0] - 1] if galaxies_above[0] else edges[-1]
            )
            self.log_mass[row] = np.maximum(np.interp(haloes_above, galaxies_above[::-1], edges[::-1]), lightest_mass)
            self._edge[row] = np.interp(galaxies_above, haloes_above[::-1], self.proxies[::-1])
        self.lightest_proxy = self._edge.min(axis=1)

    def _in_columns(self, counts: FloatArray) -> FloatArray:
        """Return (rows, columns) of the MassGrid: differences of cumulative numbers (rows, X) at the columns' edges."""
        at = np.stack([np.interp(edge, self.proxies, row) for edge, row in zip(self._edge, counts, strict=True)])
        return at[:, :-1] - at[:, 1:]

    def _by_column(self, haloes: FloatArray) -> _Counts:
        """Return the galaxies in the columns of the MassGrid of haloes (rows, H)."""
        central, satellite = self._counts(haloes)
        _, quenched = self._counts(haloes, self.eps)
        return _Counts(self._in_columns(central), self._in_columns(satellite), self._in_columns(quenched))

    def _types(self) -> None:
        star_forming, quiescent = self.grid.density
        total = star_forming + quiescent
        f = np.divide(quiescent, total, out=np.zeros(total.shape), where=total > 0)
        central, satellite, quenched = self._by_column(self._density)
        ratio = np.divide(satellite, central, out=np.zeros(f.shape), where=central > 0)  # S / (1 - S)
        self.satellite_fraction = ratio / (1 + ratio)
        mean = np.divide(quenched, central, out=np.zeros(f.shape), where=central > 0)  # S / (1 - S) mean(eps)
        raised = (1 - f) * mean
        self.scale = np.divide(f, raised, out=np.ones(f.shape), where=raised > f)
        self.quiescent, self.quiescent_central = f, np.maximum(f - self.scale * raised, 0.0)  # -1e-17: rounding
        central, satellite, quenched = self._by_column(self._drawn)
        red = self.quiescent_central * central + f * satellite + (1 - f) * self.scale * quenched
        self.in_drawn = np.stack([central + satellite - red, red])

    @cached_property
    def remainder(self) -> FloatArray:
        """Galaxies per deg2 (types, rows, columns) in haloes that are not drawn."""
        return np.maximum(self.grid.density - self.in_drawn, 0.0)

    @cached_property
    def bias(self) -> FloatArray:
        """Mean bias (rows,) of the haloes of the remainder's galaxies; 1 where there are none."""
        rest = self._density - self._drawn
        number = self._hosted(rest)
        return np.divide(self._hosted(rest * self._bias), number, out=np.ones(len(number)), where=number > 0)

    def _hosted(self, haloes: FloatArray) -> FloatArray:
        """Return the number of galaxies (rows,) of haloes (rows, H)."""
        central, satellite = self._counts(haloes)
        above = zip(self.lightest_proxy, central + satellite, strict=True)
        return np.array([np.interp(x, self.proxies, row) for x, row in above])


def quenching(log_mass: Floats, z: Floats, numbers: Mapping[str, Any]) -> FloatArray:
    """Return eps: the fraction of otherwise star-forming satellites that a halo of this log10 mass has quenched."""
    eps = numbers["at_1e12"] + numbers["slope"] * (np.asarray(log_mass, float) - 12.0)
    return np.clip(eps * (1 + np.asarray(z, float)) ** numbers["growth"], 0.0, numbers["most"])
