"""Compact stellar evolution: (mass, [Fe/H], stage) to Teff, log g, radius and M_V, and the stage at an age.

    stage s: 0-1 main sequence, 1-2 to the base of the giant branch, 2-3 giant branch, 3-4 clump or horizontal branch

s is linear in time within each of the four. Lifetimes follow Hurley, Pols & Tout (2000). The main sequence follows the
field dwarfs of Pecaut & Mamajek (2013), taken to be at their mean age; later stages are straight lines in
log Teff - log L between anchors. White dwarfs cool at constant radius. Numbers: config/universe/stars.yaml. Left out:
pre-main sequence, brown dwarfs' cooling, the asymptotic giant branch, mass loss before the white dwarf.
"""

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from csstsim.base.types import FloatArray, Floats

STAGES = 4
_YEAR_GYR = 1e9


class Observed(NamedTuple):
    """Quantities of stars (n,): Teff [K], log g, radius [Rsun], M_V."""

    teff: FloatArray
    logg: FloatArray
    radius: FloatArray
    m_v: FloatArray


class WhiteDwarfs(NamedTuple):
    """White dwarfs (n,): Teff [K], log g, radius [Rsun], M_V, mass [Msun]."""

    teff: FloatArray
    logg: FloatArray
    radius: FloatArray
    m_v: FloatArray
    mass: FloatArray


def stage_ends(mass: FloatArray, feh: FloatArray, numbers: Mapping[str, Any]) -> FloatArray:
    """Return (4, n) ages [Gyr] at which stars of `mass` [Msun] and [Fe/H] end each stage."""
    law = numbers["lifetime"]
    course = numbers["course"]
    zeta = np.clip(feh, *law["limits"])
    a1, a2, a3, a4, a5 = (c[0] + zeta * (c[1] + zeta * (c[2] + zeta * c[3])) for c in law["rows"])
    base = (a1 + a2 * mass**4 + a3 * mass**5.5 + mass**7) / (a4 * mass**2 + a5 * mass**7) / 1000.0
    main = _by_mass(course, "main", mass)
    giant = _by_mass(course, "giant", mass)
    helium = _by_mass(course, "helium", mass)
    return base * np.stack([main, np.ones_like(main), 1.0 + giant, 1.0 + giant + helium])


def living(
    mass: FloatArray, feh: FloatArray, stage: FloatArray, deviate: FloatArray, numbers: Mapping[str, Any]
) -> Observed:
    """Return the Observed of stars at `stage`; all (n,).

    deviate: (n,) within 0..1, the star's position on the horizontal branch.
    """
    feh = np.clip(feh, *numbers["metals"]["limits"])
    log_t, log_l = _main(mass, feh, np.minimum(stage, 1.0), numbers)
    later = stage > 1
    if later.any():
        part = (mass[later], feh[later], stage[later], deviate[later])
        log_t[later], log_l[later] = _after(log_t[later], log_l[later], *part, numbers)
    return _observed(mass, 10**log_t, log_l, correction(10**log_t, feh, numbers), numbers)


def white_dwarfs(initial_mass: FloatArray, cooling_gyr: FloatArray, numbers: Mapping[str, Any]) -> WhiteDwarfs:
    """Return the WhiteDwarfs that have cooled for `cooling_gyr`."""
    law = numbers["white_dwarfs"]
    slope, start = law["final_mass"]
    mass = slope * initial_mass + start
    log_age, teff = np.asarray(law["cooling"], float).T
    at = np.log10(np.maximum(cooling_gyr, 1e-6) * _YEAR_GYR * 0.6 / mass)
    teff = np.exp(np.interp(at, log_age, np.log(teff)))
    scale, limit = law["radius"]
    x = (mass / limit) ** (2 / 3)
    radius = scale * np.sqrt(1 / x - x)
    log_l = 2 * np.log10(radius) + 4 * np.log10(teff / numbers["solar"][1])
    knots, correction = np.asarray(law["correction"], float).T
    bc = np.interp(np.log(teff), np.log(knots), correction)
    return WhiteDwarfs(*_observed(mass, teff, log_l, bc, numbers), mass)


def correction(teff: Floats, feh: Floats, numbers: Mapping[str, Any]) -> FloatArray:
    """Return BC_V = M_bol - M_V [mag] at `teff` [K]: that of the main sequence, plus the change with [Fe/H]."""
    _, knots, log_l, m_v = np.asarray(numbers["main_sequence"], float).T
    solar = np.interp(np.log(teff), np.log(knots), numbers["solar"][0] - 2.5 * log_l - m_v)
    metals = numbers["blanketing"]
    slope = np.interp(np.log(teff), np.log(metals["teff"]), metals["per_dex"])
    return solar - slope * np.clip(feh, *metals["limits"])


def _observed(
    mass: FloatArray, teff: FloatArray, log_l: FloatArray, bc: FloatArray, numbers: Mapping[str, Any]
) -> Observed:
    m_bol, t_sun, logg_sun = numbers["solar"]
    radius = np.sqrt(10**log_l) * (t_sun / teff) ** 2
    logg = logg_sun + np.log10(mass) - 2 * np.log10(radius)
    return Observed(teff, logg, radius, m_bol - 2.5 * log_l - bc)


def _main(
    mass: FloatArray, feh: FloatArray, u: FloatArray, numbers: Mapping[str, Any]
) -> tuple[FloatArray, FloatArray]:
    """Return log Teff and log L on the main sequence at the fraction u of its life."""
    table = np.asarray(numbers["main_sequence"], float).T
    law = numbers["main"]
    x = np.log(mass)
    # Field stars have solar abundance on average and are at their mean age.
    mean_u = np.minimum(law["mean_age"] / stage_ends(mass, np.zeros_like(mass), numbers)[0], law["mean_share"])
    (b1, b2), (w1, w2) = law["brighten"], law["warm"]
    dl = _by_mass(numbers["metals"], "log_l", mass)
    dt = _by_mass(numbers["metals"], "log_teff", mass)
    cooling = _by_mass(numbers["course"], "cooling", mass)
    du = u - mean_u
    du2 = u**2 - mean_u**2
    log_l = np.interp(x, np.log(table[0]), table[2]) + b1 * du + b2 * du2 + dl * feh
    log_t = np.interp(x, np.log(table[0]), np.log10(table[1])) + w1 * du + (w2 - cooling) * du2 + dt * feh
    return log_t, log_l


def _after(
    turn_t: FloatArray,
    turn_l: FloatArray,
    mass: FloatArray,
    feh: FloatArray,
    stage: FloatArray,
    deviate: FloatArray,
    numbers: Mapping[str, Any],
) -> tuple[FloatArray, FloatArray]:
    """Return log Teff and log L beyond the turn-off (turn_t, turn_l)."""
    law = numbers["giant"]
    step = _by_mass(numbers["course"], "crossing", mass) + numbers["main"]["crossing_per_dex"] * np.minimum(feh, 0.0)
    base = turn_l + step
    tip = np.maximum(_by_mass(numbers["course"], "tip", mass), base + 0.1)
    f = np.clip(stage - 2.0, 0.0, 1.0)
    low = 10 ** (law["slope"] * base)
    high = 10 ** (law["slope"] * tip)
    branch_l = np.log10(low + f * (high - low)) / law["slope"]
    branch_t = _giant_teff(branch_l, mass, feh, law)
    across = np.clip(stage - 1.0, 0.0, 1.0)
    log_l = np.where(stage < 2, turn_l + across * step, branch_l)
    log_t = np.where(stage < 2, turn_t + across**2 * (_giant_teff(base, mass, feh, law) - turn_t), branch_t)
    clump_t, clump_l = _helium(mass, feh, deviate, numbers["helium"])
    return np.where(stage < 3, log_t, clump_t), np.where(stage < 3, log_l, clump_l)


def _giant_teff(log_l: FloatArray, mass: FloatArray, feh: FloatArray, law: Mapping[str, Any]) -> FloatArray:
    return np.interp(log_l, law["log_l"], law["log_teff"]) + law["per_dex"] * feh + law["per_log_mass"] * np.log10(mass)


def _helium(
    mass: FloatArray, feh: FloatArray, deviate: FloatArray, law: Mapping[str, Any]
) -> tuple[FloatArray, FloatArray]:
    (level, slope), (log_t, per_dex) = law["log_l"], law["log_teff"]
    log_l = level + slope * np.maximum(np.log10(mass / 2.2), 0.0)
    blue = law["blue_per_dex"] * np.maximum(law["blue"] - feh, 0.0) * deviate
    return log_t + per_dex * feh + law["spread"] * (2 * deviate - 1) + blue, log_l


def _by_mass(course: Mapping[str, Any], name: str, mass: FloatArray) -> FloatArray:
    return np.interp(np.log(mass), np.log(course["mass"]), course[name])
