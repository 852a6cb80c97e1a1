"""The third-order polynomial of the nonlinearity (paper, Appendix B item 8): a test that it increases, and its inverse.

    f(x) = x + quadratic x^2 + cubic x^3    for 0 <= x <= limit

It is continued by its tangents: f(x) = x below zero, slope f'(limit) above the limit. So f and its slope are
continuous, and f increases everywhere if it increases up to the limit.
"""

from typing import TypeVar

import numpy as np
from numpy.typing import ArrayLike

from csstsim.base.types import FloatArray

_ROUNDS = 100  # largest number of steps, for bisection; Newton's method needs about five
_NEAR = 1e-9  # of the limit: tolerance of the inverse
Shaped = TypeVar("Shaped", float, FloatArray)


def slope(x: Shaped, quadratic: float, cubic: float) -> Shaped:
    """Return f', the signal per additional electron, at x [e-] (scalar or array) within 0..limit."""
    return 1 + x * (2 * quadratic + 3 * cubic * x)


def lowest_slope(quadratic: float, cubic: float, limit: float) -> float:
    """Return the smallest f' within 0..limit [e-]; f increases there if it is positive."""
    places = [0.0, limit]
    if cubic:
        places.append(min(max(-quadratic / (3 * cubic), 0.0), limit))
    return min(slope(x, quadratic, cubic) for x in places)


def check_rising(quadratic: float, cubic: float, limit: float) -> None:
    """Raise ValueError, naming the range, if f does not increase over 0..limit."""
    lowest = lowest_slope(quadratic, cubic, limit)
    if not (limit > 0 and lowest > 0):
        raise ValueError(f"the signal does not rise over 0..{limit:g} e-: the lowest slope is {lowest:.3g}")


def straighten(signal: ArrayLike, quadratic: float, cubic: float, limit: float) -> FloatArray:
    """Return the charge [e-] (float64) of `signal` [e-], an array of any shape: the inverse of f, to 1e-9 of the limit.

    Newton's method, with bisection where a step would leave the bracket. Values that are not finite are kept. Raises
    ValueError if f does not increase over 0..limit.
    """
    check_rising(quadratic, cubic, limit)
    y = np.asarray(signal, float)
    top = limit + limit**2 * (quadratic + cubic * limit)
    charge = np.where(y > top, limit + (y - top) / slope(limit, quadratic, cubic), y)
    within = (y > 0) & (y <= top)
    y = y[within]
    low = np.zeros_like(y)
    high = np.full_like(y, limit)
    x = y * (limit / top)
    for _ in range(_ROUNDS):
        off = x + x**2 * (quadratic + cubic * x) - y
        low = np.where(off > 0, low, x)
        high = np.where(off > 0, x, high)
        step = x - off / slope(x, quadratic, cubic)
        step = np.where((step >= low) & (step <= high), step, (low + high) / 2)
        done = np.max(np.abs(step - x), initial=0) < _NEAR * limit
        x = step
        if done:
            break
    charge[within] = x
    return charge
