"""Companions of stars: close ones add their light, wide ones are stars of their own.

A star of mass m has one companion with probability share(m). Its mass is q m with dN / dq ~ q^gamma(m) from q = 0.1 to
1, its orbit's semi-major axis a is lognormal, and its age and [Fe/H] are those of the star. It is seen at
a sqrt(1 - u^2) / d, u even in 0..1: a circular orbit of random tilt. Numbers: `binaries` of config/universe/stars.yaml.
Left out: third stars, companions of white dwarfs and of the catalogued bright stars, brown dwarfs, orbital motion,
companions that have left the main sequence, interaction.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np
from scipy.special import ndtr, ndtri

from csstsim.base.healpix import HATS_ORDER, ORDER, pixel_centre, pixel_towards
from csstsim.base.types import AnyArray, BoolArray, FloatArray, IntArray
from csstsim.universe.stars.stellar_evolution import living, stage_ends

PAIR = ("share", "m_v", "teff", "logg", "stellarmass", "radius", "log_a", "spread")  # of the companion; log10 of au
OWN = PAIR[2:6]
_LEAST_RATIO = 0.1
_ARCSEC_DEG = 3600.0


def companions(
    generator: np.random.Generator, mass: FloatArray, feh: FloatArray, age: FloatArray, numbers: Mapping[str, Any]
) -> FloatArray:
    """Return (PAIR, n): a possible companion of each star of `mass` [Msun], [Fe/H] and age [Gyr].

    Its `share` is the probability that it exists; 0 where it would be no star.
    """
    law = numbers["binaries"]["laws"]
    x = np.log(mass)
    at = {name: np.interp(x, np.log(law["mass"]), law[name]) for name in ("share", "gamma", "log_a", "spread")}
    power = at["gamma"] + 1.0
    low = _LEAST_RATIO**power
    second = mass * (low + generator.random(len(mass)) * (1.0 - low)) ** (1.0 / power)
    star = second >= numbers["masses"][0]
    second = np.maximum(second, numbers["masses"][0])
    stage = np.minimum(age / stage_ends(second, feh, numbers)[0], 1.0)
    teff, logg, radius, m_v = living(second, feh, stage, np.zeros_like(second), numbers)
    return np.stack([at["share"] * star, m_v, teff, logg, second, radius, at["log_a"], at["spread"]])


def separations(u: FloatArray, tilt: FloatArray, pair: FloatArray, distance: FloatArray, widest: float) -> FloatArray:
    """Return separations [arcsec] on the sky of pairs (PAIR, n) at `distance` [pc], none wider than `widest` [au].

    u, tilt: (n,) even in 0..1, the quantile of the semi-major axis and the cosine of the orbit's tilt.
    """
    log_a = pair[6]
    spread = pair[7]
    most = ndtr((np.log10(widest) - log_a) / np.maximum(spread, 1e-3))  # 0 where there is no companion
    return 10.0 ** (log_a + spread * ndtri(u * most)) * np.sqrt(1.0 - tilt**2) / distance


def join(columns: dict[str, AnyArray], pair: FloatArray, separation: FloatArray, numbers: Mapping[str, Any]) -> None:
    """Add teff2, logg2 and area2 (squared ratio of the radii) of companions within `resolved`; 0 where there is none.

    columns: of stars; pair: (PAIR, n); separation: (n,) arcsec, inf for a star without companion. One that gives less
    than `faintest` of a star's light (of all wavelengths) is left out.
    """
    law = numbers["binaries"]
    area = (pair[5] / columns["radius"]) ** 2
    close = (separation <= law["resolved"]) & (area * (pair[2] / columns["teff"]) ** 4 >= law["faintest"])
    for name, values in (("teff2", pair[2]), ("logg2", pair[3]), ("area2", area)):
        columns[name] = np.where(close, values, 0.0)


def wide(
    columns: Mapping[str, AnyArray],
    pair: FloatArray,
    separation: FloatArray,
    turn: FloatArray,
    pix: int,
    seen: BoolArray,
    numbers: Mapping[str, Any],
) -> dict[str, AnyArray]:
    """Return the columns of the companions beyond `resolved` that are `seen`, as stars of their own; see `join`.

    turn: (n,) even in 0..1, their directions. A companion that would stand beyond its brick's border stands on the
    other side of its star; if that is beyond, too, it stands at the star.
    """
    rows = np.flatnonzero((separation > numbers["binaries"]["resolved"]) & np.isfinite(separation) & seen)
    new = {name: values[rows] for name, values in columns.items()}
    new |= dict(zip(OWN, pair[2:6, rows], strict=True))
    new |= {name: np.zeros(len(rows)) for name in ("teff2", "logg2", "area2")}
    for sign in (-1.0, 1.0):  # the wanted side last
        healpix = _beside(columns, rows, sign * separation[rows], turn[rows])
        inside = healpix >> 2 * (HATS_ORDER - ORDER) == pix
        new["_healpix_29"] = np.where(inside, healpix, new["_healpix_29"])
    new["ra"], new["dec"] = pixel_centre(1 << HATS_ORDER, new["_healpix_29"])
    return new


def _beside(columns: Mapping[str, AnyArray], rows: IntArray, separation: FloatArray, turn: FloatArray) -> IntArray:
    """Return the order-29 pixels at `separation` [arcsec] from stars, in the directions turn x 360 deg."""
    ra = np.radians(columns["ra"][rows])
    dec = np.radians(columns["dec"][rows])
    east = np.stack([-np.sin(ra), np.cos(ra), np.zeros_like(ra)])
    north = np.stack([-np.sin(dec) * np.cos(ra), -np.sin(dec) * np.sin(ra), np.cos(dec)])
    up = np.stack([np.cos(dec) * np.cos(ra), np.cos(dec) * np.sin(ra), np.sin(dec)])
    angle = 2.0 * np.pi * turn
    there = up + np.radians(separation / _ARCSEC_DEG) * (np.cos(angle) * north + np.sin(angle) * east)
    return pixel_towards(1 << HATS_ORDER, there.T)
