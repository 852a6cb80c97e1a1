"""The spacecraft's state if the survey table does not give it: a circular orbit whose node precesses due to J2.

Source: Vallado, Fundamentals of Astrodynamics, for the secular J2 rate of the node; altitude and inclination of the
Tiangong orbit, which CSST shares. The phase holds at a fixed epoch, so equal UTC times give equal states. Not modelled:
drag and reboosts, the J2 change of the argument of latitude, leap seconds, and the precession of the Earth's axis in
GCRS. So sizes and the statistics of directions are right, but the state is not an ephemeris.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, NamedTuple

from pydantic import AfterValidator

from csstsim.base.model import Data, Number, Positive
from csstsim.base.units import EARTH_GM_KM3_S2, EARTH_J2, EARTH_RADIUS_KM
from csstsim.instrument.pointing import mjd_utc

_DAY_S = 86_400.0


class OrbitState(NamedTuple):
    """Position [km] and velocity [km/s], geocentric GCRS."""

    position: tuple[float, float, float]
    velocity: tuple[float, float, float]


def _utc(text: str) -> str:
    mjd_utc(text)
    return text


@dataclass(frozen=True)
class Orbit(Data):
    """A circular orbit; `node` and `phase` (argument of latitude) hold at `epoch` (ISO UTC)."""

    altitude_km: Positive
    inclination: Number  # deg
    node: Number  # deg
    phase: Number  # deg
    epoch: Annotated[str, AfterValidator(_utc)]

    @property
    def radius_km(self) -> float:
        """Radius of the orbit, from the centre of the Earth [km]."""
        return EARTH_RADIUS_KM + self.altitude_km

    @property
    def mean_motion(self) -> float:
        """Mean motion [rad / s]."""
        return math.sqrt(EARTH_GM_KM3_S2 / self.radius_km**3)

    @property
    def node_rate(self) -> float:
        """Precession of the ascending node, rad / s (negative: westward)."""
        ratio = (EARTH_RADIUS_KM / self.radius_km) ** 2
        return -1.5 * EARTH_J2 * self.mean_motion * ratio * math.cos(math.radians(self.inclination))

    def state(self, time: str | float) -> OrbitState:
        """Return the OrbitState [km, km/s] at an ISO UTC time or an MJD."""
        mjd = mjd_utc(time) if isinstance(time, str) else float(time)
        t = (mjd - mjd_utc(self.epoch)) * _DAY_S
        u = math.radians(self.phase) + self.mean_motion * t
        node = math.radians(self.node) + self.node_rate * t
        inclination = math.radians(self.inclination)
        cu = math.cos(u)
        su = math.sin(u)
        cn = math.cos(node)
        sn = math.sin(node)
        ci = math.cos(inclination)
        si = math.sin(inclination)
        radial = (cn * cu - sn * su * ci, sn * cu + cn * su * ci, su * si)
        along = (-cn * su - sn * cu * ci, -sn * su + cn * cu * ci, cu * si)
        x, y, z = (self.radius_km * c for c in radial)
        # The precession of the node adds up to 8 m/s, so that velocity is the derivative of position
        drift = (-self.node_rate * y, self.node_rate * x, 0.0)
        speed = self.radius_km * self.mean_motion
        vx, vy, vz = (speed * a + d for a, d in zip(along, drift, strict=True))
        return OrbitState((x, y, z), (vx, vy, vz))


def orbit_after(position: Sequence[float], velocity: Sequence[float], seconds: float) -> OrbitState:
    """Return the OrbitState [km, km/s] `seconds` later, on the Kepler orbit around the Earth.

    Runge-Kutta steps of at most 10 s are accurate to a millimetre in an exposure. J2 (metres in 150 s) is not modelled.
    """
    steps = max(math.ceil(seconds / 10.0), 1)
    h = seconds / steps
    state = [float(c) for c in (*position, *velocity)]
    for _ in range(steps):
        k1 = _derivative(state)
        k2 = _derivative([a + h / 2 * b for a, b in zip(state, k1, strict=True)])
        k3 = _derivative([a + h / 2 * b for a, b in zip(state, k2, strict=True)])
        k4 = _derivative([a + h * b for a, b in zip(state, k3, strict=True)])
        state = [a + h / 6 * (p + 2 * q + 2 * r + s) for a, p, q, r, s in zip(state, k1, k2, k3, k4, strict=True)]
    x, y, z, vx, vy, vz = state
    return OrbitState((x, y, z), (vx, vy, vz))


def _derivative(state: Sequence[float]) -> list[float]:
    """Return the time derivative of a state (x, y, z, vx, vy, vz) [km, km/s]."""
    acceleration = -EARTH_GM_KM3_S2 / math.hypot(*state[:3]) ** 3
    return [*state[3:], *(acceleration * x for x in state[:3])]
