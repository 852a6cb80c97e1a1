"""Charge-to-voltage nonlinearity (paper, Appendix B item 8): the polynomial of detector.cubic applied to images.

The signal is in equivalent electrons; the gain is applied later. Left out: memory of the amplifier (dependence on the
previous pixel) and change with temperature.
"""

import numba
import numpy as np

from csstsim.detector.cubic import check_rising, slope


def bend(image, quadratic, cubic, limit):
    """Replace charge by signal, in place: `image` (ny, nx) float32 [e-], which may be part of a larger array.

    `quadratic` [1/e-], `cubic` [1/e-^2], `limit` [e-]. Raises ValueError if f does not increase up to the limit (image
    unchanged), and if a value is not finite (the other pixels are then already replaced).
    """
    check_rising(quadratic, cubic, limit)
    steep, bad = float(slope(limit, quadratic, cubic)), 0
    for row in image:
        bad += _bend(row, float(quadratic), float(cubic), float(limit), steep)
    if bad:
        raise ValueError(f"the charge of {bad} pixel(s) is not finite")


@numba.njit(cache=True)
def _bend(row, quadratic, cubic, limit, steep):
    """Replace the charge of a row by signal; return the number of values that are not finite."""
    bad = 0
    for i in range(len(row)):
        x = np.float64(row[i])
        inside = min(max(x, 0.0), limit)
        row[i] = inside + inside * inside * (quadratic + cubic * inside) + (x - inside) * (steep if x > limit else 1.0)
        bad += not abs(x) < np.inf
    return bad
