"""Bricks: HEALPix pixels of NSIDE 256, nested (Gorski et al. 2005; paper, section 6: 13.7 arcmin on a side).

Positions are in degrees, ICRS; pixels are nested. `catalog.selection.bricks.bricks_for` returns the bricks of a chip,
`io.paths` the files of a brick. hpgeom gives the same bits as healpy if it is called with co-latitudes, and its import
takes a fiftieth of the time. Only its pixel borders differ in the last bit: `pixel_border` has those of healpy.
"""

import math
from typing import TypeVar

import numpy as np

from csstsim.base.sphere import ra_dec, unit_vectors
from csstsim.base.types import BoolArray, FloatArray, Floats, IntArray

BitsT = TypeVar("BitsT", int, IntArray)

ORDER = 8
NSIDE = 2**ORDER
BRICKS = 12 * NSIDE**2
HATS_ORDER = 29  # the order of the `_healpix_29` column of HATS catalogues


_POLAR = 0.01  # rad
# Row (counted from the north pole) and column of the southern corner of the 12 base pixels (Gorski et al. 2005)
_ROWS = (2, 2, 2, 2, 3, 3, 3, 3, 4, 4, 4, 4)
_COLUMNS = (1, 3, 5, 7, 0, 2, 4, 6, 1, 3, 5, 7)


def pixel_of(nside: int, ra: Floats, dec: Floats) -> IntArray:
    """Return the pixel (int64) that contains each position. Raises ValueError for one that is not on the sphere."""
    import hpgeom

    if not np.isfinite(dec).all():
        raise ValueError("a declination is not finite")
    theta, phi = colatitude(ra, dec)
    pix = hpgeom.angle_to_pixel(nside, theta, phi, lonlat=False, nest=True)
    if not np.any(polar := np.sin(theta) < _POLAR):
        return pix
    sine = np.sin(theta)  # near a pole, angles lose precision
    exact = hpgeom.vector_to_pixel(nside, sine * np.cos(phi), sine * np.sin(phi), np.cos(theta), nest=True)
    return np.where(polar, exact, pix)


def pixel_towards(nside: int, vectors: FloatArray) -> IntArray:
    """Return the pixel (int64) that contains the direction of each vector (..., 3)."""
    import hpgeom

    return hpgeom.vector_to_pixel(nside, *np.moveaxis(np.asarray(vectors, float), -1, 0), nest=True)


def pixel_centre(nside: int, pix: int | IntArray) -> tuple[FloatArray, FloatArray]:
    """Return ra, dec [deg] of the centres of pixels."""
    import hpgeom

    theta, phi = hpgeom.pixel_to_angle(nside, pix, lonlat=False, nest=True)
    return np.degrees(phi), 90.0 - np.degrees(theta)


def pixel_vector(nside: int, pix: int | IntArray) -> FloatArray:
    """Return the unit vectors (..., 3) towards the centres of pixels."""
    import hpgeom

    return np.stack(hpgeom.pixel_to_vector(nside, pix, nest=True), axis=-1)


def disc(nside: int, centre: FloatArray, radius: float, inclusive: bool = False) -> IntArray:
    """Return the pixels, rising, whose centres are within `radius` [rad] of a unit vector (3,).

    inclusive: the pixels that overlap the disc, and possibly a few close to it.
    """
    import hpgeom

    return np.sort(hpgeom.query_circle_vec(nside, centre, radius, inclusive=inclusive, nest=True))


def colatitude(ra: Floats, dec: Floats) -> tuple[FloatArray, FloatArray]:
    """Return theta, phi [rad], 0 <= phi <= 2 pi, of positions."""
    phi = np.radians(ra)
    return np.pi / 2 - np.radians(dec), np.where((phi < 0) | (phi > 2 * np.pi), phi % (2 * np.pi), phi)


def brick_of(ra: Floats, dec: Floats) -> IntArray:
    """Return the brick (int64) that contains each position; every position is in exactly one."""
    return pixel_of(NSIDE, ra, dec)


def hats_index(ra: Floats, dec: Floats) -> IntArray:
    """Return the nested HEALPix index of order 29 (int64), the row index of HATS catalogues."""
    return pixel_of(2**HATS_ORDER, ra, dec)


def pixel_border(nside: int, pix: int, step: int = 1) -> FloatArray:
    """Return unit vectors (4 step, 3) along the border of a pixel: `step` from each corner on, order N, W, S, E."""
    face, within = divmod(int(pix), nside * nside)
    x, y = ((every_other(within >> shift) + 0.5) / nside for shift in (0, 1))
    half = 0.5 / nside
    length = 1.0 / (step * nside)
    part = [k * length for k in range(step)]
    points = [(x + half - d, y + half) for d in part] + [(x - half, y + half - d) for d in part]
    points += [(x - half + d, y - half) for d in part] + [(x + half, y - half + d) for d in part]
    return np.array([_vector(face, *point) for point in points])


def every_other(bits: BitsT, count: int = 30) -> BitsT:
    """Return the number, or numbers, formed by the lowest `count` even bits."""
    return sum((bits >> 2 * k & 1) << k for k in range(count))  # type: ignore[return-value]  # count is not 0


def _vector(face: int, x: float, y: float) -> tuple[float, float, float]:
    """Return the unit vector of a point in the square of a base pixel (Gorski et al. 2005, equations 4-9)."""
    row = _ROWS[face] - x - y
    if 1 <= row <= 3:  # equatorial
        around = 1.0
        z = (2 - row) * 2 / 3
    else:
        around = row if row < 1 else 4 - row
        z = math.copysign(1 - around * around / 3, 2 - row)
    rest = around * around / 3
    across = math.sqrt(rest * (2 - rest) if abs(z) > 0.99 else (1 - z) * (1 + z))
    column = _COLUMNS[face] * around + x - y
    column += 8 if column < 0 else 0
    column -= 8 if column >= 8 else 0
    phi = math.pi / 4 * column / around if around > 1e-15 else 0.0
    return across * math.cos(phi), across * math.sin(phi), z


def brick_corners(pix: int, step: int = 1) -> tuple[FloatArray, FloatArray]:
    """Return ra, dec (4 step,) [deg] along the border of a brick."""
    return ra_dec(pixel_border(NSIDE, pix, step))


def near_brick(pix: int, ra: FloatArray, dec: FloatArray, margin: float) -> BoolArray:
    """Return a mask (n,) of the positions (n,) [deg] in brick `pix` or within `margin` [deg] of its border.

    A position outside is near if a step of `margin`, or of half of it, in one of 16 directions leads into the brick. In
    the outer quarter of the margin, the tip of a corner may be missed between two directions.
    """
    ra = np.asarray(ra, float)
    dec = np.asarray(dec, float)
    near = brick_of(ra, dec) == pix
    centre = unit_vectors(*brick_centre(pix))
    v = unit_vectors(ra, dec)
    # The half-diagonal of a brick is below 0.3 deg: positions further out cannot be near.
    rest = np.flatnonzero(~near & (v @ centre > np.cos(np.radians(0.3 + margin))))
    # Positions that are still outside after a step of eight margins to the centre are not near: no corner is so sharp.
    inward = centre - v[rest]
    inward /= np.linalg.norm(inward, axis=1, keepdims=True)
    rest = rest[brick_of(*ra_dec(v[rest] + 8 * np.radians(margin) * inward)) == pix]
    # Two axes perpendicular to the line of sight; the choice of `helper` is safe at the poles.
    helper = np.where(np.abs(v[rest, 2:]) < 0.9, [[0.0, 0.0, 1.0]], [[1.0, 0.0, 0.0]])
    first = np.cross(v[rest], helper)
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    second = np.cross(v[rest], first)
    for radius in (np.radians(margin), np.radians(margin / 2)):
        for angle in np.arange(16) * np.pi / 8:
            moved = v[rest] + np.tan(radius) * (np.cos(angle) * first + np.sin(angle) * second)
            near[rest] |= brick_of(*ra_dec(moved)) == pix
    return near


def brick_centre(pix: int | IntArray) -> tuple[FloatArray, FloatArray]:
    """Return ra, dec [deg] of the centre of a brick."""
    return pixel_centre(NSIDE, pix)
