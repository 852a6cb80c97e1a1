"""Charge-to-voltage nonlinearity (paper, Appendix B item 8): the polynomial of detector.cubic applied to images.

The signal is in equivalent electrons; the gain is applied later. Left out: memory of the amplifier (dependence on the
previous pixel) and change with temperature.
"""

import numba
import numpy as np

from csstsim.base.types import FloatArray
from csstsim.detector.cubic import check_increasing, slope


def apply_nonlinearity(image: FloatArray, quadratic: float, cubic: float, limit: float) -> None:
    """Replace charge by signal, in place: `image` (ny, nx) float32 [e-], which may be part of a larger array.

    `quadratic` [1/e-], `cubic` [1/e-^2], `limit` [e-]. Raises ValueError if f does not increase up to the limit (image
    unchanged), and if a value is not finite (the other pixels are then already replaced).
    """
    check_increasing(quadratic, cubic, limit)
    parameters = float(quadratic), float(cubic), float(limit), float(slope(limit, quadratic, cubic))
    # Compiled for rows that are contiguous in memory, which takes half the time
    blocks = [image] if image.flags.c_contiguous else (image[y : y + 1] for y in range(len(image)))
    not_finite = sum(_apply(block, *parameters) for block in blocks)
    if not_finite:
        raise ValueError(f"the charge of {not_finite} pixel(s) is not finite")


@numba.njit(cache=True)
def _apply(image: FloatArray, quadratic: float, cubic: float, limit: float, slope_above: float) -> int:
    """Replace charge by signal; return the number of values that are not finite."""
    bad = 0
    for y in range(image.shape[0]):
        for i in range(image.shape[1]):
            charge = np.float64(image[y, i])
            within = min(max(charge, 0.0), limit)
            signal = within + within * within * (quadratic + cubic * within)
            image[y, i] = signal + (charge - within) * (slope_above if charge > limit else 1.0)
            bad += not abs(charge) < np.inf
    return bad
