"""Background and noise of a calibrated image: clipped means on a mesh, sources masked.

The mean is used, not Source Extractor's mode estimate (2.5 median - 1.5 mean): the pixels are whole DN, so their median
is a multiple of the gain, and the mode is wrong by up to 2.5 x half a DN, differently in each readout channel (measured
in the demo: +-1 electron, half the flux of a faint galaxy in its Kron aperture). A mean has no such error if the
sources are masked. Where they cannot be masked (crowded fields), the mode of 2 x 2 sums is used, whose error is a
quarter of that.
"""

import math
from dataclasses import dataclass

import numba
import numpy as np

from csstsim.base.arrays.robust_sigma import SIGMA_PER_MAD
from csstsim.base.types import BoolArray, FloatArray, IntArray
from csstsim.measure.detection.maps import BIN, add_interpolated, interpolated

# px; 4.7 arcsec to find sources and in crowded fields, 19 arcsec with sources masked
FIRST_BOX = 64
SECOND_BOX = 256
MASK_MAX = 0.4  # of the frame; with more masked it counts as crowded
GOOD_MIN = 0.25  # of the pixels of a mesh; with fewer it has the value of its neighbours
# sigma; faint rays and hot pixels that are not flagged are in the light of every source, so they are in the background,
# too. At 3.5 sigma, it would be 0.03 electron low
CLIP = 5.0
SAMPLE = 2048  # pixels of a mesh for the first guess
FLOOR = np.float32(1e-3)  # electron; a noise-free image has rms 0: a floor keeps S/N finite


@dataclass(frozen=True)
class Mesh:
    """Level and noise (rows, columns), electron, at the `middle` (rows, columns) of parts of a frame, px."""

    level: FloatArray
    rms: FloatArray
    middle: tuple[FloatArray, FloatArray]

    def subtract_from(self, image: FloatArray) -> None:
        """Subtract the level from an image of the frame, in place."""
        add_interpolated(image, self.level, self.middle, -1.0)

    def noise(self, shape: tuple[int, ...]) -> FloatArray:
        """Return the noise, float32 of `shape`, of sums of BIN x BIN pixels of the frame."""
        middle = tuple((axis - 0.5 * (BIN - 1)) / BIN for axis in self.middle)
        return interpolated(BIN * np.maximum(self.rms, FLOOR), middle, shape)


def crude_background(image: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return (level, rms) of Source Extractor's mode on a fine mesh, in the unit of `image` per pixel."""
    import sep

    ny, nx = image.shape
    box = FIRST_BOX // BIN
    background = sep.Background(image, bw=max(1, min(box, nx)), bh=max(1, min(box, ny)))
    rms = np.maximum(background.rms(dtype=np.float32), FLOOR)
    return _unskewed(background.back(dtype=np.float32), rms), rms


def masked_background(image: FloatArray, mask: BoolArray, unusable: IntArray, box: int = SECOND_BOX) -> Mesh | None:
    """Return the `Mesh` of an image (ny, nx) without the pixels in the binned `mask` or where `unusable` is not 0.

    None when all parts are masked.
    """
    height, width = image.shape
    ny = max(1, round(height / box))
    nx = max(1, round(width / box))
    rows = np.linspace(0, height, ny + 1).astype(int)
    columns = np.linspace(0, width, nx + 1).astype(int)
    level, rms = np.full((2, ny, nx), np.nan)
    pixels = np.empty(int(np.diff(rows).max() * np.diff(columns).max()), image.dtype)
    for j in range(ny):
        for i in range(nx):
            n = _unmasked(image, mask, unusable, rows[j], rows[j + 1], columns[i], columns[i + 1], pixels)
            if n >= max(GOOD_MIN * (rows[j + 1] - rows[j]) * (columns[i + 1] - columns[i]), 1):
                level[j, i], rms[j, i] = _clipped(pixels[:n])
    if not np.isfinite(level).any():
        return None
    middle = (0.5 * (rows[1:] + rows[:-1] - 1), 0.5 * (columns[1:] + columns[:-1] - 1))
    return Mesh(_filled(level), _filled(rms), middle)


@numba.njit(cache=True)
def _unmasked(
    image: FloatArray,
    mask: BoolArray,
    unusable: IntArray,
    top: int,
    bottom: int,
    left: int,
    right: int,
    out: FloatArray,
) -> int:
    """Fill `out` with the pixels of a part that are neither in `mask` nor unusable; return their number."""
    n = 0
    for y in range(top, bottom):
        line = mask[min(y // BIN, mask.shape[0] - 1)]
        for x in range(left, right):
            out[n] = image[y, x]
            n += not (line[min(x // BIN, line.size - 1)] or unusable[y, x])
    return n


def _clipped(values: FloatArray) -> tuple[float, float]:
    """Return mean and standard deviation within CLIP sigma; three rounds from the median and scatter of a sample."""
    sample = values[:: max(values.size // SAMPLE, 1)]
    centre = float(np.median(sample))
    # Not robust_sigma: the median of float32 pixels is multiplied in float64
    sigma = SIGMA_PER_MAD * float(np.median(np.abs(sample - centre))) + 0.5  # at least about a DN of rounding
    for _ in range(3):
        centre, sigma = _moments_within(values, centre, CLIP * sigma)
    return centre, sigma


@numba.njit(cache=True)
def _moments_within(values: FloatArray, centre: float, reach: float) -> tuple[float, float]:
    """Return mean and standard deviation of the values within `reach` of `centre`, NaN if there are none."""
    n = 0
    total = 0.0
    squares = 0.0
    for value in values:
        deviation = float(value) - centre
        if abs(deviation) <= reach:
            n += 1
            total += deviation
            squares += deviation * deviation
    if n == 0:
        return math.nan, math.nan
    mean = total / n
    return centre + mean, math.sqrt(max(squares / n - mean * mean, 0.0))


def _filled(mesh: FloatArray) -> FloatArray:
    """Replace missing meshes by the nearest one; then remove isolated outliers with a median over 3 x 3."""
    from scipy.ndimage import distance_transform_edt, median_filter

    near = distance_transform_edt(np.isnan(mesh), return_distances=False, return_indices=True)
    return median_filter(mesh[tuple(near)], 3, mode="nearest")


@numba.njit(cache=True)
def _unskewed(level: FloatArray, rms: FloatArray) -> FloatArray:
    """Return the mean of Poisson + Gaussian noise whose mode estimate is `level`, electron; changes `level`.

    Source Extractor takes 2.5 median - 1.5 mean as the background. For slightly skewed noise the median is
    below the mean by k3 / (6 rms^2), and the third cumulant k3 of sky and dark electrons is their mean; so
    the estimate is low by 5 / 12 of mean / rms^2: 0.2-0.4 electron, 1 % of the flux of a source at S/N 10.
    """
    for y in range(level.shape[0]):
        for x in range(level.shape[1]):
            level[y, x] += np.float32(5.0 / 12.0) * max(level[y, x], np.float32(0.0)) / rms[y, x] ** 2
    return level
