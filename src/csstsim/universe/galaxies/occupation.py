"""In which haloes galaxies live: rank matching of stellar masses to haloes and subhaloes, fractions of types.

At each redshift the number of galaxies above a stellar mass M* is that of haloes and subhaloes above a proxy x
(universe.galaxies.subhaloes), which gives M* = F(x, z): the mass functions stay exact whatever the haloes are. Only
haloes above some mass are drawn, one by one; R(M*, z), the fraction of galaxies that live in these, leaves a remainder
that follows the smooth density. A satellite's chance to be quiescent is raised by its halo (Peng et al. 2010,
ApJ 721, 193) and a central's lowered, so that both mass functions by type stay exact, too:

    q_sat = f + (1 - f) eps(M_h, z),     q_cen = f - S / (1 - S) (1 - f) mean(eps)

with f the quiescent fraction and S the fraction of satellites at (M*, z). Where q_cen would be negative, eps is scaled
down to make it zero. Rows are the redshift steps of the MassGrid, columns its masses. Left out: assembly bias,
conformity.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from csstsim.base.types import FloatArray, Floats
from csstsim.universe.galaxies.subhaloes import (
    STEP,
    host_masses,
    proxies,
    proxy_above,
    satellite_counts,
    scatter_in_proxy,
    surviving,
)

if TYPE_CHECKING:
    from csstsim.universe.galaxies.mass_function import MassGrid
    from csstsim.universe.structure.mass_function import HaloMassFunction


class Occupation:
    """Tables of galaxies in haloes. Raises KeyError or ValueError for a number that is missing or out of range.

    numbers: occupation.yaml; grid: mass_function.MassGrid; haloes: structure.mass_function.HaloMassFunction; drawn:
    (minimum log10 mass, minimum z, maximum z) of haloes that are drawn one by one, or None if none is.
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
        self.surviving = surviving(self.mass, z[:, None], numbers["surviving"])
        host = 10.0**self.mass
        density = STEP * np.log(10) * haloes.dn_dlnm(host, z[:, None]) * grid.volume[:, None]  # per deg2, row, bin
        self._bias = haloes.bias(host, z[:, None])
        self.eps = quenching(self.mass, z[:, None], numbers["quenching"])
        self._density, self._drawn = density, density * self._shares(drawn)
        self._match()
        self._types()

    def _shares(self, drawn: tuple[float, float, float] | None) -> FloatArray:
        """Return (rows, H): the fraction of haloes that are drawn."""
        if drawn is None:
            return np.zeros((len(self.grid.volume), len(self.mass)))
        least, near, far = drawn
        volume = self.grid.cosmology.volume
        inside = np.clip(self.grid.z, near, far)
        rows = volume(inside[:-1], inside[1:]) / self.grid.volume
        return rows[:, None] * np.clip((self.mass - least) / STEP + 0.5, 0.0, 1.0)

    def _counts(self, haloes: FloatArray, eps: Floats = 1.0) -> tuple[FloatArray, FloatArray]:
        """Return (rows, X) centrals, and satellites weighted with eps, above each proxy, of haloes (rows, H)."""
        return haloes @ self.central, (haloes * eps * self.surviving) @ self.satellite

    def _match(self) -> None:
        """F as `log_mass` (rows, X), `least` (rows,), the proxy of the lightest galaxy, and of each column's edge."""
        galaxies = self.grid.density.sum(axis=0)
        above = np.concatenate([np.cumsum(galaxies[:, ::-1], axis=1)[:, ::-1], np.zeros((len(galaxies), 1))], axis=1)
        edges = np.append(self.grid.log_mass, self.grid.log_mass[-1] + self.grid.step)
        central, satellite = self._counts(self._density)
        total = central + satellite
        self.log_mass = np.empty(total.shape)
        self._edge = np.empty(above.shape)  # proxy of each column's lower edge
        for row, (n_galaxies, n_haloes) in enumerate(zip(above, total, strict=True)):
            floor = edges[np.flatnonzero(n_galaxies < n_galaxies[0])[0] - 1] if n_galaxies[0] else edges[-1]
            self.log_mass[row] = np.maximum(np.interp(n_haloes, n_galaxies[::-1], edges[::-1]), floor)
            self._edge[row] = np.interp(n_galaxies, n_haloes[::-1], self.proxies[::-1])
        self.least = self._edge.min(axis=1)

    def _in_columns(self, counts: FloatArray) -> FloatArray:
        """Return (rows, columns) of the MassGrid: differences of cumulative numbers (rows, X) at the columns' edges."""
        at = np.stack([np.interp(edge, self.proxies, row) for edge, row in zip(self._edge, counts, strict=True)])
        return at[:, :-1] - at[:, 1:]

    def _types(self) -> None:
        star_forming, quiescent = self.grid.density
        total = star_forming + quiescent
        f = np.divide(quiescent, total, out=np.zeros(total.shape), where=total > 0)
        central, satellite = map(self._in_columns, self._counts(self._density))
        quenched = self._in_columns(self._counts(self._density, self.eps)[1])
        # Satellites in units of centrals: S / (1 - S), and the same times mean(eps)
        ratio, mean = (
            np.divide(part, central, out=np.zeros(part.shape), where=central > 0) for part in (satellite, quenched)
        )
        self.satellite_share = ratio / (1 + ratio)
        raised = (1 - f) * mean
        self.scale = np.divide(f, raised, out=np.ones(f.shape), where=raised > f)
        self.quiescent, self.quiescent_central = f, np.maximum(f - self.scale * raised, 0.0)  # -1e-17: rounding
        central, satellite = map(self._in_columns, self._counts(self._drawn))
        quenched = self._in_columns(self._counts(self._drawn, self.eps)[1])
        red = self.quiescent_central * central + f * satellite + (1 - f) * self.scale * quenched
        self.in_drawn = np.stack([central + satellite - red, red])

    @cached_property
    def remainder(self) -> FloatArray:
        """(types, rows, columns) galaxies per deg2 in haloes that are not drawn."""
        return np.maximum(self.grid.density - self.in_drawn, 0.0)

    @cached_property
    def bias(self) -> FloatArray:
        """(rows,): mean bias of the haloes of the remainder's galaxies; 1 where there are none."""
        rest = self._density - self._drawn
        number = self._hosted(rest)
        return np.divide(self._hosted(rest * self._bias), number, out=np.ones(len(number)), where=number > 0)

    def _hosted(self, haloes: FloatArray) -> FloatArray:
        """Return (rows,): galaxies of haloes (rows, H)."""
        central, satellite = self._counts(haloes)
        above = zip(self.least, central + satellite, strict=True)
        return np.array([np.interp(x, self.proxies, row) for x, row in above])


def quenching(log_mass: Floats, z: Floats, numbers: Mapping[str, Any]) -> FloatArray:
    """Return eps: the fraction of satellites, star-forming otherwise, that a halo of this log10 mass has quenched."""
    eps = numbers["at_1e12"] + numbers["slope"] * (np.asarray(log_mass, float) - 12.0)
    return np.clip(eps * (1 + np.asarray(z, float)) ** numbers["growth"], 0.0, numbers["most"])
