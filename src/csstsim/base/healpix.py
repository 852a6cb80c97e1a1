"""Bricks: HEALPix pixels of NSIDE 256, nested (Gorski et al. 2005; paper, section 6: 13.7 arcmin on a side).

Positions are degrees, ICRS. Which bricks feed a chip is `catalog.select.bricks_for`; where a brick's
files lie is `io.paths`.
"""

import numpy as np

NSIDE = 256
HATS_ORDER = 29  # the order of the `_healpix_29` column of HATS catalogues


def brick_of(ra, dec):
    """Return the brick (int64) that holds each position; every position is in exactly one."""
    import healpy

    return healpy.ang2pix(NSIDE, ra, dec, nest=True, lonlat=True).astype(np.int64)


def hats_index(ra, dec):
    """Return the nested HEALPix index of order 29 (int64), the row index of HATS catalogues."""
    import healpy

    return healpy.ang2pix(2**HATS_ORDER, ra, dec, nest=True, lonlat=True).astype(np.int64)


def brick_corners(pix, step=1):
    """Return ra, dec (4 step,) along the border of a brick."""
    import healpy

    return from_vectors(healpy.boundaries(NSIDE, pix, step=step, nest=True).T)


def to_vectors(ra, dec):
    """Return unit vectors (n, 3)."""
    ra, dec = np.radians(ra), np.radians(dec)
    return np.stack([np.cos(dec) * np.cos(ra), np.cos(dec) * np.sin(ra), np.sin(dec)], axis=-1)


def from_vectors(vectors):
    """Return ra (0 <= ra < 360), dec of vectors (n, 3) of any length."""
    x, y, z = np.asarray(vectors).T
    ra = np.degrees(np.arctan2(y, x)) % 360.0
    return np.where(ra == 360.0, 0.0, ra), np.degrees(np.arctan2(z, np.hypot(x, y)))


def near_brick(pix, ra, dec, margin):
    """Return a mask of the positions in brick `pix` or within `margin` (deg) of its border.

    A position outside is near when one of 16 directions at `margin`, or at half of it, leads into the brick: at the
    outer quarter of the margin the tip of a corner can hide between two directions.
    """
    ra, dec = np.asarray(ra, float), np.asarray(dec, float)
    near = brick_of(ra, dec) == pix
    centre = to_vectors(*_centre(pix))
    v = to_vectors(ra, dec)
    # The half-diagonal of a brick is below 0.3 deg; further out nothing needs a closer look.
    rest = np.flatnonzero(~near & (v @ centre > np.cos(np.radians(0.3 + margin))))
    # Nor does what eight margins towards the centre do not bring in: no corner is that sharp.
    inward = centre - v[rest]
    inward /= np.linalg.norm(inward, axis=1, keepdims=True)
    rest = rest[brick_of(*from_vectors(v[rest] + 8 * np.radians(margin) * inward)) == pix]
    # Any two axes across the line of sight will do; the second cross product is safe at the poles.
    helper = np.where(np.abs(v[rest, 2:]) < 0.9, [[0.0, 0.0, 1.0]], [[1.0, 0.0, 0.0]])
    first = np.cross(v[rest], helper)
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    second = np.cross(v[rest], first)
    for radius in (np.radians(margin), np.radians(margin / 2)):
        for angle in np.arange(16) * np.pi / 8:
            moved = v[rest] + np.tan(radius) * (np.cos(angle) * first + np.sin(angle) * second)
            near[rest] |= brick_of(*from_vectors(moved)) == pix
    return near


def coverage(pix, footprints, order=6):
    """Return the fraction (0..1) of a brick inside the union of `footprints`, on 4**order points (13 arcsec apart).

    `footprints`: iterable of (ra[4], dec[4]), corners in order, either sense: convex spherical quadrilaterals.
    """
    import healpy

    fine = np.arange(4**order) + pix * 4**order
    points = to_vectors(*healpy.pix2ang(NSIDE * 2**order, fine, nest=True, lonlat=True))
    covered = np.zeros(len(points), bool)
    for ra, dec in footprints:
        covered |= inside(points, to_vectors(ra, dec))
    return float(covered.mean())


def inside(points, corners):
    """Return a mask of unit vectors (n, 3) inside a convex spherical polygon of corners (m, 3), any sense."""
    normals = np.cross(corners, np.roll(corners, -1, axis=0))
    side = points @ normals.T
    return (np.all(side >= 0, axis=1) | np.all(side <= 0, axis=1)) & (points @ corners.mean(axis=0) > 0)


def _centre(pix):
    import healpy

    return healpy.pix2ang(NSIDE, pix, nest=True, lonlat=True)
