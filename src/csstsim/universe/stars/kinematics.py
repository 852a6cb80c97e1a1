"""Motions of stars: a velocity ellipsoid about the Galaxy's rotation, seen from the moving Sun.

    v = v_R e_R + (Vc s - sigma_U^2 / k + sigma_V n) e_phi + v_z e_z - (solar motion + Vc)

e_R, e_phi are taken at the star's position; s is 1 for discs and 0 for the halo. Left out: vertex deviation, tilt,
the growth of the dispersions towards the centre, streams, binaries' orbits.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

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
    drift = component.sigma_u**2 / numbers["drift"] if component.rotation == 1 else 0.0  # discs
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


def sky_motion(
    ra: FloatArray, dec: FloatArray, kpc: FloatArray, velocity: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return pmra (with cos dec), pmdec [mas/yr] and rv [km/s] of galactic velocities (3, n) [km/s] at ra, dec."""
    ra = np.radians(ra)
    dec = np.radians(dec)
    vx, vy, vz = np.einsum("ij,in->jn", GALACTIC, velocity)
    level = vx * np.cos(ra) + vy * np.sin(ra)
    east = -vx * np.sin(ra) + vy * np.cos(ra)
    north = -level * np.sin(dec) + vz * np.cos(dec)
    # v [km/s] at d [kpc]: v / 4.74 AU/yr, and 1 AU at 1 kpc is 1 mas.
    scale = 1.0 / (KM_S_PER_AU_YR * kpc)
    return east * scale, north * scale, level * np.cos(dec) + vz * np.sin(dec)
