"""Types of stars in each component of the Galaxy: a quadrature over age, [Fe/H] and mass, weighted by numbers.

For each draw of (age, [Fe/H]) the living stars are divided into cells along the isochrone: the main sequence by mass,
later stages by stage, because there 0.001 solar masses span a giant branch. Each cell has one type at a random position
inside and the number of stars that the initial mass function gives it. More massive stars are white dwarfs. Densities
are those of living mass at the Sun (Robin et al. 2003), companions included; white dwarfs of discs and halo are scaled
to observed numbers. Each type has its own possible companion.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.special import ndtri

from csstsim.base.rng import stream
from csstsim.base.types import FloatArray, IntArray
from csstsim.universe.stars.binaries import PAIR, companions
from csstsim.universe.stars.milky_way import Component, components
from csstsim.universe.stars.stellar_evolution import STAGES, living, stage_ends, white_dwarfs

COLUMNS = ("m_v", "teff", "logg", "feh", "stellarmass", "radius")
_TRIALS = np.geomspace(0.1, 8.0, 600)  # Msun, for the inversion of lifetimes
_SPLIT = (0.45, 0.25, 0.1, 0.15, 0.05)  # of the cells: main sequence by mass, by stage, and the three later stages
_EARLY = 0.3  # fraction of the main-sequence life after which a star's evolution matters more than its mass
_WHITE = 0.2  # cells of white dwarfs per cell of living stars
_MILLI = 1e-3


@dataclass(frozen=True, eq=False)
class Types:
    """The types of one component, sorted by M_V: `table` (COLUMNS, n), `total` (n + 1,) cumulative number [pc-3].

    `pair` (PAIR, n) are their companions.
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
        low, high = (np.searchsorted(self.table[0], m) for m in (brightest, faintest))
        aim = self.total[low] + u * (self.total[high] - self.total[low])
        row = np.clip(np.searchsorted(self.total, aim, side="right") - 1, low, np.maximum(high - 1, low))
        return np.minimum(row, self.table.shape[1] - 1)


def make_types(numbers: Mapping[str, Any]) -> list[Types]:
    """Return the Types of every component: the living stars of each, then the white dwarfs of each."""
    living_, white = zip(*(_component_types(c, numbers) for c in components(numbers)), strict=True)
    scale: dict[str, float] = {}
    for laws, wanted in numbers["white_dwarfs"]["density"]:
        made = sum(types.total[-1] for types in white if types.component.law in laws)
        scale |= dict.fromkeys(laws, _MILLI * wanted / made)
    return [*living_, *(replace(w, total=w.total * scale.get(w.component.law, 1.0)) for w in white)]


def _component_types(component: Component, numbers: Mapping[str, Any]) -> tuple[Types, Types]:
    generator = stream(0, "star types", component.name)
    draws, cells = numbers["binning"]
    # Latin hypercube: every slice of age and of [Fe/H] once.
    age, quantile = ((generator.permutation(draws) + generator.random(draws)) / draws for _ in range(2))
    age = component.age0 + age * (component.age1 - component.age0)
    feh = component.feh + component.feh_sd * ndtri(quantile)
    stars, remnants = zip(
        *(_isochrone(component, a, f, cells, generator, numbers) for a, f in zip(age, feh, strict=True)), strict=True
    )
    mass, metal, stage, weight = np.concatenate(stars, axis=1)
    teff, logg, radius, m_v = living(mass, metal, stage, generator.random(len(mass)), numbers)
    ages = np.repeat(age, [part.shape[1] for part in stars])
    pair = companions(stream(0, "star types", component.name, "companions"), mass, metal, ages, numbers)
    if component.law == "bulge":
        weight *= numbers["laws"]["bulge_stars"] / weight.sum()
    else:
        weight *= _MILLI * component.density / np.einsum("n,n->", weight, mass + pair[0] * pair[4])
    # White dwarfs share the normalisation of the initial mass function with the living.
    unit = weight[0] / stars[0][3, 0]
    first, metal_w, cooling, weight_w = np.concatenate(remnants, axis=1)
    teff_w, logg_w, radius_w, m_w, mass_w = white_dwarfs(first, cooling, numbers)
    none = np.zeros((len(PAIR), len(m_w)))
    return (
        _sorted(component, (m_v, teff, logg, metal, mass, radius), pair, weight),
        _sorted(component, (m_w, teff_w, logg_w, metal_w, mass_w, radius_w), none, weight_w * unit),
    )


def _sorted(component: Component, columns: Sequence[FloatArray], pair: FloatArray, weight: FloatArray) -> Types:
    keep = np.flatnonzero(weight > 0)
    order = keep[np.argsort(columns[0][keep], kind="stable")]
    total = np.concatenate([[0.0], np.cumsum(weight[order])])
    return Types(component, np.stack(columns)[:, order], pair[:, order], total)


def _isochrone(
    component: Component, age: float, feh: float, cells: int, generator: np.random.Generator, numbers: Mapping[str, Any]
) -> tuple[FloatArray, FloatArray]:
    """Return (4, n) mass, [Fe/H], stage, number of living stars, and (4, m) first mass, [Fe/H], cooling age, number."""
    low, high = numbers["masses"]
    ends = stage_ends(_TRIALS, np.full_like(_TRIALS, feh), numbers)
    ends = np.concatenate([_EARLY * ends[:1], ends])
    ln_limit = [np.interp(-np.log(age), -np.log(end), np.log(_TRIALS)) for end in ends]
    limit = np.minimum(np.exp(ln_limit), high)
    counts = np.maximum(np.round(cells * np.array(_SPLIT)).astype(int), 1)
    edges = [np.geomspace(low, limit[0], counts[0] + 1)]
    for k in range(STAGES):
        # Finer where the star is bright: towards the end of the giant branch.
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
            # In so narrow a range of mass the stage is linear in mass.
            stage = k - 1 + (mass - limit[k - 1]) / np.maximum(limit[k] - limit[k - 1], 1e-12)
        parts.append(np.stack([mass, np.full_like(mass, feh), stage, _imf(component, edge, numbers["imf_breaks"])]))
    edge = np.geomspace(limit[-1], high, int(_WHITE * cells) + 1)
    first = edge[:-1] + generator.random(len(edge) - 1) * np.diff(edge)
    cooling = age - stage_ends(first, np.full_like(first, feh), numbers)[-1]
    remnants = np.stack([first, np.full_like(first, feh), cooling, _imf(component, edge, numbers["imf_breaks"])])
    return np.concatenate(parts, axis=1), remnants


def _imf(component: Component, edges: FloatArray, breaks: Sequence[float]) -> FloatArray:
    """Integral of the initial mass function over each cell; 1 / Msun at the last break."""
    bounds = [0.0, *breaks, np.inf]
    height = 1.0
    out = np.zeros(len(edges) - 1)
    for k in range(len(breaks), -1, -1):
        # From the top down: each piece starts at the height where the one above ended.
        start = breaks[min(k, len(breaks) - 1)]
        power = component.imf[k] + 1.0
        inside = np.clip(edges, bounds[k], bounds[k + 1])
        out = out + height * start / power * np.diff((inside / start) ** power)
        if 0 < k < len(breaks):
            height *= (breaks[k - 1] / start) ** component.imf[k]
    return out
