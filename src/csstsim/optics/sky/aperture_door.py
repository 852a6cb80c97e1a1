"""The aperture door: a flap on the tube's rim that shades the aperture and scatters light into it off its inside.

In the plane through boresight and hinge, the rim reaches from -R to R and the door from the hinge at R to
(R + D sin d, D cos d), where d is the opening angle beyond parallel to the boresight. For a beam from zenith angle t
on the door's side, the door shades the fraction (D cos d tan t - D sin d) / 2R of the aperture (clipped to 0..1). The
inside is a Lambert surface of small albedo, treated as one source seen from the aperture's centre. The door faces the
Sun (nominal roll). Left out: diffraction at the edge, the door's round outline, reflection by the tube's wall.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from csstsim.base.types import FloatArray, Floats
    from csstsim.optics.sky.parameters import ApertureDoor


def shade(zenith: FloatArray, azimuth: FloatArray, door_azimuth: Floats, door: ApertureDoor) -> FloatArray:
    """Return the fraction (0..1) of the aperture that is shaded, for beams from zenith, azimuth [deg], any shape."""
    slant = np.radians(zenith)
    side = np.cos(np.radians(azimuth - door_azimuth))
    turn = _turn(door)
    front = (side > math.cos(math.radians(door.half_width_deg))) & (slant < math.pi / 2)
    reach = door.length_m * math.cos(turn) * np.tan(np.where(front, slant, 0.0)) * side - door.length_m * math.sin(turn)
    return np.where(front, np.clip(reach / (2 * door.tube_radius_m), 0.0, 1.0), 0.0)


def scattered(zenith: FloatArray, azimuth: FloatArray, door_azimuth: Floats, door: ApertureDoor) -> FloatArray:
    """Return the aperture's irradiance by light off the door's inside, over the beam's normal irradiance.

    The far rim shades the door's foot from a beam that comes from behind the aperture's plane.
    """
    slant = np.radians(zenith)
    side = np.cos(np.radians(azimuth - door_azimuth))
    turn = _turn(door)
    onto = np.maximum(math.sin(turn) * np.cos(slant) - math.cos(turn) * np.sin(slant) * side, 0.0)
    below = np.maximum(-np.cos(slant), 0.0)
    foot = 2 * door.tube_radius_m * below / np.maximum(np.sin(slant), 1e-9)
    lit = np.clip(1.0 - foot / (door.length_m * math.cos(turn)), 0.0, 1.0)
    return door.albedo / math.pi * solid_angle(door) * onto * lit


def zenith_angle(door: ApertureDoor) -> float:
    """Return the zenith angle [deg] of the door's middle, from the aperture's centre."""
    return math.degrees(math.atan2(*_middle(door)))


def solid_angle(door: ApertureDoor) -> float:
    """Return the door's solid angle [sr] from the aperture's centre, taken as a small surface at the door's middle."""
    area = 2 * door.tube_radius_m * door.length_m
    return area * door.tube_radius_m * math.cos(_turn(door)) / math.hypot(*_middle(door)) ** 3


def _middle(door: ApertureDoor) -> tuple[float, float]:
    half = door.length_m / 2
    turn = _turn(door)
    return door.tube_radius_m + half * math.sin(turn), half * math.cos(turn)


def _turn(door: ApertureDoor) -> float:
    return math.radians(door.opening_deg - 90.0)
