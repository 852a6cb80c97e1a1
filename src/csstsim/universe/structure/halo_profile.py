"""A halo as a lens: an NFW density that ends in steps, less a disc of the same mass.

Simulated haloes have no edge. With an edge at the virial radius, shear is 18% too large near it. So the density is the
mean of NFW spheres cut at several radii x = t c (haloes.cuts of structure.yaml), and a halo holds M mu. In units of
M / pi, with y = R / R_c, x = R / r_s, m(c) = ln(1 + c) - c / (1 + c), mu = mean m(t c) / m(c), F and G means over cuts:

    Sigma  = F(x) / (2 r_s^2 m(c)) - 4 mu / R_c^2 (1 - y^2)^3,
    mean inside R = (F + G)(x) / (2 r_s^2 m(c)) - mu (1 - (1 - y^2)^4) / R^2,       gamma_t ~ mean - Sigma

F and G: Takada & Jain 2003 (MNRAS 340, 580, equation 27; 344, 857, equation 17). The disc has minus the halo's mass, as
the halo was made of matter around it. So beyond R_c there is neither convergence nor shear, and the mean density does
not change. Transforms:

    u(k): of a cut NFW sphere (Cooray & Sheth 2002, equation 81),     g(k) = 384 J_4(k R_c) / (k R_c)^4
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numba import njit
from scipy.special import jv, sici

from csstsim.base.types import FloatArray, Floats

if TYPE_CHECKING:
    from csstsim.universe.structure.mass_function import HaloMassFunction

_NEAR_ONE = 2e-3  # distance of x^2 from 1 within which F and G lose digits, and are interpolated
_CENTRE = 1e-6  # minimum x: F has no limit at the centre


def nfw_transform(k: Floats, radius: Floats, c: Floats) -> FloatArray:
    """Return u(k), 1 at k = 0: k [1 / Mpc], virial radius [Mpc] and concentration broadcast."""
    x = np.asarray(k * radius / c, float)
    (si0, ci0), (si1, ci1) = sici(x), sici(x * (1 + c))
    return (np.sin(x) * (si1 - si0) + np.cos(x) * (ci1 - ci0) - np.sin(c * x) / ((1 + c) * x)) / nfw_mass(c)


@njit(cache=True)
def nfw_mass(c: Floats) -> FloatArray:
    """Return m(c) = ln(1 + c) - c / (1 + c)."""
    return np.log1p(c) - c / (1 + c)


def whole_mass(c: Floats, cuts: Sequence[float]) -> FloatArray:
    """Return mu, the mass of a halo of concentration c (broadcasts) in units of that within its virial radius."""
    return sum(nfw_mass(t * c) for t in cuts) / (len(cuts) * nfw_mass(c))


def halo_transform(k: Floats, radius: Floats, c: Floats, cuts: Sequence[float]) -> FloatArray:
    """Return the transform of a halo's density, 1 at k = 0; arguments as for `nfw_transform`."""
    parts = [nfw_mass(t * c) for t in cuts]
    whole = sum(m * nfw_transform(k, t * radius, t * c) for m, t in zip(parts, cuts, strict=True))
    return whole / sum(parts)  # type: ignore[return-value]  # there are cuts


def disc_radius(mass_function: HaloMassFunction, mass: Floats, numbers: Mapping[str, Any]) -> FloatArray:
    """Return R_c [Mpc, comoving] of haloes of `mass` [solar]; numbers: section haloes of structure.yaml."""
    ratio = np.interp(np.log(mass), np.log(numbers["compensation"]["mass"]), numbers["compensation"]["ratio"])
    return ratio * mass_function.lagrangian_radius(mass)


def disc_transform(k: Floats, radius: Floats) -> FloatArray:
    """Return g(k), 1 at k = 0, of the disc of `radius` R_c."""
    x = np.maximum(np.asarray(k * radius, float), 0.1)  # closer to 0 the quotient loses digits
    exact = 384 * jv(4, x) / x**4
    return np.where(k * radius < 0.1, 1 - (k * radius) ** 2 / 20, exact)


@njit(cache=True)
def nfw_projected(x: float, cuts: FloatArray, masses: FloatArray) -> tuple[float, float]:
    """Return the sums of F and G at x = R / r_s over NFW spheres cut at `cuts`, up to 4; masses: nfw_mass(cuts).

    Beyond its cut a sphere has F = 0 and G = 2 m / x^2.
    """
    x = max(x, _CENTRE)
    if abs(x * x - 1) < _NEAR_ONE:
        t = (x * x - 1 + _NEAR_ONE) / (2 * _NEAR_ONE)
        f_low, g_low = _projected(np.sqrt(1 - _NEAR_ONE), cuts, masses)
        f_high, g_high = _projected(np.sqrt(1 + _NEAR_ONE), cuts, masses)
        return (1 - t) * f_low + t * f_high, (1 - t) * g_low + t * g_high
    return _projected(x, cuts, masses)


@njit(cache=True)
def _projected(x: float, cuts: FloatArray, masses: FloatArray) -> tuple[float, float]:
    """As nfw_projected, not near x = 1. The sum of the spheres' logarithms or angles is that of one product."""
    x2 = x * x
    gap = 1 - x * x
    side = np.sqrt(abs(gap))
    roots = ratios = mass_outside = imaginary = 0.0
    real = denominator = product = 1.0
    for k in range(len(cuts)):
        cut = cuts[k]
        if x >= cut:
            mass_outside += masses[k]
            continue
        root = np.sqrt(cut * cut - x2)
        roots += root / (1 + cut)
        ratios += cut / (1 + cut)
        denominator *= x * (1 + cut)
        product *= cut + root
        if gap > 0:
            real *= x2 + cut + side * root
        else:
            real, imaginary = (real * (x2 + cut) - imaginary * side * root, imaginary * (x2 + cut) + real * side * root)
    if gap > 0:
        angle = np.log(real / denominator) / (gap * side)
    else:
        angle = (np.arctan2(imaginary, real) % (2 * np.pi)) / (gap * side)
    f = angle - roots / gap
    g = (2 - x2) * roots / gap - 2 * ratios + 2 * np.log(denominator / product) + (2 - 3 * x2) * angle
    return f, (g + 2 * mass_outside) / x2
