"""Brighter-fatter effect (paper, section 5.5.3): charge in the pixels pushes the boundaries between them.

    potential   phi = K * min(Q, limit)                            5 x 5 kernel, even in x and y
    moved       F(p -> q) = (phi_p - phi_q) (Q_p + Q_q) / 2         through the boundary of two neighbouring pixels

The shift of a boundary is the difference of a potential of the charges around (the curl-free field of Coulton et al.
2018, AJ 155, 258), what crosses it the shift times the charge beside it (Antilogus et al. 2014, JINST 9 C03048). What
leaves a pixel enters another, so charge is conserved to float32's rounding. K comes from the covariances of flats
(detector.bfe_fit) and holds half the final shift, the mean while charge gathers. Charge is moved as a mean: pixels
keep fractions of electrons, because rounding them would add 1/12 e-^2 of noise that flats do not show.

Two limits hold it stable whatever the image: a pixel pushes with no more than `limit` (its full well) and gives no
more than 1/DONOR of its charge through one boundary, so none turns negative. Nothing crosses the image's border, where
the outermost pixels are repeated as neighbours: a flat stays flat. A window lacks its neighbours: pixels further than 3
from its border are those of the whole chip.
Left out: change of the shifts with colour and depth, and that electrons move one by one (beside a saturated star, where
shifts are a few per cent of a pixel, noise is smoothed as much).
"""

import numba
import numpy as np

DONOR = 8.0  # more than the four boundaries, so that rounding cannot take a pixel below zero
_PAD = 2  # reach of the kernel
_RING = 2 * _PAD + 1


def move_charge(image, kernel, limit):
    """Move charge between neighbouring pixels of `image` (ny, nx; electrons, float32), in place.

    `kernel` (3, 3): the quadrant K[dy, dx] of the 5 x 5 kernel [per e-]; `limit`: full well [e-]. Raises ValueError if
    a pixel is negative or not finite (the image is then spoilt) or the kernel is no finite (3, 3).
    """
    kernel = np.asarray(kernel, np.float32)
    if kernel.shape != (_PAD + 1, _PAD + 1) or not np.isfinite(kernel).all() or not limit > 0:
        raise ValueError(f"kernel of shape {kernel.shape}, limit {limit}; need a finite (3, 3) and a positive limit")
    if image.size:
        bad = _move(image, kernel, np.float32(limit))
        if bad:
            raise ValueError(f"the charge of {bad} pixel(s) is negative or not finite")


@numba.njit(cache=True)
def _move(image, kernel, limit):
    """Go up the rows; a row is changed when its boundary with the next is known. Return the number of bad pixels."""
    ny, nx = image.shape
    ring = np.empty((_RING, nx + 2 * _PAD), np.float32)  # charges that push, of the rows around, as they were
    columns = np.empty((_PAD + 1, nx + 2 * _PAD), np.float32)
    phi, phi_above = np.empty(nx, np.float32), np.empty(nx, np.float32)
    up, up_below = np.empty(nx, np.float32), np.zeros(nx, np.float32)
    right = np.zeros(nx + 1, np.float32)
    bad = 0
    for y in range(-_PAD, _PAD):
        bad += _load(ring[y % _RING], image[min(max(y, 0), ny - 1)], limit) * (0 <= y < ny)
    for y in range(-1, ny):
        bad += _load(ring[(y + 1 + _PAD) % _RING], image[min(y + 1 + _PAD, ny - 1)], limit) * (y + 1 + _PAD < ny)
        if y + 1 < ny:
            _potential(ring, y + 1, kernel, columns, phi_above)
        if y >= 0:
            for x in range(nx - 1):
                right[x + 1] = _flux(phi[x], phi[x + 1], image[y, x], image[y, x + 1])
            if y + 1 < ny:
                for x in range(nx):
                    up[x] = _flux(phi[x], phi_above[x], image[y, x], image[y + 1, x])
            else:
                up[:] = 0
            for x in range(nx):
                image[y, x] = (image[y, x] + (right[x] - right[x + 1])) + (up_below[x] - up[x])
            up, up_below = up_below, up
        phi, phi_above = phi_above, phi
    return bad


@numba.njit(inline="always")
def _flux(phi_p, phi_q, p, q):
    """Return the charge that moves from p to q, within what either can give."""
    moved = (phi_p - phi_q) * (np.float32(0.5) * (p + q))
    most = np.float32(1 / DONOR)
    return max(min(moved, most * p), -most * q)


@numba.njit(cache=True)
def _load(row, charge, limit):
    """Fill a row of the ring, its ends repeated; return the number of bad pixels."""
    nx, bad = len(charge), 0
    for x in range(nx):
        value = charge[x]
        bad += not (value >= 0) & (value < np.inf)
        row[x + _PAD] = min(value, limit)
    row[:_PAD] = row[_PAD]
    row[nx + _PAD :] = row[nx + _PAD - 1]
    return bad


@numba.njit(cache=True)
def _potential(ring, y, kernel, columns, phi):
    """Fill phi (nx,) of row y: along columns first, then along the row; mirrored images give mirrored bits."""
    here = ring[y % _RING]
    near_below, near_above = ring[(y - 1) % _RING], ring[(y + 1) % _RING]
    far_below, far_above = ring[(y - 2) % _RING], ring[(y + 2) % _RING]
    for dx in range(_PAD + 1):
        k0, k1, k2, column = kernel[0, dx], kernel[1, dx], kernel[2, dx], columns[dx]
        for x in range(len(here)):
            column[x] = k0 * here[x] + (k1 * (near_below[x] + near_above[x]) + k2 * (far_below[x] + far_above[x]))
    middle, near, far = columns[0], columns[1], columns[2]
    for x in range(len(phi)):
        phi[x] = middle[x + 2] + ((near[x + 1] + near[x + 3]) + (far[x] + far[x + 4]))
