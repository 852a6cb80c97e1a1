"""Pixels excluded from measurement: defects known from calibration frames, and cosmic rays found in the frame itself.

A cosmic ray is sharper than the PSF. Its pixel is bright, and relative to it the mean of two opposite neighbours is
lower than for a star anywhere within the pixel (the test of SDSS's photo and of LSST; Bosch et al. 2018, PASJ 70,
S5), with an allowance for noise. Neighbours of the found pixels are then tested with a lower threshold, without the
pixels already found, until none is added. The result is grown by one pixel on all sides to cover the faint rim. Left
out: rays on bright objects.
"""

import math

import numba
import numpy as np

from csstsim.detector import defects
from csstsim.measure.maps import grown

FULL, BAD, RAY = np.uint8(1), np.uint8(2), np.uint8(4)  # bits of `mend`
SIGMA, NEIGHBOUR_SIGMA = 5.0, 2.5  # threshold above the sky for a first pixel, and for one next to a found one
NOISE = 2.5  # sigma: allowance in favour of a star, for a first pixel and for the mean of its pair
SHARE = 0.7  # of a star's smallest ratio of pair to pixel, because the PSF is not known better
NEAR = 3  # px from a saturated core, where the image is sharper than the PSF
FAR = 8  # px
_PLACES = np.linspace(-0.5, 0.5, 5)  # px, positions of a star within its pixel


def mend(calibrated, model):
    """Fill defects and cosmic rays of `calibrated.electrons` (calibrate.Calibrated), in place.

    Returns uint8 (ny, nx), the reasons not to use a pixel: bits FULL (saturated), BAD (defect) and RAY. model:
    photometry.PsfModel.
    """
    read_noise = float(np.mean(list(calibrated.read_noise.values())))
    rays = cosmic_rays(calibrated.electrons, calibrated.saturated, calibrated.bad, read_noise, model)
    fill(calibrated.electrons, rays | calibrated.bad)
    why = FULL * calibrated.saturated.astype(np.uint8)
    why |= BAD * calibrated.bad.astype(np.uint8)
    why |= RAY * rays.astype(np.uint8)
    return why


def known_defects(detector, window, param, rng):
    """Return bool (ny, nx): hot and dead pixels and bad columns in `window`, as made by layer detector_defects.

    param: the layer's; rng: rng.Streams of the chip.
    """
    out = np.zeros(window.shape, bool)
    pixels = defects.places((detector.ny, detector.nx), detector.defects, rng.chip("defective pixels"))
    for some, there in zip(pixels, (param.hot_pixels, param.dead_pixels), strict=True):
        _, y, x = defects.inside(some, detector.nx, window)
        out[y, x] = there
    for column, first, end, _ in defects.columns(
        detector.channel_ny, detector.nx, detector.defects, rng.chip("bad columns")
    ):
        if param.bad_columns and window.x0 <= column < window.x1:
            out[max(first - window.y0, 0) : max(end - window.y0, 0), column - window.x0] = True
    return out


def cosmic_rays(electrons, saturated, known, read_noise, model):
    """Return bool (ny, nx): pixels struck by cosmic rays, or hot.

    electrons: float32 (ny, nx), sky included; saturated, known: bool (ny, nx), pixels not tested, nor those within NEAR
    of a saturated one; read_noise: electrons; model: photometry.PsfModel.
    """
    left_out = known | grown(saturated, NEAR)
    sky = float(np.median(electrons[::8, ::8]))
    found = _find(electrons, left_out, sky, read_noise**2, SHARE * model.smallest_pairs(_PLACES))
    return grown(found, 1, square=True)


@numba.njit(cache=True)
def _find(electrons, left_out, sky, read_variance, pairs):
    """Test all pixels, then those next to each found one; return bool (ny, nx). pairs (4,): right, up, diagonals."""
    ny, nx = electrons.shape
    found = np.zeros((ny, nx), np.bool_)
    queue = [(0, 0) for _ in range(0)]
    for y in range(1, ny - 1):
        for x in range(1, nx - 1):
            if _is_ray(electrons, found, left_out, sky, read_variance, pairs, y, x, SIGMA, NOISE):
                found[y, x] = True
                queue.append((y, x))
    while len(queue):
        row, column = queue.pop()
        for y in range(max(row - 1, 1), min(row + 2, ny - 1)):
            for x in range(max(column - 1, 1), min(column + 2, nx - 1)):
                if _is_ray(electrons, found, left_out, sky, read_variance, pairs, y, x, NEIGHBOUR_SIGMA, 0.0):
                    found[y, x] = True
                    queue.append((y, x))
    return found


@numba.njit(cache=True)
def _is_ray(electrons, found, left_out, sky, read_variance, pairs, y, x, least, doubt):
    """Return whether a new pixel is `least` sigma bright and too sharp, with `doubt` sigma in favour of a star."""
    value, variance = electrons[y, x] - sky, max(electrons[y, x], 0.0) + read_variance
    if value * abs(value) < least**2 * variance or found[y, x] or left_out[y, x]:
        return False
    value -= doubt * math.sqrt(variance)
    for k in range(4):
        dy, dx = min(k, 1), 1 - k if k < 2 else 5 - 2 * k
        total, noise, n = 0.0, 0.0, 0
        for side in (-1, 1):
            v, u = y + side * dy, x + side * dx
            if not (found[v, u] or left_out[v, u]):
                total += electrons[v, u] - sky
                noise += max(electrons[v, u], 0.0) + read_variance
                n += 1
        if n and value > (total + doubt * math.sqrt(noise)) / n / pairs[k]:
            return True
    return False


def fill(electrons, bad):
    """Replace `bad` pixels, in place, by the mean of the good ones in the smallest square around them that has any.

    If none is within FAR pixels, it is the median of a sample of the good pixels. If all are bad, nothing is done.
    """
    others = electrons[::8, ::8][~bad[::8, ::8]]
    if others.size == 0:
        others = electrons[~bad]
    if others.size:
        _fill(electrons, bad, np.float32(np.median(others)))


@numba.njit(cache=True)
def _fill(electrons, bad, level):
    ny, nx = electrons.shape
    for y in range(ny):
        for x in range(nx):
            if not bad[y, x]:
                continue
            reach, n, total = 0, 0, 0.0
            while n == 0 and reach < FAR:
                reach += 1
                for v in range(max(y - reach, 0), min(y + reach + 1, ny)):
                    for u in range(max(x - reach, 0), min(x + reach + 1, nx)):
                        if not bad[v, u]:
                            total += electrons[v, u]
                            n += 1
            electrons[y, x] = total / n if n else level
