"""The telescope's axes, and ecliptic coordinates relative to the Sun.

The telescope's frame is (x, y, z): mosaic +x and +y, and the boresight. Zenith angles run from z, azimuths from +y
towards +x.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from csstsim.base.sphere import frames, wrap_180

if TYPE_CHECKING:
    from csstsim.base.types import FloatArray

OBLIQUITY = math.radians(84_381.406 / 3600.0)  # of the ecliptic at J2000 (IAU 2006)


def telescope_axes(ra: float, dec: float, pa: float, parity: int = 1) -> FloatArray:
    """Return the telescope's x, y and z as rows (3, 3): `axes @ v` takes v into its frame.

    ra, dec [deg]: the boresight; pa [deg]: position angle of mosaic +y, north through east; parity: Telescope.parity.
    """
    a, d, p = np.radians([ra, dec, pa])
    z, east, north = frames(a, d)
    x = np.cos(p) * east - np.sin(p) * north
    y = parity * (np.sin(p) * east + np.cos(p) * north)
    return np.stack([x, y, z])


def in_telescope(axes: FloatArray, directions: FloatArray) -> FloatArray:
    """Return vectors (n, 3) on GCRS axes in the telescope's frame; axes: `telescope_axes`."""
    return np.einsum("ij,nj->ni", axes, directions)


def helioecliptic(direction: FloatArray, sun: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return ecliptic longitude from the Sun (-180..180) and latitude [deg] of unit vectors (..., 3) on ICRS axes."""
    longitude, latitude = _ecliptic(direction)
    from_sun = longitude - _ecliptic(sun)[0]
    return wrap_180(from_sun), latitude


def _ecliptic(v: FloatArray) -> tuple[FloatArray, FloatArray]:
    x, y, z = np.moveaxis(np.asarray(v), -1, 0)
    c = math.cos(OBLIQUITY)
    s = math.sin(OBLIQUITY)
    return np.degrees(np.arctan2(c * y + s * z, x)), np.degrees(np.arctan2(c * z - s * y, np.hypot(x, c * y + s * z)))
