"""Directions as unit vectors, and the telescope's own axes.

The telescope's frame is (x, y, z): mosaic +x and +y, and the boresight. Zenith angles run from z, azimuths from +y
towards +x.
"""

import math

import numpy as np

OBLIQUITY = math.radians(84_381.406 / 3600.0)  # of the ecliptic at J2000 (IAU 2006)


def unit(ra, dec):
    """Return unit vectors (..., 3) of ra, dec [deg]."""
    ra, dec = np.radians(ra), np.radians(dec)
    return np.stack([np.cos(dec) * np.cos(ra), np.cos(dec) * np.sin(ra), np.sin(dec) + 0.0 * ra], axis=-1)


def telescope_axes(ra, dec, pa, parity=1):
    """Return the telescope's x, y and z as rows (3, 3): `axes @ v` takes v into its frame.

    ra, dec [deg]: the boresight; pa [deg]: position angle of mosaic +y, north through east; parity: Telescope.parity.
    """
    a, d, p = np.radians([ra, dec, pa])
    east = np.array([-np.sin(a), np.cos(a), 0.0])
    north = np.array([-np.sin(d) * np.cos(a), -np.sin(d) * np.sin(a), np.cos(d)])
    x = np.cos(p) * east - np.sin(p) * north
    y = parity * (np.sin(p) * east + np.cos(p) * north)
    return np.stack([x, y, unit(ra, dec)])


def angle(a, b):
    """Return the angle [deg] between vectors along the last axis, accurate for small and large ones."""
    return np.degrees(np.arctan2(np.linalg.norm(np.cross(a, b), axis=-1), np.sum(a * b, axis=-1)))


def helioecliptic(direction, sun):
    """Return longitude from the Sun's (-180..180) and ecliptic latitude [deg] of unit vectors (..., 3) on ICRS axes."""
    longitude, latitude = _ecliptic(direction)
    from_sun = longitude - _ecliptic(sun)[0]
    return (from_sun + 180.0) % 360.0 - 180.0, latitude


def _ecliptic(v):
    x, y, z = np.moveaxis(np.asarray(v), -1, 0)
    c, s = math.cos(OBLIQUITY), math.sin(OBLIQUITY)
    return np.degrees(np.arctan2(c * y + s * z, x)), np.degrees(np.arctan2(c * z - s * y, np.hypot(x, c * y + s * z)))
