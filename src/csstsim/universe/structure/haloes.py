"""Dark-matter haloes of the whole sky, any part of it on its own: positions, redshifts, masses, concentrations.

    n(M, z | delta) = n(M, z) f(delta)

n is the mass function, delta the overdensity of the halo's shell smoothed on the scale of its tier, and f rises with it
as the halo's bias asks for (intensity); its mean is 1. Haloes are drawn in HEALPix cells, a stream each for a tier of
mass: a Poisson number of candidates, uniform on the cell and by volume in depth, of which the field keeps some. Two
bricks that see a cell see the same haloes. Redshifts are cosmological. Left out: haloes nearer than z_min and lighter
than the first tier, exclusion, triaxial shapes, subhaloes.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import lru_cache
from typing import TYPE_CHECKING, Any

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

_DEEP = 29  # order of the pixels whose centres are the positions
# nodes of the tables
_STEP_Z = 0.05
_MASSES = 160
_MARGIN = 0.15  # of the maximum between points of a map, in its standard deviations
# of a tier, at which the intensity's bound is looked for; bound between nodes
_BIASES = 40
_BETWEEN = 1.01
_SAGITTA = 0.02  # rad x nside: by which a cell may bulge beyond the chords of its border
_FINE = 9  # minimum order of the cells of haloes that do not lens: they are asked for in and close to a brick
_CELLS = 1024  # kept; a brick needs up to 720, and its neighbours most of them again
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
        """Return a dict of COLUMNS of all haloes whose centre lies in brick `pix` or within `reach` of it.

        reach(z, log_mass): angle [rad] (broadcasts), falling with z. lowest: log10 of the minimum mass [solar].
        ra, dec [deg]; log_mass: log10 of solar masses within 200 times the mean density; key: uint64, unique on the
        sky. The order is fixed: the same halo comes before the same other for every brick.
        """
        centre = pixel_vector(NSIDE, pix)
        border = pixel_border(NSIDE, pix, step=16)
        radius = 2 * np.arcsin(0.5 * np.linalg.norm(border - centre, axis=1).max())
        found = []
        tops = self.edges[1:] / np.log(10)
        asked = [t for t, top in enumerate(tops) if top > lowest]
        for order in sorted({o for t in asked for o in self._depths[t]}):  # coarse maps begin finer ones
            for tier in (t for t in asked if order in self._depths[t]):
                masses = self._tables[tier].ln_mass / np.log(10)
                widest = _BETWEEN * float(np.max(reach(self._depths[tier][order][1], masses)))
                for cell in _cells(2 ** self._cell_order(tier, order), centre, min(radius + widest, np.pi)):
                    some = self.cell(tier, order, cell)
                    v = some["vector"]
                    far = reach(some["z"], some["log_mass"])
                    keep = (some["log_mass"] >= lowest) & _within(v, centre, radius, border, far, pix, some)
                    found.append({name: some[name][keep] for name in COLUMNS})
        return {name: np.concatenate([part[name] for part in found]) for name in COLUMNS}

    def mean_concentration(self, mass: Floats, z: Floats) -> FloatArray:
        """Return the median concentration at `mass` [solar] and z."""
        return concentration(mass, z, self.numbers["concentration"], self.mass_function.cosmology.h0 / 100)

    def _shell_depths(self) -> list[dict[int, tuple[IntArray, float, FloatArray]]]:
        """Return for each tier {highest order: (its shells, nearest z, haloes per sr of each)}."""
        edges = self.density.field.shells.edges
        table_z = self._tables[0].fine_z
        chi = self.mass_function.cosmology.comoving_distance(table_z)
        found = []
        for orders, table in zip(self._orders, self._tables, strict=True):
            counts = np.diff(np.interp(edges, chi, table.cumulative))
            depth: dict[int, tuple[IntArray, float, FloatArray]] = {}
            highest = np.ceil(orders)
            for order in np.unique(highest[counts > 0]):
                shells = np.flatnonzero((highest == order) & (counts > 0))
                nearest = max(np.interp(edges[shells[0]], chi, table_z), self.numbers["z_min"])
                depth[int(order)] = shells, nearest, counts[shells]
            found.append(depth)
        return found

    def _cell_order(self, tier: int, order: int) -> int:
        """Return the HEALPix order of the cells in which haloes are drawn: that of the maps, finer for light ones."""
        light = self.edges[tier] < np.log(0.999 * self.numbers["lens_mass"])
        return max(cell_order(order), _FINE if light else 0)

    def _draw(self, tier: int, order: int, cell: int) -> dict[str, AnyArray]:
        """Return the columns of the haloes of a tier in the shells of one order and one cell, with `vector` (n, 3)."""
        shells, _, counts = self._depths[tier][order]
        table = self._tables[tier]
        variance = self._variance[tier][shells]
        at = self._cell_order(tier, order)
        around = cell >> 2 * (at - cell_order(order))
        grid, maps = self.density.smooth(order, around, shells, self._orders[tier])
        peak = maps.max(axis=(0, 1)) + _MARGIN * np.sqrt(variance)
        near = self.density.field.shells.edges[shells]
        far = self.density.field.shells.edges[shells + 1]
        bound = table.largest(peak, variance, near, far)
        random = stream(self.seed, "haloes", tier, order, cell)
        number = random.poisson(counts * bound * 4 * np.pi / (12 * 4**at))
        total = number.sum()
        shell = np.repeat(np.arange(len(shells)), number)
        deep = 2 * (_DEEP - at)
        ra, dec = pixel_centre(1 << _DEEP, (np.int64(cell) << deep) + random.integers(0, 1 << deep, total))
        u = random.random((4, total))
        begin = np.interp(near, table.chi, table.cumulative)
        end = np.interp(far, table.chi, table.cumulative)
        z = table.redshift(begin[shell] + u[0] * (end - begin)[shell])
        ln_mass, bias = table.mass(z, u[1], u[2])
        vectors = unit_vectors(ra, dec)
        delta = interpolate_one(maps, grid.vector_coordinates(vectors, TAPS), shell)
        chance = intensity(delta, bias, variance[shell]) / bound[shell]
        if chance.max(initial=0.0) > 1:
            raise RuntimeError(f"haloes of tier {tier}, order {order}, cell {cell}: the field exceeds its bound")
        kept = np.flatnonzero(u[3] < chance)
        z = z[kept]
        mass = np.exp(ln_mass[kept])
        scatter = 10 ** (self.numbers["concentration"]["scatter"] * random.standard_normal(len(kept)))
        key = (tier << 61) | (order << 56) | (cell << 28)
        return {
            "ra": ra[kept],
            "dec": dec[kept],
            "z": z,
            "log_mass": np.log10(mass),
            "concentration": self.mean_concentration(mass, z) * scatter,
            "key": np.uint64(key) + kept.astype(np.uint64),
            "vector": vectors[kept],
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
        return _BETWEEN * intensity(peak, np.linspace(low, high, _BIASES), variance).max(axis=0)

    def _at(self, distance: FloatArray, edge: int) -> FloatArray:
        """Return the bias of the lightest (edge 0) or heaviest (-1) haloes of the tier at comoving distances."""
        return np.interp(np.interp(distance, self.chi, self.fine_z), self.nodes, self.bias[:, edge])

    def redshift(self, cumulative: FloatArray) -> FloatArray:
        """Return the redshift with so many haloes per sr in front of it."""
        chi3 = np.interp(cumulative, self.cumulative, self._chi3)
        return np.interp(np.cbrt(chi3), self.chi, self.fine_z)

    def mass(self, z: FloatArray, chosen: FloatArray, u: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return ln M and the bias at redshifts z; chosen, u: uniform deviates for the node of z and for the mass."""
        step = self.nodes[1]
        node = np.minimum((z / step).astype(int), len(self.nodes) - 2)
        share = z / step - node
        total = self.below[:, -1]
        upper = share * total[node + 1]
        node_of_mass = node + (chosen * ((1 - share) * total[node] + upper) < upper)
        return _mass(node_of_mass, node, share, u, self.below, self.ln_mass, self.bias)


@njit(cache=True)
def _mass(
    node_of_mass: IntArray,
    node: IntArray,
    share: FloatArray,
    u: FloatArray,
    below: FloatArray,
    ln_mass: FloatArray,
    bias: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    mass = np.empty(len(u))
    b = np.empty(len(u))
    step = ln_mass[1] - ln_mass[0]
    for i in range(len(u)):
        row = below[node_of_mass[i]]
        wanted = u[i] * row[-1]
        k = min(max(np.searchsorted(row, wanted, side="right") - 1, 0), len(row) - 2)
        gap = row[k + 1] - row[k]
        t = (wanted - row[k]) / gap if gap > 0 else 0.0
        mass[i] = ln_mass[k] + t * step
        low = (1 - t) * bias[node[i], k] + t * bias[node[i], k + 1]
        high = (1 - t) * bias[node[i] + 1, k] + t * bias[node[i] + 1, k + 1]
        b[i] = (1 - share[i]) * low + share[i] * high
    return mass, b


def _cells(nside: int, centre: FloatArray, radius: float) -> list[int]:
    """Return the HEALPix cells, rising, that reach into a disc of `radius` [rad]; a few may just not."""
    cells = disc(nside, centre, radius, inclusive=True)
    own = pixel_towards(nside, centre)
    far = [_distance(centre[None], pixel_border(nside, c, step=4))[0] for c in cells.tolist()]
    return cells[(np.array(far) < 2 * np.sin(0.5 * radius) + _SAGITTA / nside) | (cells == own)].tolist()


def _within(
    v: FloatArray,
    centre: FloatArray,
    radius: float,
    border: FloatArray,
    reach: FloatArray,
    pix: int,
    columns: Mapping[str, AnyArray],
) -> BoolArray:
    """Return a mask of unit vectors (n, 3) in the brick, or within `reach` (n,) [rad] of its border."""
    apart = np.linalg.norm(v - centre, axis=1)
    near = apart < 2 * np.sin(0.5 * np.minimum(radius + reach, np.pi))
    rows = np.flatnonzero(near)
    inside = brick_of(columns["ra"][rows], columns["dec"][rows]) == pix
    outside = rows[~inside]
    apart = 2 * np.arcsin(np.minimum(0.5 * _distance(v[outside], border), 1.0))
    near[outside] = apart <= reach[outside]
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
