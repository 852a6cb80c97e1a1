"""Types of stars in each component of the Galaxy: a quadrature over age, [Fe/H] and mass, weighted by numbers.

For each draw of (age, [Fe/H]) the living stars are divided into cells along the isochrone: the main sequence by mass,
later stages by stage, because 0.001 solar masses span a giant branch. Each cell has one type, at a random position in
it, and the number of stars that the initial mass function gives it. More massive stars are white dwarfs. Densities are
those of living mass at the Sun (Robin et al. 2003), companions included. White dwarfs of discs and halo are scaled to
observed numbers. Each type has one possible companion.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from scipy.special import ndtri

from csstsim.base.rng import stream
from csstsim.base.types import FloatArray, IntArray
from csstsim.universe.stars.binaries import Companions, companions
from csstsim.universe.stars.milky_way import Component, components
from csstsim.universe.stars.stellar_evolution import STAGES, living, stage_ends, white_dwarfs

COLUMNS = ("m_v", "teff", "logg", "feh", "stellarmass", "radius")
_MASSES = np.geomspace(0.1, 8.0, 600)  # Msun, at which lifetimes are tabulated to invert them
_CELL_FRACTIONS = (0.45, 0.25, 0.1, 0.15, 0.05)  # main sequence by mass, by stage, and the three later stages
_EARLY_LIFE = 0.3  # fraction of the main-sequence life after which a star's evolution matters more than its mass
_DWARF_CELLS = 0.2  # cells of white dwarfs per cell of living stars
_MILLI = 1e-3


@dataclass(frozen=True, eq=False)
class Types:
    """The types of one component, sorted by M_V: `table` (COLUMNS, n), `total` (n + 1,) cumulative number [pc-3].

    pair (8, n): rows of Companions, the possible companion of each type.
    """

    component: Component
    table: FloatArray
    pair: FloatArray
    total: FloatArray

    def brighter(self, m_v: FloatArray) -> FloatArray:
        """Return the local number [pc-3] of stars brighter than M_V."""
        return self.total[np.searchsorted(self.table[0], m_v)]

    def choose(self, u: FloatArray, brightest: FloatArray, faintest: FloatArray) -> IntArray:
        """Return the types (n,) at the quantile u (n,) of brightest <= M_V < faintest; if none, the next type."""
        low = np.searchsorted(self.table[0], brightest)
        high = np.searchsorted(self.table[0], faintest)
        number = self.total[low] + u * (self.total[high] - self.total[low])
        row = np.clip(np.searchsorted(self.total, number, side="right") - 1, low, np.maximum(high - 1, low))
        return np.minimum(row, self.table.shape[1] - 1)


def make_types(numbers: Mapping[str, Any]) -> list[Types]:
    """Return the Types of every component: the living stars of each, then the white dwarfs of each."""
    living_types, dwarfs = zip(*(_component_types(c, numbers) for c in components(numbers)), strict=True)
    scale: dict[str, float] = {}
    for laws, wanted in numbers["white_dwarfs"]["density"]:
        density = sum(types.total[-1] for types in dwarfs if types.component.law in laws)
        scale |= dict.fromkeys(laws, _MILLI * wanted / density)
    return [*living_types, *(replace(one, total=one.total * scale.get(one.component.law, 1.0)) for one in dwarfs)]


class _LivingCells(NamedTuple):
    """Cells of living stars (n,): mass [Msun], [Fe/H], stage of evolution, and relative number of stars."""

    mass: FloatArray
    feh: FloatArray
    stage: FloatArray
    number: FloatArray


class _RemnantCells(NamedTuple):
    """Cells of white dwarfs (n,): initial mass [Msun], [Fe/H], cooling age [Gyr], and relative number of stars."""

    initial_mass: FloatArray
    feh: FloatArray
    cooling: FloatArray
    number: FloatArray


def _component_types(component: Component, numbers: Mapping[str, Any]) -> tuple[Types, Types]:
    generator = stream(0, "star types", component.name)
    draws, cells = numbers["binning"]
    # Latin hypercube: every slice of age and of [Fe/H] once.
    age_quantile = (generator.permutation(draws) + generator.random(draws)) / draws
    feh_quantile = (generator.permutation(draws) + generator.random(draws)) / draws
    age = component.age0 + age_quantile * (component.age1 - component.age0)
    feh = component.feh + component.feh_sd * ndtri(feh_quantile)
    living_cells, remnant_cells = zip(
        *(_isochrone(component, a, f, cells, generator, numbers) for a, f in zip(age, feh, strict=True)), strict=True
    )
    stars = _LivingCells(*np.concatenate(living_cells, axis=1))
    observed = living(stars.mass, stars.feh, stars.stage, generator.random(len(stars.mass)), numbers)
    ages = np.repeat(age, [len(part.mass) for part in living_cells])
    pair = companions(stream(0, "star types", component.name, "companions"), stars.mass, stars.feh, ages, numbers)
    companion = Companions(*pair)
    if component.law == "bulge":
        scale = numbers["laws"]["bulge_stars"] / stars.number.sum()
    else:
        mass = stars.mass + companion.probability * companion.stellarmass
        scale = _MILLI * component.density / np.einsum("n,n->", stars.number, mass)
    number = stars.number * scale
    remnants = _RemnantCells(*np.concatenate(remnant_cells, axis=1))
    dwarfs = white_dwarfs(remnants.initial_mass, remnants.cooling, numbers)
    # White dwarfs share the normalisation of the initial mass function with the living stars.
    dwarf_number = remnants.number * (number[0] / stars.number[0])
    return (
        _sorted(
            component,
            (observed.m_v, observed.teff, observed.logg, stars.feh, stars.mass, observed.radius),
            pair,
            number,
        ),
        _sorted(
            component,
            (dwarfs.m_v, dwarfs.teff, dwarfs.logg, remnants.feh, dwarfs.mass, dwarfs.radius),
            np.zeros((len(pair), len(dwarfs.m_v))),
            dwarf_number,
        ),
    )


def _sorted(component: Component, columns: Sequence[FloatArray], pair: FloatArray, number: FloatArray) -> Types:
    """Return the Types of `columns` (COLUMNS, n) and their numbers (n,) [pc-3]."""
    present = np.flatnonzero(number > 0)
    order = present[np.argsort(columns[0][present], kind="stable")]
    total = np.concatenate([[0.0], np.cumsum(number[order])])
    return Types(component, np.stack(columns)[:, order], pair[:, order], total)


def _isochrone(
    component: Component, age: float, feh: float, cells: int, generator: np.random.Generator, numbers: Mapping[str, Any]
) -> tuple[_LivingCells, _RemnantCells]:
    """Return the cells of stars of one age [Gyr] and [Fe/H]."""
    low, high = numbers["masses"]
    ends = stage_ends(_MASSES, np.full_like(_MASSES, feh), numbers)
    ends = np.concatenate([_EARLY_LIFE * ends[:1], ends])
    ln_limit = [np.interp(-np.log(age), -np.log(end), np.log(_MASSES)) for end in ends]
    limit = np.minimum(np.exp(ln_limit), high)
    counts = np.maximum(np.round(cells * np.array(_CELL_FRACTIONS)).astype(int), 1)
    edges = [np.geomspace(low, limit[0], counts[0] + 1)]
    for k in range(STAGES):
        # Finer where stars are bright: towards the end of the giant branch.
        x = np.linspace(0.0, 1.0, counts[k + 1] + 1)
        edges.append(limit[k] + (limit[k + 1] - limit[k]) * (1.0 - (1.0 - x) ** 2 if k == 2 else x))
    parts = []
    for k, edge in enumerate(edges):
        t = generator.random(len(edge) - 1)
        mass = edge[:-1] + t * np.diff(edge)
        if k == 0:
            stage = age / np.maximum(stage_ends(mass, np.full_like(mass, feh), numbers)[0], age)
        elif k == 1:
            stage = np.minimum(age / stage_ends(mass, np.full_like(mass, feh), numbers)[0], 1.0)
        else:
            # The range of masses is so narrow that the stage is linear in mass.
            stage = k - 1 + (mass - limit[k - 1]) / np.maximum(limit[k] - limit[k - 1], 1e-12)
        number = _imf(component, edge, numbers["imf_breaks"])
        parts.append(np.stack(_LivingCells(mass, np.full_like(mass, feh), stage, number)))
    edge = np.geomspace(limit[-1], high, int(_DWARF_CELLS * cells) + 1)
    initial = edge[:-1] + generator.random(len(edge) - 1) * np.diff(edge)
    cooling = age - stage_ends(initial, np.full_like(initial, feh), numbers)[-1]
    remnants = _RemnantCells(initial, np.full_like(initial, feh), cooling, _imf(component, edge, numbers["imf_breaks"]))
    return _LivingCells(*np.concatenate(parts, axis=1)), remnants


def _imf(component: Component, edges: FloatArray, breaks: Sequence[float]) -> FloatArray:
    """Return the integral of the initial mass function over each cell; the function is 1 / Msun at the last break."""
    bounds = [0.0, *breaks, np.inf]
    height = 1.0
    out = np.zeros(len(edges) - 1)
    for k in range(len(breaks), -1, -1):
        # From the highest masses down: each piece starts at the height at which the last one ended.
        start = breaks[min(k, len(breaks) - 1)]
        power = component.imf[k] + 1.0
        inside = np.clip(edges, bounds[k], bounds[k + 1])
        out = out + height * start / power * np.diff((inside / start) ** power)
        if 0 < k < len(breaks):
            height *= (breaks[k - 1] / start) ** component.imf[k]
    return out
