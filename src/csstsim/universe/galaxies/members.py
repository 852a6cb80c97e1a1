"""The galaxies of haloes that are drawn one by one: their masses, types, positions and speeds.

The random numbers of a halo's members depend on its key, so two bricks that have a halo have the same members. The
central galaxy is at rest at the centre. Satellites follow an NFW profile (Navarro, Frenk & White 1997) that ends at the
radius of 200 times the mean density, in a prolate ellipsoid of the sphere's volume, and have normal velocities along
the line of sight. The mass within y = r c / r_200 is proportional to m(y) = ln(1 + y) - y / (1 + y). Left out:
velocities of haloes, anisotropy, satellites beyond that radius, positions of subhaloes.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numba import njit

from csstsim.base.counter import poisson, unit, word
from csstsim.base.types import FloatArray, IntArray
from csstsim.base.units import C_KM_S
from csstsim.universe.galaxies.galaxy_shapes import G_KPC_KM2_S2_MSUN
from csstsim.universe.galaxies.subhaloes import STEP

if TYPE_CHECKING:
    from csstsim.universe.galaxies.occupation import Occupation

_ONE = np.uint64(1)
_G_MPC = 1e-3 * G_KPC_KM2_S2_MSUN
_NEWTON_STEPS = 60  # maximum; seven are usual


class Members(NamedTuple):
    """Galaxies of haloes, one row each. `offset` (n, 3): from the halo's centre [comoving Mpc] east, north, outwards.

    halo: row of the halo; satellite: 0 central, 1 satellite; log_mass [solar, stars]; kind: 0 star-forming,
    1 quiescent; speed: along the line of sight [km / s]; axis (n, 3): the halo's long axis in the frame of `offset`.
    """

    halo: IntArray
    satellite: IntArray
    log_mass: FloatArray
    kind: IntArray
    offset: FloatArray
    speed: FloatArray
    axis: FloatArray


class _Haloes(NamedTuple):
    """Haloes, one row each (n,), with their row and bin in the tables.

    log_mass [solar]; scatter: of the central's proxy [dex]; surviving: fraction of subhaloes with a galaxy; minimum:
    proxy of the lightest galaxy; key: uint64; radius [comoving Mpc]; dispersion: of satellites' speeds [km / s].
    """

    log_mass: FloatArray
    scatter: FloatArray
    surviving: FloatArray
    minimum: FloatArray
    key: IntArray
    row: IntArray
    bin: IntArray
    concentration: FloatArray
    radius: FloatArray
    dispersion: FloatArray


class _Tables(NamedTuple):
    """Tables of Occupation from which galaxies are drawn: rows of redshift, proxies, halo bins, columns of mass.

    satellites (bins, proxies): cumulative numbers; first_proxy [dex]; log_mass (rows, proxies) [solar, stars];
    quiescent_central, quiescent, scale (rows, columns); eps (rows, bins); first_column, column_width: log10 of stellar
    mass [solar, dex]; axis_ratio: of the ellipsoid of satellites.
    """

    satellites: FloatArray
    first_proxy: float
    log_mass: FloatArray
    quiescent_central: FloatArray
    quiescent: FloatArray
    scale: FloatArray
    eps: FloatArray
    first_column: float
    column_width: float
    axis_ratio: float


def draw_members(
    occupation: Occupation,
    z: FloatArray,
    log_mass: FloatArray,
    concentration: FloatArray,
    radius: FloatArray,
    keys: IntArray,
) -> Members:
    """Return the Members of haloes, in their order.

    occupation: occupation.Occupation; z, log_mass (200 times the mean density), concentration, radius [comoving Mpc]
    and keys (uint64), each (n,), of the haloes.
    """
    numbers = occupation.numbers["satellites"]
    grid = occupation.grid
    row = np.clip(np.searchsorted(grid.z, z, side="right") - 1, 0, len(grid.volume) - 1)
    bins = np.clip(((log_mass - occupation.proxies[0]) / STEP).astype(int), 0, len(occupation.mass) - 1)
    haloes = _Haloes(
        log_mass=log_mass,
        scatter=np.interp(log_mass, occupation.mass, occupation.scatter),
        surviving=occupation.surviving[row, bins],
        minimum=occupation.lightest_proxy[row],
        key=keys,
        row=row,
        bin=bins,
        concentration=numbers["concentration"] * np.asarray(concentration, float),
        radius=np.asarray(radius, float),
        dispersion=numbers["dispersion"] * np.sqrt(_G_MPC * 10**log_mass * (1 + z) / (2 * radius)),
    )
    tables = _Tables(
        satellites=occupation.satellite,
        first_proxy=occupation.proxies[0],
        log_mass=occupation.log_mass,
        quiescent_central=occupation.quiescent_central,
        quiescent=occupation.quiescent,
        scale=occupation.scale,
        eps=occupation.eps,
        first_column=grid.log_mass[0],
        column_width=grid.step,
        axis_ratio=numbers["axis_ratio"],
    )
    counts = _count(haloes, tables)
    total = counts.sum()
    out = Members(
        halo=np.repeat(np.arange(len(z)), counts),
        satellite=np.empty(total, np.int8),
        log_mass=np.empty(total),
        kind=np.empty(total, np.int8),
        offset=np.zeros((total, 3)),
        speed=np.zeros(total),
        axis=np.zeros((total, 3)),
    )
    _fill(haloes, tables, out)
    return out


def redshift(z: FloatArray, speed: FloatArray) -> FloatArray:
    """Return the redshift of a galaxy that moves at `speed` [km / s] away from a position of redshift z."""
    return z + (1 + z) * speed / C_KM_S


class _HaloDraws(NamedTuple):
    """The draws of one halo: the central's proxy, the number of satellites, and the next counter."""

    proxy: float
    satellites: int
    counter: np.uint64


@njit(cache=True)
def _draw_halo(haloes: _Haloes, tables: _Tables, i: int) -> _HaloDraws:
    """Return the _HaloDraws of halo i."""
    key = haloes.key[i]
    proxy = haloes.log_mass[i] + haloes.scatter[i] * _normal(key, np.uint64(0))
    minimum = (haloes.minimum[i] - tables.first_proxy) / STEP
    mean = haloes.surviving[i] * _at(tables.satellites[haloes.bin[i]], minimum)
    count, counter = poisson(mean, key, np.uint64(2))
    return _HaloDraws(proxy, count, counter)


@njit(cache=True)
def _count(haloes: _Haloes, tables: _Tables) -> IntArray:
    """Return the number of galaxies of each halo (n,)."""
    counts = np.zeros(len(haloes.log_mass), np.int64)
    for i in range(len(haloes.log_mass)):
        drawn = _draw_halo(haloes, tables, i)
        counts[i] = drawn.satellites + (drawn.proxy > haloes.minimum[i])
    return counts


@njit(cache=True)
def _fill(haloes: _Haloes, tables: _Tables, out: Members) -> None:
    """Fill all columns of `out` but `halo`; `offset` and `speed` of centrals are not changed."""
    quiescent_fractions = tables.quiescent
    axis_ratio = tables.axis_ratio
    galaxy = 0
    direction = np.empty(3)
    for i in range(len(haloes.log_mass)):
        drawn = _draw_halo(haloes, tables, i)
        counter = drawn.counter
        key = haloes.key[i]
        row = haloes.row[i]
        satellites = tables.satellites[haloes.bin[i]]
        long_axis = np.empty(3)
        counter = _direction(key, counter, long_axis)
        if drawn.proxy > haloes.minimum[i]:
            out.satellite[galaxy] = 0
            out.log_mass[galaxy] = _at(tables.log_mass[row], (drawn.proxy - tables.first_proxy) / STEP)
            column = _column(out.log_mass[galaxy], tables)
            out.kind[galaxy] = unit(word(key, counter)) < tables.quiescent_central[row, column]
            out.axis[galaxy] = long_axis
            galaxy += 1
        counter += _ONE
        minimum = (haloes.minimum[i] - tables.first_proxy) / STEP
        mean = _at(satellites, minimum)
        for _ in range(drawn.satellites):
            index = _index_of(satellites, unit(word(key, counter)) * mean, minimum)
            out.satellite[galaxy] = 1
            out.log_mass[galaxy] = _at(tables.log_mass[row], index)
            column = _column(out.log_mass[galaxy], tables)
            f = quiescent_fractions[row, column]
            quiescent_chance = f + (1 - f) * tables.scale[row, column] * tables.eps[row, haloes.bin[i]]
            out.kind[galaxy] = unit(word(key, counter + _ONE)) < quiescent_chance
            mass_fraction = unit(word(key, counter + np.uint64(2)))
            distance = haloes.radius[i] * nfw_radius(mass_fraction, haloes.concentration[i])
            out.speed[galaxy] = haloes.dispersion[i] * _normal(key, counter + np.uint64(3))
            counter = _direction(key, counter + np.uint64(5), direction)
            projection = direction[0] * long_axis[0] + direction[1] * long_axis[1] + direction[2] * long_axis[2]
            for k in range(3):
                scaled = direction[k] * axis_ratio ** (1 / 3)
                out.offset[galaxy, k] = distance * (
                    scaled + projection * long_axis[k] * (axis_ratio ** (-2 / 3) - axis_ratio ** (1 / 3))
                )
            out.axis[galaxy] = long_axis
            galaxy += 1


@njit(cache=True)
def _column(log_mass: float, tables: _Tables) -> int:
    """Return the column of a stellar mass; beyond the ends, the first or last."""
    column = int((log_mass - tables.first_column) / tables.column_width)
    return min(max(column, 0), tables.quiescent.shape[1] - 1)


@njit(cache=True)
def nfw_radius(fraction: float, concentration: float) -> float:
    """Return the radius, in r_200, within which an NFW halo has this fraction (0 to 1) of its mass.

    With w = 1 / (1 + y) the mass is m = w - ln(w) - 1; Newton's steps from below rise to the root.
    """
    m = fraction * (math.log1p(concentration) - concentration / (1 + concentration))
    w = max(1 - math.sqrt(2 * m), math.exp(-m - 1))
    for _ in range(_NEWTON_STEPS):
        step = (w - math.log(w) - 1 - m) * w / (1 - w) if w < 1 else 0.0
        w += step
        if step <= 1e-12 * w:
            break
    return (1 / w - 1) / concentration


@njit(cache=True)
def _normal(key: np.uint64, counter: np.uint64) -> float:
    """Return a normal deviate, from two words."""
    radius = math.sqrt(-2 * math.log(unit(word(key, counter))))
    return radius * math.cos(2 * math.pi * unit(word(key, counter + _ONE)))


@njit(cache=True)
def _direction(key: np.uint64, counter: np.uint64, out: FloatArray) -> np.uint64:
    """Fill `out` with a random unit vector, from two words; return the next counter."""
    out[2] = 2 * unit(word(key, counter)) - 1
    angle = 2 * math.pi * unit(word(key, counter + _ONE))
    flat = math.sqrt(1 - out[2] ** 2)
    out[0], out[1] = flat * math.cos(angle), flat * math.sin(angle)
    return counter + np.uint64(2)


@njit(cache=True)
def _at(table: FloatArray, position: float) -> float:
    """Return a table, linear between entries, at an index; beyond the ends, the first or last value."""
    k = min(max(int(position), 0), len(table) - 2)
    return table[k] + min(max(position - k, 0.0), 1.0) * (table[k + 1] - table[k])


@njit(cache=True)
def _index_of(table: FloatArray, number: float, minimum: float) -> float:
    """Return the index from `minimum` on at which a falling table is `number`."""
    low = int(minimum)
    high = len(table) - 1
    while high - low > 1:
        middle = (low + high) // 2
        if table[middle] >= number:
            low = middle
        else:
            high = middle
    fall = table[low] - table[high]
    return max(low + (table[low] - number) / fall, minimum) if fall > 0 else float(low)
