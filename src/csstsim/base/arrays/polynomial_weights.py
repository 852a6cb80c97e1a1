"""Weights of the values at equidistant nodes in the interpolating polynomial.

The functions accept numbers or arrays. Modules with numba kernels compile them: `numba.njit()(cubic_weights)`. At four
nodes both functions are equal except for rounding; products depend on the last bit, so callers must not change between
them. For other nodes see optics.psf.interpolation.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from csstsim.base.types import FloatArray, Floats


def cubic_weights(t: Floats) -> tuple[Floats, Floats, Floats, Floats]:
    """Return the weights of four values, at -1, 0, 1, 2, in the cubic through them at t, 0 to 1."""
    a = t + 1.0
    b = t - 1.0
    c = t - 2.0
    return -t * b * c / 6.0, a * b * c / 2.0, -a * t * c / 2.0, a * t * b / 6.0


def lagrange_weights(t: Floats, points: int, weights: FloatArray) -> None:
    """Fill `weights` of values at 0..points - 1 in the polynomial through them at t.

    weights: (points,) for a number t, (points, n) for t (n,). With a constant `points`, kernels unroll the loops.
    """
    for i in range(points):
        weights[i] = 1.0
        for j in range(points):
            if j != i:
                weights[i] *= (t - j) / (i - j)
