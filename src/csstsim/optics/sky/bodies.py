"""Directions and brightness of the Sun, the Moon and the bright planets, seen from the spacecraft.

The Sun comes from catalog.astrometry.ephemeris; the Moon from ERFA's moon98 (Meeus 1998, 10"), shifted by the
spacecraft's parallax; planets from plan94, within arcminutes. Directions are geometric: light time and aberration (20")
do not matter for stray light. V magnitudes depend on distance and phase angle by the polynomials in sky.yaml.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from csstsim.base.sphere import angle, unit_vectors
from csstsim.base.units import AU_KM, DAY_S, EARTH_RADIUS_KM
from csstsim.catalog.astrometry.ephemeris import mjd_tt, observer
from csstsim.instrument.orbit import orbit_after

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from csstsim.base.types import FloatArray, Floats
    from csstsim.instrument.pointing import Pointing
    from csstsim.optics.sky.parameters import SkyNumbers

_MJD_ZERO = 2_400_000.5


@dataclass(frozen=True, eq=False)
class Bodies:
    """Unit vectors from the spacecraft, GCRS: the Sun (3,), the Moon (3,), planets (n, 3); V magnitudes."""

    sun: FloatArray
    sun_au: float
    moon: FloatArray
    moon_magnitude: float
    planets: FloatArray
    planet_magnitudes: FloatArray


def bodies(mjd: float, position: Sequence[float], velocity: Sequence[float], numbers: SkyNumbers) -> Bodies:
    """Return the Bodies at `mjd` (UTC) for a spacecraft at `position` [km], `velocity` [km/s], geocentric GCRS."""
    import erfa

    tt = mjd_tt(mjd)
    sun, sun_au = _sun(mjd, position, velocity)
    moon = _moon(tt, position)
    distance = np.linalg.norm(moon)
    phase = angle(-moon, sun_au * AU_KM * sun - moon)
    law = numbers.bodies.moon
    moon_magnitude = law.magnitude + _polynomial(law.phase, phase)
    moon_magnitude += 5.0 * math.log10(distance / law.distance_km * sun_au)
    planets = []
    magnitudes = []
    for number, bright, *phase_law, largest in numbers.bodies.planets:
        from_sun = erfa.plan94(_MJD_ZERO, tt, int(number))["p"]
        seen = from_sun + sun_au * sun
        near = np.linalg.norm(seen)
        far = np.linalg.norm(from_sun)
        planets.append(seen / near)
        turn = min(angle(seen, from_sun), largest)
        magnitudes.append(bright + 5.0 * math.log10(near * far) + _polynomial(phase_law, turn))
    return Bodies(sun, sun_au, moon / distance, float(moon_magnitude), np.array(planets), np.array(magnitudes))


def exposure_angles(
    ra: float, dec: float, mjd: float, position: Sequence[float], velocity: Sequence[float]
) -> dict[str, float]:
    """Return {"sun", "moon", "limb", "limb_sun"} [deg] of a boresight at ra, dec [deg].

    sun, moon: angle to the boresight; limb: boresight's angle from the Earth's limb, negative if the Earth is in the
    way; limb_sun: elevation of the Sun at the nearest point of that limb, negative at night.
    """
    boresight = unit_vectors(ra, dec)
    spacecraft = np.array(position, dtype=float)
    sun, _ = _sun(mjd, position, velocity)
    zenith = spacecraft / np.linalg.norm(spacecraft)
    across = boresight - (boresight @ zenith) * zenith
    across /= max(np.linalg.norm(across), 1e-300)
    radius = earth_radius(spacecraft)
    limb = np.sin(radius) * zenith + np.cos(radius) * across  # direction of the limb point from the Earth's centre
    return {
        "sun": float(angle(boresight, sun)),
        "moon": float(angle(boresight, _moon(mjd_tt(mjd), position))),
        "limb": float(angle(boresight, -spacecraft) - np.degrees(radius)),
        "limb_sun": float(90.0 - angle(limb, sun)),
    }


def angles_at_ends(pointing: Pointing) -> dict[str, float]:
    """Return {"sun_angle_start", "sun_angle_end", ...} [deg]: `exposure_angles` as an exposure begins and ends."""
    first = pointing.sat_position, pointing.sat_velocity
    ends = ("start", 0.0, first), ("end", pointing.exptime, orbit_after(*first, pointing.exptime))
    return {
        f"{name}_angle_{end}": value
        for end, after, orbit_state in ends
        for name, value in exposure_angles(
            pointing.ra, pointing.dec, pointing.mjd + after / DAY_S, *orbit_state
        ).items()
    }


def earth_radius(position: FloatArray) -> float:
    """Return the angular radius of the Earth [rad] from a `position` [km], geocentric."""
    return math.asin(min(EARTH_RADIUS_KM / float(np.linalg.norm(position)), 1.0))


def _sun(mjd: float, position: Sequence[float], velocity: Sequence[float]) -> tuple[FloatArray, float]:
    astrom = observer(mjd, tuple(position), tuple(velocity)).astrom
    return -np.array(astrom["eh"]), float(astrom["em"])


def _moon(tt: float, position: Sequence[float]) -> FloatArray:
    """The Moon from the spacecraft [km]."""
    import erfa

    return erfa.moon98(_MJD_ZERO, tt)["p"] * AU_KM - np.array(position, dtype=float)


def _polynomial(coefficients: Iterable[float], x: Floats) -> Floats:
    """Return the polynomial whose first coefficient is that of x; it has no constant term."""
    return sum(c * x ** (k + 1) for k, c in enumerate(coefficients))
