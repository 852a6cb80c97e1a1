"""Numbers of haloes of bias b, relative to their mean, where a normal field delta of variance sigma^2 is x sigma.

    f(x) = c exp(beta x) up to the bend x_0,   c exp(beta x_0) (1 + beta (x - x_0)) beyond,    x_0 = max(bend, beta)

beta and c are such that the mean is 1, and the correlation of haloes with the field is b times that of the field:
<f> = 1, <x f> = b sigma. Without a bend f is exp(b delta - b^2 sigma^2 / 2), and rare clusters cluster too strongly:
their correlation is exp(b^2 xi). With the bend, haloes of two kinds have

    xi_12 = sum_n a_n a'_n r^n / n!,      a_n = <f He_n>,   a_0 = 1,  a_1 = b sigma,   r: correlation of their fields
"""

from math import factorial

import numpy as np
from scipy.special import ndtr

from csstsim.base.types import FloatArray, Floats

_BEND = 1.5  # sigma, up to which haloes are lognormal; matter nearly is
_BETA = np.linspace(0.0, 8.0, 801)
_ORDERS = 24  # of the series
_X, _W = np.polynomial.hermite_e.hermegauss(120)


def _table() -> tuple[FloatArray, FloatArray]:
    """Return b sigma and ln c at _BETA."""
    beta = _BETA
    bend = np.maximum(_BEND, _BETA)
    below = np.exp(0.5 * beta**2) * ndtr(bend - beta)
    at_bend = np.exp(beta * bend)
    above = ndtr(-bend)
    density = np.exp(-0.5 * bend**2) / np.sqrt(2 * np.pi)
    mean = below + at_bend * ((1 - beta * bend) * above + beta * density)
    return beta * (below + at_bend * above) / mean, -np.log(mean)


_STRENGTH, _LN_C = _table()


def intensity(delta: Floats, bias: Floats, variance: Floats) -> FloatArray:
    """Return f, 1 where the variance is 0; delta, bias and variance broadcast."""
    sigma = np.sqrt(np.asarray(variance, float))
    x = np.divide(delta, sigma, out=np.zeros(np.broadcast(delta, sigma).shape), where=sigma > 0)
    beta = np.interp(bias * sigma, _STRENGTH, _BETA)
    bend = np.maximum(_BEND, beta)
    below_bend = np.minimum(x, bend)
    return np.exp(np.interp(beta, _BETA, _LN_C) + beta * below_bend) * (1 + beta * (x - below_bend))


def series(strength: Floats) -> FloatArray:
    """Return a_n (n, ...) for n = 0 to 23 at b sigma = `strength`."""
    strength = np.asarray(strength, float)
    f = intensity(_X, strength[..., None], 1.0) * _W / np.sqrt(2 * np.pi)
    return np.stack([f @ np.polynomial.hermite_e.hermeval(_X, np.eye(n + 1)[n]) for n in range(_ORDERS)])


def excess(first: FloatArray, second: FloatArray, r: FloatArray) -> FloatArray:
    """Return xi_12 minus its linear term (..., theta), for series `first`, `second` (n, ...) and r (..., theta)."""
    total = np.zeros(np.shape(r))
    for n in range(_ORDERS - 1, 1, -1):
        total = total * r + (first[n] * second[n] / factorial(n))[..., None]
    return total * r**2
