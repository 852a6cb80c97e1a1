"""Companions of stars: close ones add their flux to the star, wide ones become further stars.

A star of mass m has one companion with a probability that depends on m. Its mass is q m with dN / dq ~ q^gamma(m) from
q = 0.1 to 1, its orbit's semi-major axis a is lognormal, and its age and [Fe/H] are those of the star. Its separation
on the sky is a sqrt(1 - u^2) / d with u uniform in 0..1: a circular orbit of random tilt. Numbers: `binaries` of
config/universe/stars.yaml.
Left out: third stars, companions of white dwarfs and of the catalogued bright stars, brown dwarfs, orbital motion,
companions that have left the main sequence, interaction.
"""

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from scipy.special import ndtr, ndtri

from csstsim.base.healpix import HATS_ORDER, ORDER, pixel_centre, pixel_towards
from csstsim.base.types import AnyArray, BoolArray, FloatArray, IntArray
from csstsim.universe.stars.stellar_evolution import living, stage_ends

_STAR_COLUMNS = ("teff", "logg", "stellarmass", "radius")
_RATIO_MIN = 0.1  # of the masses
_ARCSEC_DEG = 3600.0


class Companions(NamedTuple):
    """The rows of an array (8, n) of possible companions of stars: `Companions(*array)` gives each its name.

    probability: that the companion exists, 0 where it would be no star; m_v; teff [K]; logg; stellarmass [Msun]; radius
    [Rsun]; log_a, spread: mean and standard deviation of log10 of the semi-major axis [au].
    """

    probability: FloatArray
    m_v: FloatArray
    teff: FloatArray
    logg: FloatArray
    stellarmass: FloatArray
    radius: FloatArray
    log_a: FloatArray
    spread: FloatArray


def companions(
    generator: np.random.Generator, mass: FloatArray, feh: FloatArray, age: FloatArray, numbers: Mapping[str, Any]
) -> FloatArray:
    """Return rows of Companions (8, n): a possible companion of each star of `mass` [Msun], [Fe/H] and age [Gyr]."""
    table = numbers["binaries"]["laws"]
    x = np.log(mass)
    law = {name: np.interp(x, np.log(table["mass"]), table[name]) for name in ("share", "gamma", "log_a", "spread")}
    power = law["gamma"] + 1.0
    low = _RATIO_MIN**power
    second = mass * (low + generator.random(len(mass)) * (1.0 - low)) ** (1.0 / power)
    is_star = second >= numbers["masses"][0]
    second = np.maximum(second, numbers["masses"][0])
    stage = np.minimum(age / stage_ends(second, feh, numbers)[0], 1.0)
    observed = living(second, feh, stage, np.zeros_like(second), numbers)
    return np.stack(
        Companions(
            probability=law["share"] * is_star,
            m_v=observed.m_v,
            teff=observed.teff,
            logg=observed.logg,
            stellarmass=second,
            radius=observed.radius,
            log_a=law["log_a"],
            spread=law["spread"],
        )
    )


def separations(u: FloatArray, tilt: FloatArray, pair: FloatArray, distance: FloatArray, widest: float) -> FloatArray:
    """Return separations [arcsec] on the sky of pairs at `distance` [pc], none wider than `widest` [au].

    u, tilt (n,): uniform in 0..1, the quantile of the semi-major axis and the cosine of the orbit's tilt; pair: rows of
    Companions (8, n).
    """
    companion = Companions(*pair)
    quantile_max = ndtr((np.log10(widest) - companion.log_a) / np.maximum(companion.spread, 1e-3))  # 0: no companion
    log_a = companion.log_a + companion.spread * ndtri(u * quantile_max)
    return 10.0**log_a * np.sqrt(1.0 - tilt**2) / distance


def join(columns: dict[str, AnyArray], pair: FloatArray, separation: FloatArray, numbers: Mapping[str, Any]) -> None:
    """Add teff2, logg2 and area2 (squared ratio of the radii) of companions within `resolved`; 0 where there is none.

    columns: of stars; pair: rows of Companions (8, n); separation (n,) [arcsec], inf for a star without companion. A
    companion is left out if its bolometric flux is less than `faintest` times the star's.
    """
    law = numbers["binaries"]
    companion = Companions(*pair)
    area = (companion.radius / columns["radius"]) ** 2
    close = (separation <= law["resolved"]) & (area * (companion.teff / columns["teff"]) ** 4 >= law["faintest"])
    for name, values in (("teff2", companion.teff), ("logg2", companion.logg), ("area2", area)):
        columns[name] = np.where(close, values, 0.0)


def wide(
    columns: Mapping[str, AnyArray],
    pair: FloatArray,
    separation: FloatArray,
    turn: FloatArray,
    pix: int,
    selected: BoolArray,
    numbers: Mapping[str, Any],
) -> dict[str, AnyArray]:
    """Return the columns of the companions beyond `resolved` that are `selected` (n,), as further stars; see `join`.

    turn (n,): uniform in 0..1, their directions. If a companion's position is beyond its brick's border, it moves to
    the other side of its star, and if that is beyond the border, too, to the star.
    """
    rows = np.flatnonzero((separation > numbers["binaries"]["resolved"]) & np.isfinite(separation) & selected)
    companion = Companions(*pair)
    new = {name: values[rows] for name, values in columns.items()}
    new |= {name: getattr(companion, name)[rows] for name in _STAR_COLUMNS}
    new |= {name: np.zeros(len(rows)) for name in ("teff2", "logg2", "area2")}
    for sign in (-1.0, 1.0):  # the side of `turn` last
        healpix = _pixels_at(columns, rows, sign * separation[rows], turn[rows])
        inside = healpix >> 2 * (HATS_ORDER - ORDER) == pix
        new["_healpix_29"] = np.where(inside, healpix, new["_healpix_29"])
    new["ra"], new["dec"] = pixel_centre(1 << HATS_ORDER, new["_healpix_29"])
    return new


def _pixels_at(columns: Mapping[str, AnyArray], rows: IntArray, separation: FloatArray, turn: FloatArray) -> IntArray:
    """Return the order-29 pixels at `separation` [arcsec] from stars, in the directions turn x 360 deg."""
    ra = np.radians(columns["ra"][rows])
    dec = np.radians(columns["dec"][rows])
    east = np.stack([-np.sin(ra), np.cos(ra), np.zeros_like(ra)])
    north = np.stack([-np.sin(dec) * np.cos(ra), -np.sin(dec) * np.sin(ra), np.cos(dec)])
    up = np.stack([np.cos(dec) * np.cos(ra), np.cos(dec) * np.sin(ra), np.sin(dec)])
    angle = 2.0 * np.pi * turn
    position = up + np.radians(separation / _ARCSEC_DEG) * (np.cos(angle) * north + np.sin(angle) * east)
    return pixel_towards(1 << HATS_ORDER, position.T)
