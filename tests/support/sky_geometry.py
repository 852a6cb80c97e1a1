"""Geometry for tests of the sky: the shipped numbers, and a spacecraft over a given point with a given Sun."""

from functools import cache

import numpy as np

from csstsim.base.shipped import SHIPPED
from csstsim.base.sphere import unit_vectors
from csstsim.instrument.camera import load_camera
from csstsim.optics.sky.bodies import earth_radius
from csstsim.optics.sky.directions import telescope_axes
from csstsim.optics.sky.parameters import sky_numbers
from csstsim.optics.sky.transmittance import angles

PLACE = np.array([6778.137, 0.0, 0.0])  # km: zenith at ra 0, dec 0
AHEAD = np.array([[0.0, 0.0, 1.0]])  # the boresight, in the telescope's frame


@cache
def camera():
    return load_camera(SHIPPED / "instrument")


@cache
def numbers():
    return sky_numbers(camera().sky)


def towards_limb(limb):
    """Return the telescope's axes looking `limb` deg above the Earth's limb, west of PLACE's zenith."""
    return telescope_axes(-(180.0 - np.degrees(earth_radius(PLACE)) - limb), 0.0, 0.0)


def sun_at(zenith):
    """Return the Sun `zenith` deg east of PLACE's zenith."""
    return unit_vectors(zenith, 0.0)


def door_azimuth(axes, sun):
    return angles(axes @ sun)[1]
