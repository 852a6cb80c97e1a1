"""Light of stars that are not rendered: those of the list, and the mean of all fainter ones.

The list (sky.yaml) has the stars V < 5. Each is a separate source, unless it is so near the frame that it is rendered.
Fainter stars are a smooth brightness by galactic latitude. Their light comes from rings about the boresight, from where
rendered wings end (the first zenith angle of the transmittance) to the aperture's plane. It is the same for all pixels
of a frame. Left out: single stars of V 5 to 9 that lie further off than their wings are rendered.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from csstsim.base.sphere import angle, unit_vectors
from csstsim.optics.sky.bodies import earth_radius
from csstsim.optics.sky.transmittance import total
from csstsim.universe.stars.milky_way import GALACTIC

if TYPE_CHECKING:
    from csstsim.base.types import FloatArray, Floats
    from csstsim.optics.sky.parameters import SkyNumbers

FAINT_MAGNITUDE = 10.0  # V of the stars that `starlight.brightness` counts
# twice as many of both change the light by less than 1%
RINGS = 40
TURNS = 24
AHEAD = np.array([[0.0, 0.0, 1.0]])


def star_directions(numbers: SkyNumbers) -> FloatArray:
    """Return the unit vectors (n, 3) of the stars of the list, ICRS; numbers: SkyNumbers."""
    return unit_vectors(*numbers.stars[:, :2].T)


def faint_starlight(axes: FloatArray, spacecraft: FloatArray, door_azimuth: Floats, numbers: SkyNumbers) -> float:
    """Return the focal plane's irradiance by unresolved stars over that of one star of FAINT_MAGNITUDE.

    axes: sky.directions.telescope_axes; spacecraft: its position [km], GCRS; door_azimuth [deg]; numbers: SkyNumbers.
    """
    seen, area = _rings(numbers.transmittance.zenith[0])
    directions = np.einsum("nj,ji->ni", seen, axes)
    latitude = np.degrees(np.arcsin(np.clip(np.abs(np.einsum("ni,i->n", directions, GALACTIC[2])), 0.0, 1.0)))
    weights = area * np.interp(latitude, numbers.starlight.latitude, numbers.starlight.brightness)
    weights[angle(directions, -spacecraft) < np.degrees(earth_radius(spacecraft))] = 0.0
    return float(np.einsum("n,n->", total(seen, AHEAD, door_azimuth, numbers)[0], weights))


def _rings(first: float) -> tuple[FloatArray, FloatArray]:
    """Return unit vectors (n, 3) in the telescope's frame from zenith angle `first` to 90 [deg], their areas [deg2]."""
    edges = np.radians(np.geomspace(first, 90.0, RINGS + 1))
    slant = np.sqrt(edges[1:] * edges[:-1])
    turn = 2 * np.pi * (np.arange(TURNS) + 0.5) / TURNS
    rho = np.sin(slant)[:, None]
    z = np.cos(slant)[:, None]
    seen = np.stack(np.broadcast_arrays(rho * np.sin(turn), rho * np.cos(turn), z), axis=-1)
    area = np.broadcast_to(np.diff(-np.cos(edges))[:, None] * np.degrees(1) ** 2 * 2 * np.pi / TURNS, seen.shape[:2])
    return seen.reshape(-1, 3), area.ravel()
