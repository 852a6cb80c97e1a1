"""Motions of stars: a velocity ellipsoid about the Galaxy's rotation, seen from the moving Sun.

    v = v_R e_R + (Vc s - sigma_U^2 / k + sigma_V n) e_phi + v_z e_z - (solar motion + Vc)

e_R and e_phi are those at the star's position; s is 1 for discs and 0 for the halo. Left out: vertex deviation, tilt,
the growth of the dispersions towards the centre, streams, binaries' orbits.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from csstsim.base.types import FloatArray
from csstsim.base.units import AU_KM, DAY_S, JULIAN_YEAR_DAYS
from csstsim.universe.stars.milky_way import GALACTIC

if TYPE_CHECKING:
    from csstsim.universe.stars.milky_way import Component

KM_S_PER_AU_YR = AU_KM / (JULIAN_YEAR_DAYS * DAY_S)


def galactic_velocity(
    component: Component, normal: FloatArray, position: FloatArray, numbers: Mapping[str, Any]
) -> FloatArray:
    """Return (3, n) heliocentric velocities [km/s] along the galactic axes.

    component: milky_way.Component; normal: (3, n) standard normal deviates; position: (3, n) galactic, kpc.
    """
    circular = numbers["circular"]
    r0 = numbers["sun"]["r0"]
    x = position[0] - r0
    y = position[1]
    r = np.maximum(np.hypot(x, y), 1e-9)
    drift = component.sigma_u**2 / numbers["drift"] if component.rotation == 1 else 0.0  # asymmetric drift of discs
    outward = component.sigma_u * normal[0]
    around = component.rotation * circular - drift + component.sigma_v * normal[1]
    motion = numbers["sun"]["motion"]
    return np.stack(
        [
            outward * x / r + around * y / r - motion[0],
            outward * y / r - around * x / r - motion[1] - circular,
            component.sigma_w * normal[2] - motion[2],
        ]
    )


class SkyMotion(NamedTuple):
    """Motions of stars (n,): pmra (with cos dec), pmdec [mas/yr], rv [km/s]."""

    pmra: FloatArray
    pmdec: FloatArray
    rv: FloatArray


def sky_motion(ra: FloatArray, dec: FloatArray, kpc: FloatArray, velocity: FloatArray) -> SkyMotion:
    """Return the SkyMotion of galactic velocities (3, n) [km/s] at ra, dec [deg] and a distance [kpc], each (n,)."""
    ra = np.radians(ra)
    dec = np.radians(dec)
    vx, vy, vz = np.einsum("ij,in->jn", GALACTIC, velocity)
    in_plane = vx * np.cos(ra) + vy * np.sin(ra)
    east = -vx * np.sin(ra) + vy * np.cos(ra)
    north = -in_plane * np.sin(dec) + vz * np.cos(dec)
    # v [km/s] at d [kpc]: v / 4.74 AU/yr, and 1 AU at 1 kpc is 1 mas.
    scale = 1.0 / (KM_S_PER_AU_YR * kpc)
    return SkyMotion(east * scale, north * scale, in_plane * np.cos(dec) + vz * np.sin(dec))
