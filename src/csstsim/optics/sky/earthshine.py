"""Earthshine: the sunlit Earth as segments, each a source for the point-source transmittance (paper, section 5.5.1).

The disc that the spacecraft sees is divided into segments in rings about the nadir. Each is a Lambert surface lit from
the local zenith angle of the Sun: its irradiance of the aperture is albedo / pi E_sun cos(Sun's zenith angle) times its
solid angle. The night side is dark: no airglow, cities or moonlit clouds. Left out: the Earth's flattening, variable
cloud cover, the glint on the oceans, twilight in the atmosphere.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from csstsim.base.units import EARTH_RADIUS_KM
from csstsim.optics.sky.bodies import earth_radius
from csstsim.optics.sky.transmittance import total

if TYPE_CHECKING:
    from csstsim.base.types import FloatArray, Floats
    from csstsim.optics.sky.parameters import SkyNumbers


def segments(spacecraft: FloatArray, sun: FloatArray, rings: int) -> tuple[FloatArray, FloatArray]:
    """Return directions (n, 3) from the spacecraft to the lit segments, on the axes of `spacecraft`, and weights (n,).

    A weight is solid angle [sr] times the cosine of the Sun's zenith angle there, over pi. Times the albedo it is the
    segment's irradiance over the Sun's. spacecraft: its position [km]; sun: unit vector.
    """
    distance = float(np.linalg.norm(spacecraft))
    radius = earth_radius(spacecraft)
    edges = np.linspace(0.0, radius, rings + 1)
    many = 3 * rings // 2
    nadir = 0.5 * (edges[1:] + edges[:-1])
    turn = 2 * math.pi * (np.arange(many) + 0.5) / many
    down = -spacecraft / distance
    side = np.cross(down, [1.0, 0.0, 0.0] if abs(down[0]) < 0.7 else [0.0, 1.0, 0.0])
    side /= np.linalg.norm(side)
    round_ = np.cos(turn)[:, None] * side + np.sin(turn)[:, None] * np.cross(down, side)
    seen = np.cos(nadir)[:, None, None] * down + np.sin(nadir)[:, None, None] * round_
    reach = distance * np.cos(nadir) - np.sqrt(np.maximum(EARTH_RADIUS_KM**2 - (distance * np.sin(nadir)) ** 2, 0.0))
    ground = (spacecraft + reach[:, None, None] * seen) / EARTH_RADIUS_KM
    height = np.sum(ground * sun, axis=-1)
    weight = np.diff(-np.cos(edges))[:, None] * (2 * math.pi / many) * height / math.pi
    lit = height > 0
    return seen[lit], weight[lit]


def earthshine(
    spacecraft: FloatArray,
    sun: FloatArray,
    axes: FloatArray,
    sights: FloatArray,
    door_azimuth: Floats,
    numbers: SkyNumbers,
) -> FloatArray:
    """Return (m,): the focal plane's irradiance by the Earth over the Sun's at 1 au, for albedo 1.

    spacecraft: its position [km], GCRS; sun: GCRS; axes: sky.directions.telescope_axes; sights (m, 3) in that frame.
    """
    seen, weight = segments(np.asarray(spacecraft, dtype=float), sun, numbers.earth.rings)
    return np.einsum("mn,n->m", total(np.einsum("ij,nj->ni", axes, seen), sights, door_azimuth, numbers), weight)
