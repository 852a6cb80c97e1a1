"""Main-belt asteroids: orbits of a synthetic population, and those that an observer sees near a direction at an epoch.

Each asteroid is a number: seed and number give its orbit, an ellipse about the Sun that never changes, and its absolute
magnitude H. So an asteroid is where its orbit puts it, in every exposure and on every chip. The population is cut into
cells of semi-major axis and eccentricity. A cell holds the asteroids that can be brighter than the limit at all.
A search goes through all of them, and leaves most after two random numbers: their longitude is elsewhere.

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
# cells of a zone
_STEPS_A = 6
_STEPS_E = 12
_SLACK = np.radians(8.0)  # longitude in the orbit to longitude in the ecliptic, up to 40 deg of inclination
# au from the Sun
_NEAREST = 1.3
_FURTHEST = 5.2


_FOUND = np.dtype(
    [("number", np.int64)] + [(name, float) for name in ("a", "e", "i", "node", "perihelion", "anomaly", "h")]
)


class NumberLaw(NamedTuple):
    """Number of asteroids brighter than H: log10 at values of H (n,) [mag], and its slopes beyond the ends."""

    h: FloatArray
    log_number: FloatArray
    bright: float
    faint: float


class Population(NamedTuple):
    """The cells of a population (cells,): their limits in orbits, and the number of asteroids in each.

    a_min, a_max [au], e_min, e_max; inclination: Rayleigh width [rad]; faintest_h [mag]: of what can be seen at all;
    limit [mag]: faintest V; slope: G.
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
    """Where an observer is and looks, on ecliptic axes.

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
        edges_a = np.linspace(first, last, _STEPS_A + 1)
        edges_e = np.linspace(0, zones["e_max"], _STEPS_E + 1)
        below = 1 - np.exp(-0.5 * (edges_e / zones["e"][k]) ** 2)
        fraction = np.diff(below) / below[-1]
        for a0, a1 in pairwise(edges_a):
            for j in range(_STEPS_E):
                q = a0 * (1 - edges_e[j + 1])  # nearest to the Sun, and to the Earth at opposition
                h = limit - 5 * np.log10(q * max(q - 1.017, 0.05))
                cells.append((a0, a1, edges_e[j], edges_e[j + 1], np.radians(zones["i"][k])))
                zone.append(k)
                faintest.append(h)
                expected.append(zones["share"][k] / _STEPS_A * fraction[j] * 10 ** _log_number(h, law))
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

    mjd: TDB (TT will do); sun (3,): the observer's position from the Sun [au] on axes of the ICRS; direction (3,): unit
    vector. id: number of the asteroid; vector (n, 3): astrometric direction (light time included) on axes of the ICRS;
    V [mag]; H; a [au], e, i [rad]; orbit (6, n): see `positions`; zone.
    """
    people = population(numbers)
    position = _to_ecliptic(np.asarray(sun, float))
    line_of_sight = _to_ecliptic(np.asarray(direction, float))
    window = _window(position, line_of_sight, radius)
    view = View(mjd - EPOCH, position, line_of_sight, radius + 120.0 / ARCSEC_PER_RAD)
    key = counter_key(seed, "asteroids")
    room = 4096
    while True:
        found = np.empty(room, _FOUND)
        size = _search(key, people, view, window, found)
        if size <= room:
            break
        room = 2 * size
    found = found[:size]
    a = found["a"]
    e = found["e"]
    i = found["i"]
    h = found["h"]
    orbit = a, e, i, found["node"], found["perihelion"], found["anomaly"]
    seen, v = observed(orbit, h, mjd, position, people.slope)
    near = (seen @ line_of_sight >= np.cos(radius)) & (v <= people.limit)
    return {
        "id": found["number"][near],
        "vector": _to_equator(seen[near]),
        "V": v[near],
        "H": h[near],
        "a": a[near],
        "e": e[near],
        "i": i[near],
        "orbit": np.stack(orbit)[:, near],
        "zone": np.searchsorted([zone[0] for zone in numbers["zones"]["a"]], a[near], side="right") - 1,
    }


def seen_from(
    orbit: Sequence[FloatArray] | FloatArray, h: FloatArray, mjd: float, sun: Sequence[float] | FloatArray, slope: float
) -> tuple[FloatArray, FloatArray]:
    """Return (directions (n, 3) on ICRS axes, V) of orbits (6, n) from a position (3,) [au from the Sun, ICRS]."""
    seen, v = observed(orbit, h, mjd, _to_ecliptic(np.asarray(sun, float)), slope)
    return _to_equator(seen), v


def observed(
    orbit: Sequence[FloatArray] | FloatArray, h: FloatArray, mjd: float, o: FloatArray, slope: float
) -> tuple[FloatArray, FloatArray]:
    """Return (unit vectors (n, 3), V) of orbits from a position o [au from the Sun], ecliptic axes, with light time."""
    delay = np.zeros(len(h))
    for _ in range(3):
        place = positions(orbit, mjd - EPOCH - delay)
        away = place - o
        distance = np.linalg.norm(away, axis=1)
        delay = distance / LIGHT_DAY_AU
    r = np.linalg.norm(place, axis=1)
    cosine = np.einsum("ni,ni->n", place, away) / (r * distance)
    return away / distance[:, None], h + 5 * np.log10(r * distance) + _phase(cosine, slope)


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


def _window(o: FloatArray, c: FloatArray, radius: float) -> Window:
    """Return the Window of a field of `radius` [rad] in direction c from o [au from the Sun], ecliptic axes."""
    r = np.linspace(_NEAREST, _FURTHEST, 64)
    along = -(o @ c) + np.sqrt(np.maximum((o @ c) ** 2 - o @ o + r**2, 0.0))
    place = o + along[:, None] * c
    away = along[:, None] * radius / r[:, None]  # by which the edge of the field is off, as seen from the Sun
    latitude = np.abs(np.arcsin(np.clip(place[:, 2] / r, -1, 1))) - away[:, 0]
    longitude = np.arctan2(place[:, 1], place[:, 0])
    middle = longitude[len(r) // 2]
    off = np.abs((longitude - middle + np.pi) % (2 * np.pi) - np.pi)
    high_up = np.abs(place[:, 2] / r).max() > 0.8
    half_width = np.pi if high_up else off.max() + 2 * away.max() + _SLACK
    return Window(middle, max(latitude.min(), 0.0), half_width)


@numba.njit(cache=True)
def _search(key: np.uint64, population: Population, view: View, window: Window, out: AnyArray) -> int:
    """Write the asteroids near a direction to `out` (_FOUND), as far as there is room; return how many there are."""
    o = view.position
    c = view.direction
    size = 0
    number = 0
    turn = 2 * np.pi
    cosine = np.cos(view.radius)
    for k in range(len(population.number)):
        a0 = population.a_min[k]
        a1 = population.a_max[k]
        e0 = population.e_min[k]
        e1 = population.e_max[k]
        width = population.inclination[k]
        reach = window.half_width + 2 * e1 + 1.25 * e1 * e1
        most = _number(population.faintest_h[k], population.law)
        for _ in range(population.number[k]):
            own = word(key, np.uint64(number))
            number += 1
            one = word(own, np.uint64(0))
            a = a0 + (a1 - a0) * high(one)
            mean = turn * low(one) + _GAUSS * a**-1.5 * view.days
            off = abs((mean - window.longitude + np.pi) % turn - np.pi)
            if off > reach:
                continue
            two = word(own, np.uint64(1))
            three = word(own, np.uint64(2))
            i = width * np.sqrt(-2.0 * np.log(high(two)))
            if i < window.inclination_min or i > 1.2:
                continue
            e = e0 + (e1 - e0) * low(two)
            # pole: longitude of the perihelion
            node = turn * high(three)
            pole = turn * low(three)
            anomaly = mean - pole
            peri = pole - node
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
            dx = px - o[0]
            dy = py - o[1]
            dz = pz - o[2]
            distance = np.sqrt(dx * dx + dy * dy + dz * dz)
            if dx * c[0] + dy * c[1] + dz * c[2] < cosine * distance:
                continue
            four = word(own, np.uint64(3))
            h = _magnitude(most + np.log10(high(four)), population.law)
            r = np.sqrt(px * px + py * py + pz * pz)
            if h + 5 * np.log10(r * distance) > population.limit + 0.05:
                continue
            if size < len(out):
                row = out[size]
                row.number = number - 1
                row.a = a
                row.e = e
                row.i = i
                row.node = node
                row.perihelion = peri
                row.anomaly = anomaly - _GAUSS * a**-1.5 * view.days
                row.h = h
            size += 1
    return size


@numba.njit(cache=True)
def _number(h: float, law: NumberLaw) -> float:
    """As _log_number, of one H."""
    if h <= law.h[0]:
        return law.log_number[0] + law.bright * (h - law.h[0])
    if h >= law.h[-1]:
        return law.log_number[-1] + law.faint * (h - law.h[-1])
    return np.interp(h, law.h, law.log_number)


@numba.njit(cache=True)
def _magnitude(number: float, law: NumberLaw) -> float:
    """The inverse of _number: the H of which so many (log10) are brighter."""
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
