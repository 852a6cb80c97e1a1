"""The galaxies of haloes that are drawn one by one: which, and where in the halo.

The random numbers of a halo's members come from its own key, so two bricks that see a halo see the same members. The
central galaxy rests in the middle. Satellites lie on an NFW profile (Navarro, Frenk & White 1997) cut at the radius of
200 times the mean density, in a prolate ellipsoid of the sphere's volume, and have normal velocities along the line of
sight. Mass in the NFW radius y = r c / r_200 goes as m(y) = ln(1 + y) - y / (1 + y). Left out: velocities of haloes,
anisotropy, satellites beyond that radius, subhaloes as places of their own.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

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
_NEWTON = 60  # steps at most; seven are usual


@dataclass(frozen=True, eq=False)
class Members:
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
    speed = numbers["dispersion"] * np.sqrt(_G_MPC * 10**log_mass * (1 + z) / (2 * radius))
    scatter = np.interp(log_mass, occupation.mass, occupation.scatter)
    least = occupation.least[row]
    surviving = occupation.surviving[row, bins]
    table = occupation.satellite
    drawn = log_mass, scatter, bins, least, surviving, table, occupation.proxies[0], keys
    counts = _count(*drawn)
    own = numbers["concentration"] * np.asarray(concentration, float), np.asarray(radius, float), speed
    law = occupation.log_mass, occupation.quiescent_central, occupation.quiescent, occupation.scale, occupation.eps
    columns = grid.log_mass[0], grid.step, numbers["axis_ratio"]
    total = counts.sum()
    out = Members(
        np.repeat(np.arange(len(z)), counts),
        np.empty(total, np.int8),
        np.empty(total),
        np.empty(total, np.int8),
        np.zeros((total, 3)),
        np.zeros(total),
        np.zeros((total, 3)),
    )
    _fill(*drawn, row, *own, *law, *columns, out.satellite, out.log_mass, out.kind, out.offset, out.speed, out.axis)
    return out


def redshift(z: FloatArray, speed: FloatArray) -> FloatArray:
    """Return the redshift of a galaxy that moves at `speed` [km / s] away from a place of redshift z."""
    return z + (1 + z) * speed / C_KM_S


@njit(cache=True)
def _numbers(
    i: int,
    log_mass: FloatArray,
    scatter: FloatArray,
    bins: IntArray,
    least: FloatArray,
    surviving: FloatArray,
    table: FloatArray,
    first: float,
    keys: IntArray,
) -> tuple[float, int, np.uint64]:
    """Return the central's proxy, the number of satellites and the counter to go on with."""
    proxy = log_mass[i] + scatter[i] * _normal(keys[i], np.uint64(0))
    mean = surviving[i] * _above(table[bins[i]], (least[i] - first) / STEP)
    count, counter = poisson(mean, keys[i], np.uint64(2))
    return proxy, count, counter


@njit(cache=True)
def _count(
    log_mass: FloatArray,
    scatter: FloatArray,
    bins: IntArray,
    least: FloatArray,
    surviving: FloatArray,
    table: FloatArray,
    first: float,
    keys: IntArray,
) -> IntArray:
    counts = np.zeros(len(log_mass), np.int64)
    for i in range(len(log_mass)):
        proxy, count, _ = _numbers(i, log_mass, scatter, bins, least, surviving, table, first, keys)
        counts[i] = count + (proxy > least[i])
    return counts


@njit(cache=True)
def _fill(
    log_mass: FloatArray,
    scatter: FloatArray,
    bins: IntArray,
    least: FloatArray,
    surviving: FloatArray,
    table: FloatArray,
    first: float,
    keys: IntArray,
    row: IntArray,
    concentration: FloatArray,
    radius: FloatArray,
    dispersion: FloatArray,
    stars: FloatArray,
    red_central: FloatArray,
    red: FloatArray,
    scale: FloatArray,
    eps: FloatArray,
    column0: float,
    width: float,
    ratio: float,
    satellite: IntArray,
    out_mass: FloatArray,
    kind: IntArray,
    offset: FloatArray,
    speed: FloatArray,
    axis: FloatArray,
) -> None:
    g = 0
    place = np.empty(3)
    for i in range(len(log_mass)):
        proxy, count, counter = _numbers(i, log_mass, scatter, bins, least, surviving, table, first, keys)
        key = keys[i]
        r = row[i]
        long = np.empty(3)
        counter = _direction(key, counter, long)
        if proxy > least[i]:
            satellite[g], out_mass[g] = 0, _at(stars[r], (proxy - first) / STEP)
            column = min(max(int((out_mass[g] - column0) / width), 0), red.shape[1] - 1)
            kind[g] = unit(word(key, counter)) < red_central[r, column]
            axis[g] = long
            g += 1
        counter += _ONE
        lowest = (least[i] - first) / STEP
        mean = _above(table[bins[i]], lowest)
        for _ in range(count):
            t = _where(table[bins[i]], unit(word(key, counter)) * mean, lowest)
            satellite[g], out_mass[g] = 1, _at(stars[r], t)
            column = min(max(int((out_mass[g] - column0) / width), 0), red.shape[1] - 1)
            f = red[r, column]
            kind[g] = unit(word(key, counter + _ONE)) < f + (1 - f) * scale[r, column] * eps[r, bins[i]]
            distance = radius[i] * nfw_radius(unit(word(key, counter + np.uint64(2))), concentration[i])
            speed[g] = dispersion[i] * _normal(key, counter + np.uint64(3))
            counter = _direction(key, counter + np.uint64(5), place)
            along = place[0] * long[0] + place[1] * long[1] + place[2] * long[2]
            for k in range(3):
                short = place[k] * ratio ** (1 / 3)
                offset[g, k] = distance * (short + along * long[k] * (ratio ** (-2 / 3) - ratio ** (1 / 3)))
            axis[g] = long
            g += 1


@njit(cache=True)
def nfw_radius(share: float, concentration: float) -> float:
    """Return the radius over r_200 within which an NFW halo has this share (0 to 1) of its mass.

    With w = 1 / (1 + y) the mass is m = w - ln(w) - 1; Newton's steps from below rise to the root.
    """
    m = share * (math.log1p(concentration) - concentration / (1 + concentration))
    w = max(1 - math.sqrt(2 * m), math.exp(-m - 1))
    for _ in range(_NEWTON):
        step = (w - math.log(w) - 1 - m) * w / (1 - w) if w < 1 else 0.0
        w += step
        if step <= 1e-12 * w:
            break
    return (1 / w - 1) / concentration


@njit(cache=True)
def _normal(key: np.uint64, counter: np.uint64) -> float:
    """A normal deviate of two words."""
    radius = math.sqrt(-2 * math.log(unit(word(key, counter))))
    return radius * math.cos(2 * math.pi * unit(word(key, counter + _ONE)))


@njit(cache=True)
def _direction(key: np.uint64, counter: np.uint64, out: FloatArray) -> np.uint64:
    """Fill a random unit vector of two words; return the counter advanced."""
    out[2] = 2 * unit(word(key, counter)) - 1
    angle = 2 * math.pi * unit(word(key, counter + _ONE))
    flat = math.sqrt(1 - out[2] ** 2)
    out[0], out[1] = flat * math.cos(angle), flat * math.sin(angle)
    return counter + np.uint64(2)


@njit(cache=True)
def _at(table: FloatArray, t: float) -> float:
    """Linear interpolation at index t, held at the ends."""
    k = min(max(int(t), 0), len(table) - 2)
    return table[k] + min(max(t - k, 0.0), 1.0) * (table[k + 1] - table[k])


_above = _at  # cumulative numbers above a proxy


@njit(cache=True)
def _where(table: FloatArray, number: float, lowest: float) -> float:
    """Return the index above `lowest` at which a falling table is `number`."""
    low = int(lowest)
    high = len(table) - 1
    while high - low > 1:
        middle = (low + high) // 2
        if table[middle] >= number:
            low = middle
        else:
            high = middle
    fall = table[low] - table[high]
    return max(low + (table[low] - number) / fall, lowest) if fall > 0 else float(low)
