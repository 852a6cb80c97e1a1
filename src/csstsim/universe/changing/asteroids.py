"""Main-belt asteroids: orbits of a synthetic population, and those that an observer sees near a direction at an epoch.

Each asteroid has a number. Seed and number determine its orbit, an ellipse about the Sun that never changes, and its
absolute magnitude H. So its positions are those of one orbit, in every exposure and on every chip. The population is
divided into cells of semi-major axis and eccentricity. A cell has the asteroids that can become brighter than the
limit. A search tests all of them, and most only by their longitude, which takes two random numbers.

Left out: perturbations by planets, rotation, families, other populations than the main belt and Hildas.
"""

from collections.abc import Mapping, Sequence
from functools import lru_cache
from itertools import pairwise
from typing import Any, NamedTuple

import numba
import numpy as np

from csstsim.base.counter import high, low, word
from csstsim.base.rng import counter_key
from csstsim.base.types import AnyArray, FloatArray, Floats, IntArray
from csstsim.base.units import ARCSEC_PER_RAD

OBLIQUITY = 84381.406 / ARCSEC_PER_RAD  # of the ecliptic, J2000 (IAU 2006)
_GAUSS = 0.01720209895  # rad / day, of a circular orbit of 1 au
LIGHT_DAY_AU = 173.144_632_67  # au / day
EPOCH = 61545.0  # MJD of the mean longitudes
# Cells of a zone, in semi-major axis and in eccentricity
_CELLS_A = 6
_CELLS_E = 12
_SLACK = np.radians(8.0)  # longitude in the orbit less that in the ecliptic, for inclinations up to 40 deg
# Distances from the Sun that are searched [au]
_DISTANCE_MIN = 1.3
_DISTANCE_MAX = 5.2


_ORBIT_ROW = np.dtype(
    [("number", np.int64)] + [(name, float) for name in ("a", "e", "i", "node", "perihelion", "anomaly", "h")]
)


class NumberLaw(NamedTuple):
    """log10 of the number of asteroids brighter than H, at values of H (n,) [mag], and its slopes beyond the ends."""

    h: FloatArray
    log_number: FloatArray
    bright: float
    faint: float


class Population(NamedTuple):
    """The cells of a population (cells,): the limits of their orbits, and the number of asteroids in each.

    a_min, a_max [au], e_min, e_max; inclination: Rayleigh width [rad]; faintest_h [mag]: largest H of an asteroid
    that can be brighter than the limit; limit [mag]: faintest V; slope: G.
    """

    number: IntArray
    a_min: FloatArray
    a_max: FloatArray
    e_min: FloatArray
    e_max: FloatArray
    inclination: FloatArray
    zone: IntArray
    faintest_h: FloatArray
    law: NumberLaw
    limit: float
    slope: float


class View(NamedTuple):
    """An observer's position and line of sight, on ecliptic axes.

    days: since EPOCH; position (3,) [au from the Sun]; direction (3,): unit vector; radius [rad]: of the field.
    """

    days: float
    position: FloatArray
    direction: FloatArray
    radius: float


class Window(NamedTuple):
    """Asteroids on a line of sight, from the Sun [rad]: middle and half width in longitude, minimum inclination."""

    longitude: float
    inclination_min: float
    half_width: float


def population(numbers: Mapping[str, Any]) -> Population:
    """Return the Population of the numbers of asteroids.yaml."""
    return _population(repr(numbers))


@lru_cache(4)
def _population(text: str) -> Population:
    import ast

    numbers = ast.literal_eval(text)
    zones = numbers["zones"]
    counts = numbers["counts"]
    limit = float(numbers["faintest"])
    log = np.array(counts["log_number"], float) + np.log10(counts["density"])
    law = NumberLaw(np.array(counts["H"], float), log, float(counts["bright"]), float(counts["faint"]))
    cells = []
    zone = []
    expected = []
    faintest = []
    for k, (first, last) in enumerate(zones["a"]):
        edges_a = np.linspace(first, last, _CELLS_A + 1)
        edges_e = np.linspace(0, zones["e_max"], _CELLS_E + 1)
        below = 1 - np.exp(-0.5 * (edges_e / zones["e"][k]) ** 2)
        fraction = np.diff(below) / below[-1]
        for a0, a1 in pairwise(edges_a):
            for j in range(_CELLS_E):
                q = a0 * (1 - edges_e[j + 1])  # nearest to the Sun, and to the Earth at opposition
                h = limit - 5 * np.log10(q * max(q - 1.017, 0.05))
                cells.append((a0, a1, edges_e[j], edges_e[j + 1], np.radians(zones["i"][k])))
                zone.append(k)
                faintest.append(h)
                expected.append(zones["share"][k] / _CELLS_A * fraction[j] * 10 ** _log_number(h, law))
    a_min, a_max, e_min, e_max, inclination = np.array(cells).T.copy()
    return Population(
        number=np.round(expected).astype(np.int64),
        a_min=a_min,
        a_max=a_max,
        e_min=e_min,
        e_max=e_max,
        inclination=inclination,
        zone=np.array(zone),
        faintest_h=np.array(faintest),
        law=law,
        limit=limit,
        slope=float(numbers["phase_slope"]),
    )


def _log_number(h: Floats, law: NumberLaw) -> FloatArray:
    """Return log10 of the number of asteroids brighter than H."""
    inside = np.interp(h, law.h, law.log_number)
    return inside + law.bright * np.minimum(h - law.h[0], 0) + law.faint * np.maximum(h - law.h[-1], 0)


def asteroids_near(
    seed: int,
    mjd: float,
    sun: Sequence[float] | FloatArray,
    direction: Sequence[float] | FloatArray,
    radius: float,
    numbers: Mapping[str, Any],
) -> dict[str, AnyArray]:
    """Return {name: (n,)} of the asteroids within `radius` [rad] of a direction, as seen by an observer.

    mjd: TDB (TT is as good); sun (3,): the observer's position relative to the Sun [au] on axes of the ICRS; direction
    (3,): unit vector. Names: id, number of the asteroid; vector (n, 3), astrometric direction (light time included) on
    axes of the ICRS; V, H [mag]; a [au], e, i [rad]; orbit (6, n), see `positions`; zone.
    """
    belt = population(numbers)
    position = _to_ecliptic(np.asarray(sun, float))
    line_of_sight = _to_ecliptic(np.asarray(direction, float))
    window = _window(position, line_of_sight, radius)
    view = View(mjd - EPOCH, position, line_of_sight, radius + 120.0 / ARCSEC_PER_RAD)
    key = counter_key(seed, "asteroids")
    capacity = 4096
    while True:
        found = np.empty(capacity, _ORBIT_ROW)
        count = _search(key, belt, view, window, found)
        if count <= capacity:
            break
        capacity = 2 * count
    found = found[:count]
    a = found["a"]
    e = found["e"]
    i = found["i"]
    h = found["h"]
    orbit = a, e, i, found["node"], found["perihelion"], found["anomaly"]
    directions, v = observed(orbit, h, mjd, position, belt.slope)
    inside = (directions @ line_of_sight >= np.cos(radius)) & (v <= belt.limit)
    return {
        "id": found["number"][inside],
        "vector": _to_equator(directions[inside]),
        "V": v[inside],
        "H": h[inside],
        "a": a[inside],
        "e": e[inside],
        "i": i[inside],
        "orbit": np.stack(orbit)[:, inside],
        "zone": np.searchsorted([zone[0] for zone in numbers["zones"]["a"]], a[inside], side="right") - 1,
    }


def seen_from(
    orbit: Sequence[FloatArray] | FloatArray, h: FloatArray, mjd: float, sun: Sequence[float] | FloatArray, slope: float
) -> tuple[FloatArray, FloatArray]:
    """Return directions (n, 3) on ICRS axes and V of orbits (6, n), seen from `sun`, as for `asteroids_near`."""
    directions, v = observed(orbit, h, mjd, _to_ecliptic(np.asarray(sun, float)), slope)
    return _to_equator(directions), v


def observed(
    orbit: Sequence[FloatArray] | FloatArray, h: FloatArray, mjd: float, observer: FloatArray, slope: float
) -> tuple[FloatArray, FloatArray]:
    """Return unit vectors (n, 3) and V of orbits (6, n), light time included.

    observer (3,): position [au from the Sun]. It and the vectors are on ecliptic axes.
    """
    delay = np.zeros(len(h))
    for _ in range(3):
        position = positions(orbit, mjd - EPOCH - delay)
        sight_line = position - observer
        distance = np.linalg.norm(sight_line, axis=1)
        delay = distance / LIGHT_DAY_AU
    r = np.linalg.norm(position, axis=1)
    cosine = np.einsum("ni,ni->n", position, sight_line) / (r * distance)
    return sight_line / distance[:, None], h + 5 * np.log10(r * distance) + _phase(cosine, slope)


def positions(orbit: Sequence[FloatArray] | FloatArray, days: Floats) -> FloatArray:
    """Return positions (n, 3) [au from the Sun], ecliptic axes, of orbits days after EPOCH.

    orbit: a [au], e, i, node, argument of perihelion, mean anomaly at EPOCH [rad], each (n,).
    """
    a, e, i, node, peri, anomaly = orbit
    mean = anomaly + _GAUSS * a**-1.5 * days
    eccentric = mean + e * np.sin(mean)
    for _ in range(8):
        eccentric = eccentric - (eccentric - e * np.sin(eccentric) - mean) / (1 - e * np.cos(eccentric))
    x = a * (np.cos(eccentric) - e)
    y = a * np.sqrt(1 - e**2) * np.sin(eccentric)
    u = x * np.cos(peri) - y * np.sin(peri)
    v = x * np.sin(peri) + y * np.cos(peri)
    w = v * np.cos(i)
    return np.stack([u * np.cos(node) - w * np.sin(node), u * np.sin(node) + w * np.cos(node), v * np.sin(i)], axis=1)


def _phase(cosine: FloatArray, slope: float) -> FloatArray:
    """Return the magnitudes by which phase dims, of the H, G system (Bowell et al. 1989)."""
    half = np.sqrt(np.maximum((1 - cosine) / (1 + cosine), 0.0))  # tan of half the phase angle
    return -2.5 * np.log10((1 - slope) * np.exp(-3.33 * half**0.63) + slope * np.exp(-1.87 * half**1.22))


def _window(observer: FloatArray, line_of_sight: FloatArray, radius: float) -> Window:
    """Return the Window of a field of `radius` [rad].

    observer (3,) [au from the Sun]; line_of_sight (3,): unit vector; both on ecliptic axes.
    """
    r = np.linspace(_DISTANCE_MIN, _DISTANCE_MAX, 64)
    towards = observer @ line_of_sight
    distance = -towards + np.sqrt(np.maximum(towards**2 - observer @ observer + r**2, 0.0))
    position = observer + distance[:, None] * line_of_sight
    half_field = distance[:, None] * radius / r[:, None]  # from the field's centre to its edge, seen from the Sun
    latitude = np.abs(np.arcsin(np.clip(position[:, 2] / r, -1, 1))) - half_field[:, 0]
    longitude = np.arctan2(position[:, 1], position[:, 0])
    middle = longitude[len(r) // 2]
    longitude_range = np.abs((longitude - middle + np.pi) % (2 * np.pi) - np.pi)
    near_pole = np.abs(position[:, 2] / r).max() > 0.8
    half_width = np.pi if near_pole else longitude_range.max() + 2 * half_field.max() + _SLACK
    return Window(middle, max(latitude.min(), 0.0), half_width)


@numba.njit(cache=True)
def _search(key: np.uint64, population: Population, view: View, window: Window, out: AnyArray) -> int:
    """Write the asteroids near a direction to `out` (_ORBIT_ROW), up to its length; return their number."""
    observer = view.position
    line_of_sight = view.direction
    count = 0
    number = 0
    turn = 2 * np.pi
    cosine = np.cos(view.radius)
    for k in range(len(population.number)):
        a0 = population.a_min[k]
        a1 = population.a_max[k]
        e0 = population.e_min[k]
        e1 = population.e_max[k]
        width = population.inclination[k]
        difference_max = window.half_width + 2 * e1 + 1.25 * e1 * e1
        log_number_max = _log_number_of(population.faintest_h[k], population.law)
        for _ in range(population.number[k]):
            asteroid_key = word(key, np.uint64(number))
            number += 1
            word0 = word(asteroid_key, np.uint64(0))
            a = a0 + (a1 - a0) * high(word0)
            mean = turn * low(word0) + _GAUSS * a**-1.5 * view.days
            difference = abs((mean - window.longitude + np.pi) % turn - np.pi)
            if difference > difference_max:
                continue
            word1 = word(asteroid_key, np.uint64(1))
            word2 = word(asteroid_key, np.uint64(2))
            i = width * np.sqrt(-2.0 * np.log(high(word1)))
            if i < window.inclination_min or i > 1.2:
                continue
            e = e0 + (e1 - e0) * low(word1)
            node = turn * high(word2)
            perihelion_longitude = turn * low(word2)
            anomaly = mean - perihelion_longitude
            peri = perihelion_longitude - node
            eccentric = anomaly + e * np.sin(anomaly)
            for _ in range(4):
                eccentric -= (eccentric - e * np.sin(eccentric) - anomaly) / (1 - e * np.cos(eccentric))
            x = a * (np.cos(eccentric) - e)
            y = a * np.sqrt(1 - e * e) * np.sin(eccentric)
            u = x * np.cos(peri) - y * np.sin(peri)
            v = x * np.sin(peri) + y * np.cos(peri)
            px = u * np.cos(node) - v * np.cos(i) * np.sin(node)
            py = u * np.sin(node) + v * np.cos(i) * np.cos(node)
            pz = v * np.sin(i)
            dx = px - observer[0]
            dy = py - observer[1]
            dz = pz - observer[2]
            distance = np.sqrt(dx * dx + dy * dy + dz * dz)
            if dx * line_of_sight[0] + dy * line_of_sight[1] + dz * line_of_sight[2] < cosine * distance:
                continue
            word3 = word(asteroid_key, np.uint64(3))
            h = _magnitude_of(log_number_max + np.log10(high(word3)), population.law)
            r = np.sqrt(px * px + py * py + pz * pz)
            if h + 5 * np.log10(r * distance) > population.limit + 0.05:
                continue
            if count < len(out):
                row = out[count]
                row.number = number - 1
                row.a = a
                row.e = e
                row.i = i
                row.node = node
                row.perihelion = peri
                row.anomaly = anomaly - _GAUSS * a**-1.5 * view.days
                row.h = h
            count += 1
    return count


@numba.njit(cache=True)
def _log_number_of(h: float, law: NumberLaw) -> float:
    """As _log_number, for one H."""
    if h <= law.h[0]:
        return law.log_number[0] + law.bright * (h - law.h[0])
    if h >= law.h[-1]:
        return law.log_number[-1] + law.faint * (h - law.h[-1])
    return np.interp(h, law.h, law.log_number)


@numba.njit(cache=True)
def _magnitude_of(number: float, law: NumberLaw) -> float:
    """Return the H for which `_log_number_of` is `number`."""
    if number <= law.log_number[0]:
        return law.h[0] + (number - law.log_number[0]) / law.bright
    if number >= law.log_number[-1]:
        return law.h[-1] + (number - law.log_number[-1]) / law.faint
    return np.interp(number, law.log_number, law.h)


def _to_ecliptic(v: FloatArray) -> FloatArray:
    cos = np.cos(OBLIQUITY)
    sin = np.sin(OBLIQUITY)
    x, y, z = np.moveaxis(v, -1, 0)
    return np.stack([x, cos * y + sin * z, cos * z - sin * y], axis=-1)


def _to_equator(v: FloatArray) -> FloatArray:
    cos = np.cos(OBLIQUITY)
    sin = np.sin(OBLIQUITY)
    x, y, z = np.moveaxis(v, -1, 0)
    return np.stack([x, cos * y - sin * z, cos * z + sin * y], axis=-1)
