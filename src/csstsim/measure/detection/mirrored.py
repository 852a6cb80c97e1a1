"""Is a peak on one side of a source only? Its flux less that at the mirrored place, on the other side of the source.

Stars and galaxies look alike on both sides of their centres, whatever their profile: a disc, a ring of the PSF. What is
brighter on one side is another source. The flux is that of a Gaussian, as in detection (peaks). The error contains the
noise of both places, and what the error of the centre makes of the gradient.
"""

import math
from typing import NamedTuple, Self

import numba
import numpy as np

from csstsim.base.types import FloatArray
from csstsim.measure.detection.maps import BIN
from csstsim.measure.detection.peaks import smoothing_sigma


class Smoothed(NamedTuple):
    """An image, float32 (ny, nx), and the noise of a pixel on bins of BIN px.

    sigma [px] of the Gaussian; factor: a point's flux over its weighted sum.
    """

    image: FloatArray
    rms: FloatArray
    sigma: float
    factor: float

    @classmethod
    def of(cls, image: FloatArray, rms: FloatArray, kernel: FloatArray) -> Self:
        """Return the Smoothed of an image for a PSF's stamp `kernel` (n, n) on pixels, n odd."""
        sigma = smoothing_sigma(kernel)
        r2 = (np.arange(len(kernel)) - len(kernel) // 2) ** 2
        weight = np.exp(-0.5 * (r2[:, None] + r2) / sigma**2)
        return cls(image, rms, sigma, float(kernel.sum() / (weight * kernel).sum()))


@numba.njit(cache=True)
def mirrored_excess(
    smoothed: Smoothed, x: float, y: float, centre_x: float, centre_y: float, snr: float
) -> tuple[float, float]:
    """Return the flux [electron] at x, y less that at the mirrored place about a centre, and its error.

    snr: of the source in the centre. Positions in px of the image; the flux is 0 beyond it.
    """
    away_x = centre_x - x
    away_y = centre_y - y
    distance = max(math.hypot(away_x, away_y), 1e-6)
    flux, variance = _flux(smoothed, x, y)
    mirrored, mirrored_variance = _flux(smoothed, x + 2.0 * away_x, y + 2.0 * away_y)
    half = 0.5 / distance  # half a pixel along the line
    nearer, _ = _flux(smoothed, x + (2.0 - half) * away_x, y + (2.0 - half) * away_y)
    farther, _ = _flux(smoothed, x + (2.0 + half) * away_x, y + (2.0 + half) * away_y)
    shift = 2.0 * smoothed.sigma / max(snr, 1.0)
    error = math.sqrt(variance + mirrored_variance + (shift * (nearer - farther)) ** 2)
    return flux - mirrored, error


@numba.njit(cache=True)
def _flux(smoothed: Smoothed, x: float, y: float) -> tuple[float, float]:
    """Return (flux, variance) of a point at x, y by the weighted sum."""
    ny, nx = smoothed.image.shape
    reach = 3.0 * smoothed.sigma
    total = 0.0
    variance = 0.0
    for row in range(max(math.ceil(y - reach), 0), min(math.floor(y + reach) + 1, ny)):
        for column in range(max(math.ceil(x - reach), 0), min(math.floor(x + reach) + 1, nx)):
            weight = math.exp(-0.5 * ((column - x) ** 2 + (row - y) ** 2) / smoothed.sigma**2)
            electrons = float(smoothed.image[row, column])
            total += weight * electrons
            variance += weight**2 * (float(smoothed.rms[row // BIN, column // BIN]) ** 2 + max(electrons, 0.0))
    return smoothed.factor * total, smoothed.factor**2 * variance
