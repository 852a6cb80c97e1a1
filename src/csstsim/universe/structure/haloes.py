"""Dark-matter haloes of the whole sky, each part independently: positions, redshifts, masses, concentrations.

    n(M, z | delta) = n(M, z) f(delta)

n is the mass function, delta the overdensity of the halo's shell smoothed on the scale of its tier. f, of mean 1, rises
with delta according to the halo's bias (intensity). Haloes are drawn in HEALPix cells, with a random stream for each
tier of mass: a Poisson number of candidates, uniform in the cell and in volume, which are accepted with a probability
proportional to f. Two bricks that use a cell have the same haloes. Redshifts are cosmological. Left out: haloes nearer
than z_min and lighter than the first tier, exclusion, triaxial shapes, subhaloes.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import lru_cache
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numba import njit

from csstsim.base.healpix import NSIDE, brick_of, disc, pixel_border, pixel_centre, pixel_towards, pixel_vector
from csstsim.base.rng import stream
from csstsim.base.sphere import unit_vectors
from csstsim.base.types import AnyArray, BoolArray, FloatArray, Floats, IntArray
from csstsim.universe.structure.density import TAPS, angular_order, cell_order, interpolate_one, kernel_order
from csstsim.universe.structure.intensity import intensity

if TYPE_CHECKING:
    from csstsim.universe.lensing.potential_field import PotentialField
    from csstsim.universe.structure.density import ShellDensity
    from csstsim.universe.structure.mass_function import HaloMassFunction

_POSITION_ORDER = 29  # HEALPix order of positions, which are centres of pixels
# Nodes of the tables: step of redshift, number of masses
_STEP_Z = 0.05
_MASSES = 160
_MARGIN = 0.15  # of the maximum between the points of a map [its standard deviations]
_BIASES = 40  # nodes of a tier at which the maximum of the intensity is sought
_BOUND_FACTOR = 1.01  # of the maximum between nodes
_BORDER_SLACK = 0.02  # rad x nside: a cell extends by at most this beyond the chords of its border
_LIGHT_CELL_ORDER = 9  # minimum order of cells of haloes that do not lens: they are needed only close to a brick
_CELLS = 1024  # in the cache; a brick needs up to 720, and its neighbours need most of them, too
COLUMNS = ("ra", "dec", "z", "log_mass", "concentration", "key")


def tier_orders(field: PotentialField, mass_function: HaloMassFunction, numbers: Mapping[str, Any]) -> FloatArray:
    """Return for each tier (tiers, shells) the order of the kernels down to which its haloes follow the field."""
    haloes = numbers["haloes"]
    lightest = np.array(numbers["haloes"]["tiers"][:-1])
    scales = np.array(haloes["placement"]) * mass_function.lagrangian_radius(lightest)
    orders = np.stack([kernel_order(field, max(scale, numbers["galaxy_scale"])) for scale in scales])
    lensing = lightest >= 0.999 * haloes["lens_mass"]
    orders[lensing] = np.minimum(orders[lensing], angular_order(field, np.radians(haloes["finest"] / 60)))
    return orders


class _Depth(NamedTuple):
    """Shells (n,) in which the haloes of a tier follow the same maps; z_min: of the nearest; counts (n,): per sr."""

    shells: IntArray
    z_min: float
    counts: FloatArray


class Haloes:
    """The haloes of one campaign seed.

    density: density.ShellDensity; mass_function: mass_function.HaloMassFunction; numbers: the mapping of
    structure.yaml.
    """

    def __init__(
        self, seed: int, density: ShellDensity, mass_function: HaloMassFunction, numbers: Mapping[str, Any]
    ) -> None:
        self.seed = seed
        self.density = density
        self.mass_function = mass_function
        self.numbers = numbers["haloes"]
        self.edges = np.log(self.numbers["tiers"])
        self._orders = tier_orders(density.field, mass_function, numbers)
        self._variance = [density.variance(order) for order in self._orders]
        self._tables = [
            _Table(mass_function, self.edges[t], self.edges[t + 1], self.numbers) for t in range(len(self._orders))
        ]
        self._depths = self._shell_depths()
        self.cell = lru_cache(maxsize=_CELLS)(self._draw)

    def near(
        self, pix: int, reach: Callable[[Floats, FloatArray], FloatArray], lowest: float = 0.0
    ) -> dict[str, AnyArray]:
        """Return a dict of COLUMNS of all haloes whose centre is in brick `pix` or within `reach` of it.

        reach(z, log_mass): angle [rad] (broadcasts), falling with z; lowest: log10 of the minimum mass [solar].
        Columns: ra, dec [deg]; z; log_mass, log10 of solar masses within 200 times the mean density; concentration;
        key, uint64, unique on the sky. Any two haloes have the same order in every brick.
        """
        centre = pixel_vector(NSIDE, pix)
        border = pixel_border(NSIDE, pix, step=16)
        radius = 2 * np.arcsin(0.5 * np.linalg.norm(border - centre, axis=1).max())
        parts = []
        tier_tops = self.edges[1:] / np.log(10)
        tiers = [t for t, top in enumerate(tier_tops) if top > lowest]
        for order in sorted({o for t in tiers for o in self._depths[t]}):  # finer maps start from coarse ones
            for tier in (t for t in tiers if order in self._depths[t]):
                masses = self._tables[tier].ln_mass / np.log(10)
                reach_max = _BOUND_FACTOR * float(np.max(reach(self._depths[tier][order].z_min, masses)))
                for cell in _cells(2 ** self._cell_order(tier, order), centre, min(radius + reach_max, np.pi)):
                    columns = self.cell(tier, order, cell)
                    reaches = reach(columns["z"], columns["log_mass"])
                    chosen = (columns["log_mass"] >= lowest) & _within(columns, reaches, pix, centre, radius, border)
                    parts.append({name: columns[name][chosen] for name in COLUMNS})
        return {name: np.concatenate([part[name] for part in parts]) for name in COLUMNS}

    def mean_concentration(self, mass: Floats, z: Floats) -> FloatArray:
        """Return the median concentration at `mass` [solar] and z."""
        return concentration(mass, z, self.numbers["concentration"], self.mass_function.cosmology.h0 / 100)

    def _shell_depths(self) -> list[dict[int, _Depth]]:
        """Return {highest order: its _Depth} for each tier."""
        edges = self.density.field.shells.edges
        table_z = self._tables[0].fine_z
        chi = self.mass_function.cosmology.comoving_distance(table_z)
        tiers = []
        for orders, table in zip(self._orders, self._tables, strict=True):
            counts = np.diff(np.interp(edges, chi, table.cumulative))
            depths: dict[int, _Depth] = {}
            highest = np.ceil(orders)
            for order in np.unique(highest[counts > 0]):
                shells = np.flatnonzero((highest == order) & (counts > 0))
                z_min = max(np.interp(edges[shells[0]], chi, table_z), self.numbers["z_min"])
                depths[int(order)] = _Depth(shells, z_min, counts[shells])
            tiers.append(depths)
        return tiers

    def _cell_order(self, tier: int, order: int) -> int:
        """Return the HEALPix order of the cells of haloes: that of the maps, or higher for light haloes."""
        light = self.edges[tier] < np.log(0.999 * self.numbers["lens_mass"])
        return max(cell_order(order), _LIGHT_CELL_ORDER if light else 0)

    def _draw(self, tier: int, order: int, cell: int) -> dict[str, AnyArray]:
        """Return the columns of the haloes of a tier in the shells of one order and one cell, with `vector` (n, 3)."""
        shells, _, counts = self._depths[tier][order]
        table = self._tables[tier]
        variance = self._variance[tier][shells]
        drawn_order = self._cell_order(tier, order)
        map_cell = cell >> 2 * (drawn_order - cell_order(order))
        grid, maps = self.density.smooth(order, map_cell, shells, self._orders[tier])
        peak = maps.max(axis=(0, 1)) + _MARGIN * np.sqrt(variance)
        near = self.density.field.shells.edges[shells]
        far = self.density.field.shells.edges[shells + 1]
        bound = table.largest(peak, variance, near, far)
        generator = stream(self.seed, "haloes", tier, order, cell)
        number = generator.poisson(counts * bound * 4 * np.pi / (12 * 4**drawn_order))
        total = number.sum()
        shell = np.repeat(np.arange(len(shells)), number)
        bits = 2 * (_POSITION_ORDER - drawn_order)
        ra, dec = pixel_centre(1 << _POSITION_ORDER, (np.int64(cell) << bits) + generator.integers(0, 1 << bits, total))
        u = generator.random((4, total))
        begin = np.interp(near, table.chi, table.cumulative)
        end = np.interp(far, table.chi, table.cumulative)
        z = table.redshift(begin[shell] + u[0] * (end - begin)[shell])
        ln_mass, bias = table.mass(z, u[1], u[2])
        vectors = unit_vectors(ra, dec)
        delta = interpolate_one(maps, grid.vector_coordinates(vectors, TAPS), shell)
        chance = intensity(delta, bias, variance[shell]) / bound[shell]
        if chance.max(initial=0.0) > 1:
            raise RuntimeError(f"haloes of tier {tier}, order {order}, cell {cell}: the field exceeds its bound")
        accepted = np.flatnonzero(u[3] < chance)
        z = z[accepted]
        mass = np.exp(ln_mass[accepted])
        scatter = 10 ** (self.numbers["concentration"]["scatter"] * generator.standard_normal(len(accepted)))
        key = (tier << 61) | (order << 56) | (cell << 28)
        return {
            "ra": ra[accepted],
            "dec": dec[accepted],
            "z": z,
            "log_mass": np.log10(mass),
            "concentration": self.mean_concentration(mass, z) * scatter,
            "key": np.uint64(key) + accepted.astype(np.uint64),
            "vector": vectors[accepted],
        }


def concentration(mass: Floats, z: Floats, numbers: Mapping[str, Any], h: float) -> FloatArray:
    """Return the median concentration a (M / m)^b (1 + z)^d; numbers: haloes.concentration of structure.yaml."""
    scaled = np.asarray(mass, float) * h / numbers["pivot_h"]
    return numbers["amplitude"] * scaled ** numbers["mass_slope"] * (1 + np.asarray(z)) ** numbers["redshift_slope"]


class _Table:
    """Numbers and biases of the haloes of one tier, linear in z between nodes, and their inverses for drawing."""

    def __init__(self, mass_function: HaloMassFunction, low: float, high: float, numbers: Mapping[str, Any]) -> None:
        z_min = numbers["z_min"]
        z_max = numbers["z_max"]
        cosmology = mass_function.cosmology
        self.nodes = np.linspace(0.0, z_max, int(np.ceil(z_max / _STEP_Z)) + 1)
        self.ln_mass = np.linspace(low, high, _MASSES)
        mass = np.exp(self.ln_mass)
        z = self.nodes[:, None]
        density = mass_function.dn_dlnm(mass, z)
        self.bias = mass_function.bias(mass, z)
        pieces = 0.5 * (density[:, 1:] + density[:, :-1]) * np.diff(self.ln_mass)
        self.below = np.concatenate([np.zeros((len(z), 1)), np.cumsum(pieces, axis=1)], axis=1)  # per Mpc^3
        self.fine_z = np.linspace(z_min, z_max, 20 * len(self.nodes))
        self.chi = cosmology.comoving_distance(self.fine_z)
        number = np.interp(self.fine_z, self.nodes, self.below[:, -1])
        volume = np.diff(self.chi**3) / 3
        slices = 0.5 * (number[1:] + number[:-1]) * volume
        self.cumulative = np.append(0.0, np.cumsum(slices))  # haloes per sr nearer than fine_z
        self._chi3 = self.chi**3

    def largest(self, peak: FloatArray, variance: FloatArray, near: FloatArray, far: FloatArray) -> FloatArray:
        """Return the largest intensity for delta up to `peak` and all masses, each (shells,).

        near, far: the comoving distances of the shells' edges. The bias rises with mass and redshift.
        """
        low = self._at(near, 0)
        high = self._at(far, -1)
        return _BOUND_FACTOR * intensity(peak, np.linspace(low, high, _BIASES), variance).max(axis=0)

    def _at(self, distance: FloatArray, edge: int) -> FloatArray:
        """Return the bias of the lightest (edge 0) or heaviest (-1) haloes of the tier at comoving distances."""
        return np.interp(np.interp(distance, self.chi, self.fine_z), self.nodes, self.bias[:, edge])

    def redshift(self, cumulative: FloatArray) -> FloatArray:
        """Return the redshift in front of which there are `cumulative` haloes per sr."""
        chi3 = np.interp(cumulative, self.cumulative, self._chi3)
        return np.interp(np.cbrt(chi3), self.chi, self.fine_z)

    def mass(self, z: FloatArray, node_choice: FloatArray, u: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return ln M and the bias at redshifts z; node_choice, u: uniform deviates for the node of z and the mass."""
        step = self.nodes[1]
        node = np.minimum((z / step).astype(int), len(self.nodes) - 2)
        fraction = z / step - node
        total = self.below[:, -1]
        upper = fraction * total[node + 1]
        node_of_mass = node + (node_choice * ((1 - fraction) * total[node] + upper) < upper)
        return _mass(node_of_mass, node, fraction, u, self.below, self.ln_mass, self.bias)


@njit(cache=True)
def _mass(
    node_of_mass: IntArray,
    node: IntArray,
    fraction: FloatArray,
    u: FloatArray,
    below: FloatArray,
    ln_mass: FloatArray,
    bias_table: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    ln_masses = np.empty(len(u))
    biases = np.empty(len(u))
    step = ln_mass[1] - ln_mass[0]
    for i in range(len(u)):
        row = below[node_of_mass[i]]
        number = u[i] * row[-1]
        k = min(max(np.searchsorted(row, number, side="right") - 1, 0), len(row) - 2)
        gap = row[k + 1] - row[k]
        t = (number - row[k]) / gap if gap > 0 else 0.0
        ln_masses[i] = ln_mass[k] + t * step
        low = (1 - t) * bias_table[node[i], k] + t * bias_table[node[i], k + 1]
        high = (1 - t) * bias_table[node[i] + 1, k] + t * bias_table[node[i] + 1, k + 1]
        biases[i] = (1 - fraction[i]) * low + fraction[i] * high
    return ln_masses, biases


def _cells(nside: int, centre: FloatArray, radius: float) -> list[int]:
    """Return the HEALPix cells, rising, that overlap a disc of `radius` [rad], and a few close to it."""
    cells = disc(nside, centre, radius, inclusive=True)
    centre_cell = pixel_towards(nside, centre)
    distances = [_distance(centre[None], pixel_border(nside, c, step=4))[0] for c in cells.tolist()]
    return cells[
        (np.array(distances) < 2 * np.sin(0.5 * radius) + _BORDER_SLACK / nside) | (cells == centre_cell)
    ].tolist()


def _within(
    columns: Mapping[str, AnyArray],
    reach: FloatArray,
    pix: int,
    centre: FloatArray,
    radius: float,
    border: FloatArray,
) -> BoolArray:
    """Return a mask of haloes (n,) in brick `pix`, or within `reach` (n,) [rad] of its border.

    centre (3,), radius [rad], border (m, 3): of the brick.
    """
    vectors = columns["vector"]
    distance = np.linalg.norm(vectors - centre, axis=1)
    near = distance < 2 * np.sin(0.5 * np.minimum(radius + reach, np.pi))
    rows = np.flatnonzero(near)
    inside = brick_of(columns["ra"][rows], columns["dec"][rows]) == pix
    outside = rows[~inside]
    distance = 2 * np.arcsin(np.minimum(0.5 * _distance(vectors[outside], border), 1.0))
    near[outside] = distance <= reach[outside]
    return near


@njit(cache=True)
def _distance(points: FloatArray, border: FloatArray) -> FloatArray:
    """Return the distance (n,) of points (n, 3) from the closed polygon of chords between `border` (m, 3)."""
    out = np.empty(len(points))
    for i in range(len(points)):
        best = 16.0
        for j in range(len(border)):
            a = border[j]
            b = border[(j + 1) % len(border)]
            e0 = b[0] - a[0]
            e1 = b[1] - a[1]
            e2 = b[2] - a[2]
            d0 = points[i, 0] - a[0]
            d1 = points[i, 1] - a[1]
            d2 = points[i, 2] - a[2]
            t = min(max((d0 * e0 + d1 * e1 + d2 * e2) / (e0 * e0 + e1 * e1 + e2 * e2), 0.0), 1.0)
            d0 = d0 - t * e0
            d1 = d1 - t * e1
            d2 = d2 - t * e2
            best = min(best, d0 * d0 + d1 * d1 + d2 * d2)
        out[i] = np.sqrt(best)
    return out
