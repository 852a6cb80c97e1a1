"""The third-order polynomial of the nonlinearity (paper, Appendix B item 8): where it rises, and its inverse.

    f(x) = x + quadratic x^2 + cubic x^3    for 0 <= x <= limit

and the tangents beyond: f(x) = x below zero, slope f'(limit) above the limit. So f and its slope are continuous, and f
rises everywhere if it does up to the limit.
"""

import numpy as np

_ROUNDS = 100  # of halving in the worst case; Newton's steps need about five
_NEAR = 1e-9  # of the limit: where the search ends


def slope(x, quadratic, cubic):
    """Return f', the signal that an electron more gives, at x [e-] (scalar or array) within 0..limit."""
    return 1 + x * (2 * quadratic + 3 * cubic * x)


def lowest_slope(quadratic, cubic, limit):
    """Return the lowest f' within 0..limit [e-]: f rises there if it is positive."""
    places = [0.0, limit]
    if cubic:
        places.append(min(max(-quadratic / (3 * cubic), 0.0), limit))
    return min(slope(x, quadratic, cubic) for x in places)


def check_rising(quadratic, cubic, limit):
    """Raise ValueError, naming the range, if f does not rise over 0..limit."""
    lowest = lowest_slope(quadratic, cubic, limit)
    if not (limit > 0 and lowest > 0):
        raise ValueError(f"the signal does not rise over 0..{limit:g} e-: the lowest slope is {lowest:.3g}")


def straighten(signal, quadratic, cubic, limit):
    """Return the charge [e-] (float64) of `signal` [e-], an array of any shape: the inverse of f, to 1e-9 of the limit.

    Newton's steps, and a halving of the bracket wherever one would leave it. Values that are not finite stay. Raises
    ValueError if f does not rise over 0..limit.
    """
    check_rising(quadratic, cubic, limit)
    y = np.asarray(signal, float)
    top = limit + limit**2 * (quadratic + cubic * limit)
    charge = np.where(y > top, limit + (y - top) / slope(limit, quadratic, cubic), y)
    within = (y > 0) & (y <= top)
    y = y[within]
    low, high, x = np.zeros_like(y), np.full_like(y, limit), y * (limit / top)
    for _ in range(_ROUNDS):
        off = x + x**2 * (quadratic + cubic * x) - y
        low, high = np.where(off > 0, low, x), np.where(off > 0, x, high)
        step = x - off / slope(x, quadratic, cubic)
        step = np.where((step >= low) & (step <= high), step, (low + high) / 2)
        done = np.max(np.abs(step - x), initial=0) < _NEAR * limit
        x = step
        if done:
            break
    charge[within] = x
    return charge
