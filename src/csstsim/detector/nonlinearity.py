"""Charge-to-voltage nonlinearity (paper, Appendix B item 8): the polynomial of detector.cubic applied to images.

The signal is in equivalent electrons; the gain is applied later. Left out: memory of the amplifier (dependence on the
previous pixel) and change with temperature.
"""

import numba
import numpy as np

from csstsim.base.types import FloatArray
from csstsim.detector.cubic import check_rising, slope


def bend(image: FloatArray, quadratic: float, cubic: float, limit: float) -> None:
    """Replace charge by signal, in place: `image` (ny, nx) float32 [e-], which may be part of a larger array.

    `quadratic` [1/e-], `cubic` [1/e-^2], `limit` [e-]. Raises ValueError if f does not increase up to the limit (image
    unchanged), and if a value is not finite (the other pixels are then already replaced).
    """
    check_rising(quadratic, cubic, limit)
    numbers = float(quadratic), float(cubic), float(limit), float(slope(limit, quadratic, cubic))
    # Compiled for rows that follow one another in memory, which takes half the time
    parts = [image] if image.flags.c_contiguous else (image[y : y + 1] for y in range(len(image)))
    bad = sum(_bend(part, *numbers) for part in parts)
    if bad:
        raise ValueError(f"the charge of {bad} pixel(s) is not finite")


@numba.njit(cache=True)
def _bend(image: FloatArray, quadratic: float, cubic: float, limit: float, steep: float) -> int:
    """Replace charge by signal; return the number of values that are not finite."""
    bad = 0
    for y in range(image.shape[0]):
        for i in range(image.shape[1]):
            x = np.float64(image[y, i])
            inside = min(max(x, 0.0), limit)
            bent = inside + inside * inside * (quadratic + cubic * inside)
            image[y, i] = bent + (x - inside) * (steep if x > limit else 1.0)
            bad += not abs(x) < np.inf
    return bad
