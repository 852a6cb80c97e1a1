"""Brighter-fatter effect (paper, section 5.5.3): charge in the pixels shifts the boundaries between them.

    potential   phi = K * min(Q, limit)                         5 x 5 kernel, even in x and y
    shift       s = phi_p - phi_q +- skew (Q_p - Q_q)           of the boundary of two neighbours: + along y, - along x
    moved       F(p -> q) = s D                                 charge through the boundary
    density     D = (5 giver + 2 taker - behind) / 6            at the boundary, limited to between giver and taker

The shift of a boundary has two parts, both from charges of at most `limit`. One is the difference of a potential of the
surrounding charges (the curl-free field of Coulton et al. 2018, AJ 155, 258). The other depends on the two pixels
alone, because a pixel's own boundaries move more easily along columns than across the channel stops. The charge moved
is the shift times the density at the boundary (Antilogus et al. 2014, JINST 9 C03048; their density, the mean of the
two pixels, leaves a dip behind a step edge, the third-order density does not). Charge that leaves a pixel enters
another, so it is conserved to float32's rounding. K and skew come from the covariances of flats (detector.bfe_kernel).
They contain half of the final shift, which is its mean during the exposure. The expected charge is moved: pixels have
fractions of electrons, because rounding would add 1/12 e-^2 of noise that flats do not show.

Two limits keep it stable for any image: the charge that shifts boundaries is at most `limit` (the full well) per pixel,
and a pixel gives at most 1/DONOR of its charge through one boundary, so that no pixel becomes negative. Nothing crosses
the image's border; outside it the outermost pixels are repeated, so that a flat stays flat. In a window, pixels more
than 3 from the border are the same as on the whole chip.
Left out: change of the shifts with colour and depth, and the motion of single electrons (next to a saturated star,
where shifts are a few per cent of a pixel, noise is smoothed by as much).
"""

import numba
import numpy as np

from csstsim.base.types import FloatArray

DONOR = 8.0  # more than the four boundaries, so that rounding cannot make a pixel negative
_PAD = 2  # reach of the kernel
_RING = 2 * _PAD + 1
_REACH = 2 * (_PAD + 1)  # of two passes
_BAND = 128  # rows that are moved back while they are in the cache


def move_charge(image: FloatArray, kernel: FloatArray, skew: float, limit: float) -> None:
    """Move charge between neighbouring pixels of `image` (ny, nx; electrons, float32), in place.

    `kernel` (3, 3): the quadrant K[dy, dx] of the 5 x 5 kernel [per e-], `skew` [per e-]; `limit`: full well [e-].
    Raises ValueError if a pixel is negative or not finite (the image is then no longer usable), or for a kernel that is
    not finite or not (3, 3).
    """
    kernel = _checked(kernel, skew, limit)
    if image.size:
        _raise_if_bad(_move(image, image, image, kernel, np.float32(skew), np.float32(limit), False))


def move_back(image: FloatArray, kernel: FloatArray, skew: float, limit: float) -> None:
    """Undo `move_charge` on an image (ny, nx; electrons, float32, C-contiguous), in place.

    guess <- guess + (image - move_charge(guess)), twice, guess = image at first: charge moves by per cents, the second
    time by per cents of those. Negative values, of read noise, are no charge and stay. Raises ValueError as
    `move_charge`.
    """
    kernel = _checked(kernel, skew, limit)
    ny = len(image)
    before = image[:0]
    buffers = np.empty((3, min(_BAND, ny) + 2 * _REACH, image.shape[1]), np.float32)
    for first in range(0, ny, _BAND):
        last = min(first + _BAND, ny)
        above = image[last : last + _REACH]
        read, guess, out = buffers[:, : len(before) + last - first + len(above)]
        np.concatenate([before, image[first:last], above], out=read)  # `before`: these rows are changed already
        for source, target in ((read, guess), (guess, out)):
            _raise_if_bad(_move(source, read, target, kernel, np.float32(skew), np.float32(limit), True))
        image[first:last] = out[len(before) : len(read) - len(above)]
        before = read[: len(read) - len(above)][-_REACH:].copy()


def _checked(kernel: FloatArray, skew: float, limit: float) -> FloatArray:
    """Return the kernel as float32. Raises ValueError as `move_charge`."""
    kernel = np.ascontiguousarray(kernel, np.float32)
    if kernel.shape != (_PAD + 1, _PAD + 1) or not np.isfinite(kernel.sum() + skew) or not limit > 0:
        raise ValueError(f"kernel {kernel.shape}, skew {skew}, limit {limit}; need finite (3, 3) and a positive limit")
    return kernel


def _raise_if_bad(number: int) -> None:
    if number:
        raise ValueError(f"the charge of {number} pixel(s) is negative or not finite")


@numba.njit(cache=True)
def _move(
    image: FloatArray,
    base: FloatArray,
    out: FloatArray,
    kernel: FloatArray,
    skew: np.float32,
    limit: np.float32,
    back: bool,
) -> int:
    """Fill `out` with `base` plus the charge that moves in `image`; return the number of bad pixels of `image`.

    If `back`, the moved charge is subtracted, and negative values of `image` count as 0. A row of `out` is filled once
    the flow to the next row is known, so the three arrays may be the same.
    """
    ny, nx = image.shape
    sign, minimum = (np.float32(-1), np.float32(0)) if back else (np.float32(1), np.float32(-np.inf))
    charge = np.empty((_RING, nx + 2 * _PAD), np.float32)  # the rows around, before any change
    push = np.empty_like(charge)
    columns = np.empty((_PAD + 1, nx + 2 * _PAD), np.float32)
    phi = np.empty(nx, np.float32)
    phi_above = np.empty(nx, np.float32)
    up = np.zeros(nx, np.float32)
    up_below = np.zeros(nx, np.float32)
    right = np.zeros(nx + 1, np.float32)
    bad = 0
    for y in range(-_RING, ny):
        new = y + 1 + _PAD
        ring = new % _RING
        bad_in_row = _load(image[min(max(new, 0), ny - 1)], minimum, limit, charge[ring], push[ring])
        bad += bad_in_row * (0 <= new < ny)
        if -1 <= y < ny - 1:
            _potential(push, y + 1, kernel, columns, phi_above)
        if y >= 0:
            row = charge[y % _RING]
            row_push = push[y % _RING]
            _flow(phi[:-1], phi[1:], -skew, row_push[2:], row_push[3:], row[1:], row[2:], row[3:], row[4:], right[1:])
            right[nx] = 0
            if y + 1 < ny:
                below = charge[(y - 1) % _RING]
                above = charge[(y + 1) % _RING]
                two_above = charge[(y + 2) % _RING]
                above_push = push[(y + 1) % _RING]
                _flow(
                    phi, phi_above, skew, row_push[2:], above_push[2:], below[2:], row[2:], above[2:], two_above[2:], up
                )
            else:
                up[:] = 0
            row_base = base[y]
            row_out = out[y]
            for x in range(nx):
                row_out[x] = (row_base[x] + sign * (right[x] - right[x + 1])) + sign * (up_below[x] - up[x])
            up, up_below = up_below, up
        phi, phi_above = phi_above, phi
    return bad


@numba.njit(cache=True)
def _flow(
    phi_p: FloatArray,
    phi_q: FloatArray,
    skew: np.float32,
    push_p: FloatArray,
    push_q: FloatArray,
    before: FloatArray,
    p: FloatArray,
    q: FloatArray,
    after: FloatArray,
    flux: FloatArray,
) -> None:
    """Fill flux, at least as long as phi_p, with the charge that moves from p to q.

    before, p, q, after: the charges of four pixels in a line, for each boundary.
    """
    five = np.float32(5)
    two = np.float32(2)
    sixth = np.float32(1 / 6)
    max_fraction = np.float32(1 / DONOR)
    for x in range(len(phi_p)):
        shift = (phi_p[x] - phi_q[x]) + skew * (push_p[x] - push_q[x])
        charge_p = p[x]
        charge_q = q[x]
        density_from_p = five * charge_p + two * charge_q - before[x]
        density_from_q = five * charge_q + two * charge_p - after[x]
        density = sixth * (density_from_p if shift > 0 else density_from_q)
        density = min(max(density, min(charge_p, charge_q)), max(charge_p, charge_q))
        flux[x] = max(min(shift * density, max_fraction * charge_p), -max_fraction * charge_q)


@numba.njit(cache=True)
def _load(row: FloatArray, minimum: np.float32, limit: np.float32, charge: FloatArray, push: FloatArray) -> int:
    """Fill a row of the ring buffers, padded by repeating its ends; return the number of bad pixels.

    Values below `minimum` count as `minimum`.
    """
    nx = len(row)
    bad = 0
    for x in range(nx):
        value = max(row[x], minimum)
        bad += not (value >= 0) & (value < np.inf)
        charge[x + _PAD] = value
        push[x + _PAD] = min(value, limit)
    for padded in (charge, push):
        padded[:_PAD] = padded[_PAD]
        padded[nx + _PAD :] = padded[nx + _PAD - 1]
    return bad


@numba.njit(cache=True)
def _potential(ring: FloatArray, y: int, kernel: FloatArray, columns: FloatArray, phi: FloatArray) -> None:
    """Fill phi (nx,) of row y: sum along columns, then along the row; mirrored images give mirrored bits."""
    here = ring[y % _RING]
    near_below = ring[(y - 1) % _RING]
    near_above = ring[(y + 1) % _RING]
    far_below = ring[(y - 2) % _RING]
    far_above = ring[(y + 2) % _RING]
    for dx in range(_PAD + 1):
        k0 = kernel[0, dx]
        k1 = kernel[1, dx]
        k2 = kernel[2, dx]
        column = columns[dx]
        for x in range(len(here)):
            column[x] = k0 * here[x] + (k1 * (near_below[x] + near_above[x]) + k2 * (far_below[x] + far_above[x]))
    middle = columns[0]
    near = columns[1]
    far = columns[2]
    for x in range(len(phi)):
        phi[x] = middle[x + 2] + ((near[x + 1] + near[x + 3]) + (far[x] + far[x + 4]))
