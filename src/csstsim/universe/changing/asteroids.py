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


class Population(NamedTuple):
    """The cells of a population and the number of asteroids in each."""

    count: IntArray  # type: ignore[assignment]  # (cells,) int64; hides a method that nobody needs
    cells: FloatArray  # (cells, 6): a [au] first and last, e first and last, Rayleigh width of i [rad], zone
    bright: FloatArray  # (cells,) mag, the faintest H
    # H and log10 of the numbers, at whose ends the slopes hold: (H, log N, bright, faint)
    counts: tuple[FloatArray, FloatArray, float, float]
    limit: float  # mag, faintest V
    slope: float  # G


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
    law = np.array(counts["H"], float), log, float(counts["bright"]), float(counts["faint"])
    cells = []
    expected = []
    faintest = []
    for k, (first, last) in enumerate(zones["a"]):
        edges_a = np.linspace(first, last, _STEPS_A + 1)
        edges_e = np.linspace(0, zones["e_max"], _STEPS_E + 1)
        below = 1 - np.exp(-0.5 * (edges_e / zones["e"][k]) ** 2)
        share_e = np.diff(below) / below[-1]
        for a0, a1 in pairwise(edges_a):
            for j in range(_STEPS_E):
                q = a0 * (1 - edges_e[j + 1])  # nearest to the Sun, and to the Earth at opposition
                h = limit - 5 * np.log10(q * max(q - 1.017, 0.05))
                cells.append((a0, a1, edges_e[j], edges_e[j + 1], np.radians(zones["i"][k]), k))
                faintest.append(h)
                expected.append(zones["share"][k] / _STEPS_A * share_e[j] * 10 ** _log_number(h, *law))
    count = np.round(expected).astype(np.int64)
    slope = float(numbers["phase_slope"])
    return Population(count, np.array(cells), np.array(faintest), law, limit, slope)


def _log_number(h: Floats, points: FloatArray, log: FloatArray, bright: float, faint: float) -> FloatArray:
    """Return log10 of the number of asteroids brighter than H."""
    inside = np.interp(h, points, log)
    return inside + bright * np.minimum(h - points[0], 0) + faint * np.maximum(h - points[-1], 0)


def asteroids_near(
    seed: int,
    mjd: float,
    sun: Sequence[float] | FloatArray,
    direction: Sequence[float] | FloatArray,
    radius: float,
    numbers: Mapping[str, Any],
) -> dict[str, AnyArray]:
    """Return {name: (n,)} of the asteroids within `radius` [rad] of a direction, as seen by an observer.

    mjd: TDB (TT will do); sun (3,): the observer's place from the Sun [au] on axes of the ICRS; direction (3,): unit
    vector. id: number of the asteroid; vector (n, 3): astrometric direction (light time included) on axes of the ICRS;
    V [mag]; H; a [au], e, i [rad]; orbit (6, n): see `positions`; zone.
    """
    people = population(numbers)
    o, c = (_to_ecliptic(np.asarray(v, float)) for v in (sun, direction))
    longitude, least_i, wide = _window(o, c, radius)
    key = counter_key(seed, "asteroids")
    room = 4096
    while True:
        found = np.empty((room, 8))
        size = _search(
            key, people.count, people.cells, people.bright, *people.counts, mjd - EPOCH, o, c,
            radius + 120.0 / ARCSEC_PER_RAD, longitude, wide, least_i, people.limit, found,
        )  # fmt: skip
        if size <= room:
            break
        room = 2 * size
    number, a, e, i, node, peri, anomaly, h = found[:size].T
    orbit = a, e, i, node, peri, anomaly
    seen, v = observed(orbit, h, mjd, o, people.slope)
    near = (seen @ c >= np.cos(radius)) & (v <= people.limit)
    return {
        "id": number[near].astype(np.int64),
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
    """Return (directions (n, 3) on axes of the ICRS, V) of orbits (6, n) from a place (3,) [au from the Sun, ICRS]."""
    seen, v = observed(orbit, h, mjd, _to_ecliptic(np.asarray(sun, float)), slope)
    return _to_equator(seen), v


def observed(
    orbit: Sequence[FloatArray] | FloatArray, h: FloatArray, mjd: float, o: FloatArray, slope: float
) -> tuple[FloatArray, FloatArray]:
    """Return (unit vectors (n, 3), V) of orbits from a place o [au from the Sun], ecliptic axes, with light time."""
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
    """Return places (n, 3) [au from the Sun], ecliptic axes, of orbits days after EPOCH.

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


def _window(o: FloatArray, c: FloatArray, radius: float) -> tuple[float, float, float]:
    """Return (longitude, least inclination, half width) [rad] of asteroids on a line of sight, seen from the Sun."""
    r = np.linspace(_NEAREST, _FURTHEST, 64)
    along = -(o @ c) + np.sqrt(np.maximum((o @ c) ** 2 - o @ o + r**2, 0.0))
    place = o + along[:, None] * c
    away = along[:, None] * radius / r[:, None]  # by which the edge of the field is off, as seen from the Sun
    latitude = np.abs(np.arcsin(np.clip(place[:, 2] / r, -1, 1))) - away[:, 0]
    longitude = np.arctan2(place[:, 1], place[:, 0])
    middle = longitude[len(r) // 2]
    off = np.abs((longitude - middle + np.pi) % (2 * np.pi) - np.pi)
    high_up = np.abs(place[:, 2] / r).max() > 0.8
    return middle, max(latitude.min(), 0.0), np.pi if high_up else off.max() + 2 * away.max() + _SLACK


@numba.njit(cache=True)
def _search(
    key: np.uint64,
    count: IntArray,
    cells: FloatArray,
    faintest: FloatArray,
    points: FloatArray,
    log: FloatArray,
    bright: float,
    faint: float,
    days: float,
    o: FloatArray,
    c: FloatArray,
    radius: float,
    longitude: float,
    wide: float,
    least_i: float,
    limit: float,
    out: FloatArray,
) -> int:
    """Write the asteroids near a direction, as far as there is room; return how many there are."""
    size = 0
    number = 0
    turn = 2 * np.pi
    cosine = np.cos(radius)
    for k in range(len(count)):
        a0 = cells[k, 0]
        a1 = cells[k, 1]
        e0 = cells[k, 2]
        e1 = cells[k, 3]
        width = cells[k, 4]
        reach = wide + 2 * e1 + 1.25 * e1 * e1
        most = _number(faintest[k], points, log, bright, faint)
        for _ in range(count[k]):
            own = word(key, np.uint64(number))
            number += 1
            one = word(own, np.uint64(0))
            a = a0 + (a1 - a0) * high(one)
            mean = turn * low(one) + _GAUSS * a**-1.5 * days
            off = abs((mean - longitude + np.pi) % turn - np.pi)
            if off > reach:
                continue
            two = word(own, np.uint64(1))
            three = word(own, np.uint64(2))
            i = width * np.sqrt(-2.0 * np.log(high(two)))
            if i < least_i or i > 1.2:
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
            h = _magnitude(most + np.log10(high(four)), points, log, bright, faint)
            r = np.sqrt(px * px + py * py + pz * pz)
            if h + 5 * np.log10(r * distance) > limit + 0.05:
                continue
            if size < len(out):
                row = out[size]
                row[0] = number - 1
                row[1] = a
                row[2] = e
                row[3] = i
                row[4] = node
                row[5] = peri
                row[6] = anomaly - _GAUSS * a**-1.5 * days
                row[7] = h
            size += 1
    return size


@numba.njit(cache=True)
def _number(h: float, points: FloatArray, log: FloatArray, bright: float, faint: float) -> float:
    """As _log_number, of one H."""
    if h <= points[0]:
        return log[0] + bright * (h - points[0])
    if h >= points[-1]:
        return log[-1] + faint * (h - points[-1])
    return np.interp(h, points, log)


@numba.njit(cache=True)
def _magnitude(number: float, points: FloatArray, log: FloatArray, bright: float, faint: float) -> float:
    """The inverse of _number: the H of which so many (log10) are brighter."""
    if number <= log[0]:
        return points[0] + (number - log[0]) / bright
    if number >= log[-1]:
        return points[-1] + (number - log[-1]) / faint
    return np.interp(number, log, points)


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
