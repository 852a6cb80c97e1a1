"""Weights of the values at even nodes in the polynomial through them.

They are plain functions of numbers or arrays. Modules with numba kernels compile them: `numba.njit()(cubic_weights)`.
At four nodes both are equal but for rounding. Products depend on the last bit, so a caller stays with the one it has.
Uneven nodes: optics.psf.interpolation.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from csstsim.base.types import FloatArray, Floats


def cubic_weights(t: Floats) -> tuple[Floats, Floats, Floats, Floats]:
    """Return the weights of four values, at -1, 0, 1, 2, of the cubic through them at t within 0..1."""
    a = t + 1.0
    b = t - 1.0
    c = t - 2.0
    return -t * b * c / 6.0, a * b * c / 2.0, -a * t * c / 2.0, a * t * b / 6.0


def lagrange_weights(t: Floats, points: int, weights: FloatArray) -> None:
    """Fill `weights` of values at 0..points - 1 for the polynomial through them at t.

    They are (points,) at a number, (points, n) at t (n,). Kernels give `points` as a constant: the loops are unrolled.
    """
    for i in range(points):
        weights[i] = 1.0
        for j in range(points):
            if j != i:
                weights[i] *= (t - j) / (i - j)
