"""Bricks: HEALPix pixels of NSIDE 256, nested (Gorski et al. 2005; paper, section 6: 13.7 arcmin on a side).

Positions are degrees, ICRS. Which bricks feed a chip is `catalog.selection.bricks.bricks_for`; where a brick's
files lie is `io.paths`.
"""

import numpy as np

from csstsim.base.sphere import ra_dec, unit_vectors

ORDER = 8
NSIDE = 2**ORDER
BRICKS = 12 * NSIDE**2
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

    return ra_dec(healpy.boundaries(NSIDE, pix, step=step, nest=True).T)


def near_brick(pix, ra, dec, margin):
    """Return a mask of the positions in brick `pix` or within `margin` (deg) of its border.

    A position outside is near when one of 16 directions at `margin`, or at half of it, leads into the brick: at the
    outer quarter of the margin the tip of a corner can hide between two directions.
    """
    ra, dec = np.asarray(ra, float), np.asarray(dec, float)
    near = brick_of(ra, dec) == pix
    centre = unit_vectors(*brick_centre(pix))
    v = unit_vectors(ra, dec)
    # The half-diagonal of a brick is below 0.3 deg: positions further out cannot be near.
    rest = np.flatnonzero(~near & (v @ centre > np.cos(np.radians(0.3 + margin))))
    # Nor can positions still outside after eight margins towards the centre: no corner is that sharp.
    inward = centre - v[rest]
    inward /= np.linalg.norm(inward, axis=1, keepdims=True)
    rest = rest[brick_of(*ra_dec(v[rest] + 8 * np.radians(margin) * inward)) == pix]
    # Any two axes across the line of sight will do; the second cross product is safe at the poles.
    helper = np.where(np.abs(v[rest, 2:]) < 0.9, [[0.0, 0.0, 1.0]], [[1.0, 0.0, 0.0]])
    first = np.cross(v[rest], helper)
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    second = np.cross(v[rest], first)
    for radius in (np.radians(margin), np.radians(margin / 2)):
        for angle in np.arange(16) * np.pi / 8:
            moved = v[rest] + np.tan(radius) * (np.cos(angle) * first + np.sin(angle) * second)
            near[rest] |= brick_of(*ra_dec(moved)) == pix
    return near


def brick_centre(pix):
    """Return ra, dec of the middle of a brick."""
    import healpy

    return healpy.pix2ang(NSIDE, pix, nest=True, lonlat=True)
