"""Directions on the sphere: unit vectors, angles, rotations, tangent frames, small offsets, convex polygons.

Positions are in degrees (longitude, latitude: ra, dec or any other pair). The three components of vectors are on the
last axis.
"""

import math
from typing import TypeVar

import numpy as np

from csstsim.base.types import BoolArray, FloatArray, Floats

FloatsT = TypeVar("FloatsT", float, FloatArray)


def unit_vectors(ra: Floats, dec: Floats) -> FloatArray:
    """Return unit vectors of positions on the sky.

    Parameters
    ----------
    ra, dec : float or (n,) array of float
        Positions [deg].

    Returns
    -------
    (3,) or (n, 3) array of float
        Unit vectors.
    """
    return _vectors(np.radians(ra), np.radians(dec))


def _vectors(a: Floats, d: Floats) -> FloatArray:
    cos_d = np.cos(d)
    return np.stack(np.broadcast_arrays(cos_d * np.cos(a), cos_d * np.sin(a), np.sin(d)), axis=-1)


def ra_dec(vectors: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return ra (0 <= ra < 360), dec (...) [deg] of vectors (..., 3) of any length."""
    x, y, z = np.moveaxis(np.asarray(vectors), -1, 0)
    return wrap_360(np.degrees(np.arctan2(y, x))), np.degrees(np.arctan2(z, np.hypot(x, y)))


def wrap_180(degrees: FloatsT) -> FloatsT:
    """Return angles [deg] wrapped to -180 <= angle < 180."""
    return (degrees + 180.0) % 360.0 - 180.0


def rotation(angle: float) -> FloatArray:
    """Return the matrix (2, 2) of a rotation from x towards y by an angle [rad]."""
    c = math.cos(angle)
    s = math.sin(angle)
    return np.array([[c, -s], [s, c]])


def wrap_360(degrees: FloatsT) -> FloatsT:
    """Return angles [deg] wrapped to 0 <= angle < 360."""
    degrees = degrees % 360.0
    return np.where(degrees == 360.0, 0.0, degrees)[()]  # type: ignore[return-value]  # a number for a number


def frames(a: Floats, d: Floats) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return unit vectors (..., 3) towards positions [rad], and towards east and north at these positions."""
    sin_a = np.sin(a)
    cos_a = np.cos(a)
    sin_d = np.sin(d)
    east = np.stack([-sin_a, cos_a, np.zeros_like(sin_a)], axis=-1)
    return _vectors(a, d), east, np.stack([-sin_d * cos_a, -sin_d * sin_a, np.cos(d)], axis=-1)


def normalised(vectors: FloatArray) -> FloatArray:
    """Return vectors (..., 3) scaled to length 1."""
    return vectors / np.sqrt(np.einsum("...i,...i->...", vectors, vectors))[..., None]


def angle(a: FloatArray, b: FloatArray) -> FloatArray:
    """Return the angle [deg] between vectors along the last axis, accurate for small and large ones."""
    return np.degrees(np.arctan2(np.linalg.norm(np.cross(a, b), axis=-1), np.sum(a * b, axis=-1)))


def offsets(ra: Floats, dec: Floats, from_ra: Floats, from_dec: Floats) -> tuple[FloatArray, FloatArray]:
    """Return offsets (east, north) [deg] of positions from others close to them."""
    east = wrap_180(np.asarray(ra) - from_ra)
    return east * np.cos(np.radians(from_dec)), np.asarray(dec) - from_dec


def inside_polygon(points: FloatArray, corners: FloatArray) -> BoolArray:
    """Return a mask (n,) of unit vectors (n, 3) inside a convex polygon of corners (m, 3), in either sense."""
    normals = np.cross(corners, np.roll(corners, -1, axis=0))
    normals *= np.sign(np.einsum("mi,i->m", normals, corners.mean(axis=0)))[:, None]
    return (np.einsum("ni,mi->nm", points, normals) >= 0).all(axis=1)


def expanded_polygon(corners: FloatArray, margin: float) -> FloatArray:
    """Return the corners (m, 3) of a convex polygon (m, 3) with each edge moved outwards by `margin` [rad].

    An edge moved by m is the small circle n.v = -sin m. A new corner is where the planes of two adjacent circles
    intersect on the sphere. The polygon of great circles between the new corners contains the small circles.
    """
    centre = corners.mean(axis=0)
    after = _inward(np.cross(corners, np.roll(corners, -1, axis=0)), centre)
    before = np.roll(after, 1, axis=0)
    # v = a before + b after + c (before x after) with v.before = v.after = -sin m, |v| = 1
    both = -np.sin(margin) / (1 + _dot(before, after)) * (before + after)
    return both + np.sqrt(1 - _dot(both, both)) * _inward(np.cross(before, after), centre)


def _inward(vectors: FloatArray, centre: FloatArray) -> FloatArray:
    """Return vectors (n, 3) scaled to length 1, with the sign that points to the side of `centre`."""
    return vectors * np.sign(vectors @ centre)[:, None] / np.sqrt(_dot(vectors, vectors))


def _dot(a: FloatArray, b: FloatArray) -> FloatArray:
    return np.einsum("ni,ni->n", a, b)[:, None]
