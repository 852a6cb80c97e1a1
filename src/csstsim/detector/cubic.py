"""The third-order polynomial of the nonlinearity (paper, Appendix B item 8): a test that it increases, and its inverse.

    f(x) = x + quadratic x^2 + cubic x^3    for 0 <= x <= limit

It is continued by its tangents: f(x) = x below zero, slope f'(limit) above the limit. So f and its slope are
continuous, and f increases everywhere if it increases up to the limit.
"""

from typing import TypeVar

import numpy as np
from numpy.typing import ArrayLike

from csstsim.base.types import FloatArray

_ITERATIONS = 100  # largest number of steps, for bisection; Newton's method needs about five
_TOLERANCE = 1e-9  # of the limit: tolerance of the inverse
Shaped = TypeVar("Shaped", float, FloatArray)


def slope(x: Shaped, quadratic: float, cubic: float) -> Shaped:
    """Return f', the signal per additional electron, at x [e-] (scalar or array) within 0..limit."""
    return 1 + x * (2 * quadratic + 3 * cubic * x)


def smallest_slope(quadratic: float, cubic: float, limit: float) -> float:
    """Return the smallest f' within 0..limit [e-]; f increases there if it is positive."""
    candidates = [0.0, limit]
    if cubic:
        candidates.append(min(max(-quadratic / (3 * cubic), 0.0), limit))
    return min(slope(x, quadratic, cubic) for x in candidates)


def check_increasing(quadratic: float, cubic: float, limit: float) -> None:
    """Raise ValueError, naming the range, if f does not increase over 0..limit."""
    smallest = smallest_slope(quadratic, cubic, limit)
    if not (limit > 0 and smallest > 0):
        raise ValueError(f"the signal does not increase over 0..{limit:g} e-: the smallest slope is {smallest:.3g}")


def linearise(signal: ArrayLike, quadratic: float, cubic: float, limit: float) -> FloatArray:
    """Return the charge [e-] (float64) of `signal` [e-], an array of any shape: the inverse of f, to 1e-9 of the limit.

    Newton's method, with bisection where a step would leave the bracket. Values that are not finite are kept. Raises
    ValueError if f does not increase over 0..limit.
    """
    check_increasing(quadratic, cubic, limit)
    y = np.asarray(signal, float)
    top = limit + limit**2 * (quadratic + cubic * limit)
    charge = np.where(y > top, limit + (y - top) / slope(limit, quadratic, cubic), y)
    within = (y > 0) & (y <= top)
    y = y[within]
    low = np.zeros_like(y)
    high = np.full_like(y, limit)
    x = y * (limit / top)
    for _ in range(_ITERATIONS):
        error = x + x**2 * (quadratic + cubic * x) - y
        low = np.where(error > 0, low, x)
        high = np.where(error > 0, x, high)
        step = x - error / slope(x, quadratic, cubic)
        step = np.where((step >= low) & (step <= high), step, (low + high) / 2)
        done = np.max(np.abs(step - x), initial=0) < _TOLERANCE * limit
        x = step
        if done:
            break
    charge[within] = x
    return charge
