"""Pixels excluded from measurement: defects known from calibration frames, and cosmic rays found in the frame itself.

A cosmic ray is sharper than the PSF. Its pixel is bright, and the ratio of the mean of two opposite neighbours to it is
smaller than for a star anywhere within the pixel (the test of SDSS's photo and of LSST; Bosch et al. 2018, PASJ 70,
S5), with an allowance for noise. Neighbours of the pixels found are then tested with a lower threshold, without the
pixels already found, until none is added. The result is grown by one pixel on all sides to cover the faint rim. Left
out: rays on bright objects.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numba
import numpy as np

from csstsim.base.types import BoolArray, FloatArray, IntArray
from csstsim.detector import defects, mask

if TYPE_CHECKING:
    from csstsim.base.rng import Streams
    from csstsim.instrument.chip import Chip, Window
    from csstsim.layers import detector_defects
    from csstsim.measure.calibration.calibrate import Calibrated
    from csstsim.measure.light.photometry import PsfModel

# bits of `fill_bad_pixels`
FULL = np.uint8(1)
BAD = np.uint8(2)
RAY = np.uint8(4)
# bits during the search for rays: not tested; a ray, without its rim; either of them
_NOT_TESTED = np.uint8(8)
_FOUND = np.uint8(16)
_EXCLUDED = np.uint8(24)
# sigma above the sky: threshold for a first pixel, and for one next to a pixel that was found
SIGMA = 5.0
NEIGHBOUR_SIGMA = 2.5
NOISE = 2.5  # sigma: allowance in favour of a star, for a first pixel and for the mean of its pair
RATIO_FRACTION = 0.7  # of a star's minimum ratio of pair to pixel: allowance for errors of the PSF
SATURATED_REACH = 3  # px from a saturated core, where the image is sharper than the PSF
FILL_REACH_MAX = 8  # px
_STAR_OFFSETS = np.linspace(-0.5, 0.5, 5)  # px: positions of a star within its pixel


def fill_bad_pixels(calibrated: Calibrated, model: PsfModel) -> IntArray:
    """Fill defects and cosmic rays of `calibrated.electrons` (calibrate.Calibrated), in place.

    Returns its `marks`, to which the bit RAY is added: uint8 (ny, nx), the reasons not to use a pixel, FULL
    (saturated), BAD (defect) and RAY. model: photometry.PsfModel.
    """
    read_noise = float(np.mean(list(calibrated.read_noise.values())))
    marks = calibrated.marks
    _mark_rays(calibrated.electrons, marks, read_noise, model)
    _fill_marked(calibrated.electrons, marks, BAD | RAY)
    return marks


def known_defects(chip: Chip, window: Window, param: detector_defects.Param, rng: Streams) -> BoolArray:
    """Return bool (ny, nx): hot and dead pixels and bad columns in `window`, as made by layer detector_defects.

    chip: instrument.chip.Chip; param: the layer's; rng: rng.Streams of the chip. Raises InputError for a laboratory map
    with a value that is not allowed.
    """
    if chip.maps.bad_pixels:
        kinds = (mask.HOT, param.hot_pixels), (mask.DEAD, param.dead_pixels), (mask.BAD_COLUMN, param.bad_columns)
        wanted = sum(bit for bit, included in kinds if included)
        return (chip.maps.bad_pixels.part(*window.slices) & wanted) > 0
    detector = chip.detector
    out = np.zeros(window.shape, bool)
    assert detector.defects is not None  # layers.detector_defects.check
    pixels = defects.defective_pixels((detector.ny, detector.nx), detector.defects, rng.chip("defective pixels"))
    for positions, included in zip(pixels, (param.hot_pixels, param.dead_pixels), strict=True):
        _, y, x = defects.in_window(positions, detector.nx, window)
        out[y, x] = included
    for column, first, end, _ in defects.bad_columns(
        detector.channel_ny, detector.nx, detector.defects, rng.chip("bad columns")
    ):
        if param.bad_columns and window.x0 <= column < window.x1:
            out[max(first - window.y0, 0) : max(end - window.y0, 0), column - window.x0] = True
    return out


def cosmic_rays(
    electrons: FloatArray, saturated: BoolArray, known: BoolArray, read_noise: float, model: PsfModel
) -> BoolArray:
    """Return bool (ny, nx): pixels struck by cosmic rays, or hot.

    electrons: float32 (ny, nx), sky included; saturated, known: bool (ny, nx), pixels that are not tested, nor those
    within SATURATED_REACH of a saturated one; read_noise: electrons; model: photometry.PsfModel.
    """
    marks = FULL * saturated | BAD * known
    _mark_rays(electrons, marks, read_noise, model)
    return (marks & RAY) > 0


@numba.njit(cache=True)
def _exclude_from_tests(marks: IntArray) -> None:
    """Set the bit _NOT_TESTED of bad pixels and of those within SATURATED_REACH of a saturated one."""
    ny, nx = marks.shape
    for y in range(ny):
        for x in range(nx):
            if marks[y, x] & BAD:
                marks[y, x] |= _NOT_TESTED
            if marks[y, x] & FULL:
                for v in range(max(y - SATURATED_REACH, 0), min(y + SATURATED_REACH + 1, ny)):
                    wide = SATURATED_REACH - abs(v - y)
                    for u in range(max(x - wide, 0), min(x + wide + 1, nx)):
                        marks[v, u] |= _NOT_TESTED


def _mark_rays(electrons: FloatArray, marks: IntArray, read_noise: float, model: PsfModel) -> None:
    """Set the bit RAY of `marks` (bits FULL and BAD) for pixels of rays and those around them."""
    _exclude_from_tests(marks)
    sky = float(np.median(electrons[::8, ::8]))
    read_variance = read_noise**2
    # The root of (e - sky)^2 = SIGMA^2 (e + read_variance) above the sky; the exact test is in _is_ray
    level = sky + SIGMA**2 / 2 + SIGMA * math.sqrt(SIGMA**2 / 4 + max(sky, 0.0) + read_variance)
    _find(electrons, marks, sky, read_variance, RATIO_FRACTION * model.smallest_pairs(_STAR_OFFSETS), level)


@numba.njit(cache=True)
def _find(
    electrons: FloatArray, marks: IntArray, sky: float, read_variance: float, pairs: FloatArray, level: float
) -> None:
    """Test all pixels, then the neighbours of each pixel found, and mark rays. pairs (4,): right, up, diagonals."""
    ny, nx = electrons.shape
    found = [(0, 0) for _ in range(0)]
    for y in range(1, ny - 1):
        for x in range(1, nx - 1):
            if electrons[y, x] > level and _is_ray(electrons, marks, sky, read_variance, pairs, y, x, SIGMA, NOISE):
                marks[y, x] |= _FOUND
                found.append((y, x))
    queue = found.copy()
    while len(queue):
        row, column = queue.pop()
        for y in range(max(row - 1, 1), min(row + 2, ny - 1)):
            for x in range(max(column - 1, 1), min(column + 2, nx - 1)):
                if _is_ray(electrons, marks, sky, read_variance, pairs, y, x, NEIGHBOUR_SIGMA, 0.0):
                    marks[y, x] |= _FOUND
                    queue.append((y, x))
                    found.append((y, x))
    for row, column in found:
        marks[row - 1 : row + 2, column - 1 : column + 2] |= RAY
    for y in range(ny):
        for x in range(nx):
            marks[y, x] &= FULL | BAD | RAY


@numba.njit(cache=True)
def _is_ray(
    electrons: FloatArray,
    marks: IntArray,
    sky: float,
    read_variance: float,
    pairs: FloatArray,
    y: int,
    x: int,
    threshold: float,
    allowance: float,
) -> bool:
    """Return whether a new pixel is `threshold` sigma above the sky and too sharp for a star.

    `allowance` sigma are subtracted from the pixel and added to its neighbours, in favour of a star.
    """
    value = electrons[y, x] - sky
    variance = max(electrons[y, x], 0.0) + read_variance
    if value * abs(value) < threshold**2 * variance or marks[y, x] & _EXCLUDED:
        return False
    value -= allowance * math.sqrt(variance)
    for k in range(4):
        dy = min(k, 1)
        dx = 1 - k if k < 2 else 5 - 2 * k
        total = 0.0
        noise = 0.0
        n = 0
        for side in (-1, 1):
            v = y + side * dy
            u = x + side * dx
            if not marks[v, u] & _EXCLUDED:
                total += electrons[v, u] - sky
                noise += max(electrons[v, u], 0.0) + read_variance
                n += 1
        if n and value > (total + allowance * math.sqrt(noise)) / n / pairs[k]:
            return True
    return False


def fill(electrons: FloatArray, bad: BoolArray) -> None:
    """Replace each of the `bad` pixels, in place, by the mean of the good pixels in the smallest square that has any.

    Without any within FILL_REACH_MAX px, it is the median of a sample of all good pixels. If all are bad, nothing is
    done.
    """
    _fill_marked(electrons, bad.view(np.uint8), np.uint8(1))


def _fill_marked(electrons: FloatArray, marks: IntArray, bits: np.uint8) -> None:
    """Fill the pixels of which `marks` (uint8) has one of `bits`, as `fill`."""
    others = electrons[::8, ::8][(marks[::8, ::8] & bits) == 0]
    if others.size == 0:
        others = electrons[(marks & bits) == 0]
    if others.size:
        _fill(electrons, marks, bits, np.float32(np.median(others)))


@numba.njit(cache=True)
def _fill(electrons: FloatArray, marks: IntArray, bits: np.uint8, level: np.float32) -> None:
    ny, nx = electrons.shape
    for y in range(ny):
        for x in range(nx):
            if not marks[y, x] & bits:
                continue
            reach = 0
            n = 0
            total = 0.0
            while n == 0 and reach < FILL_REACH_MAX:
                reach += 1
                for v in range(max(y - reach, 0), min(y + reach + 1, ny)):
                    for u in range(max(x - reach, 0), min(x + reach + 1, nx)):
                        if not marks[v, u] & bits:
                            total += electrons[v, u]
                            n += 1
            electrons[y, x] = total / n if n else level
