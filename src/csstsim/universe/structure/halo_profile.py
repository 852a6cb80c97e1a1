"""A halo as a lens: an NFW density that ends in steps, less a disc of the same mass.

Simulated haloes have no edge. With one at the virial radius, shear is 18% too large beside it. So the density is the
mean of NFW spheres cut at several radii x = t c (haloes.cuts of structure.yaml), and a halo holds M mu. In units of
M / pi, with y = R / R_c, x = R / r_s, m(c) = ln(1 + c) - c / (1 + c), mu = mean m(t c) / m(c), F and G means over cuts:

    Sigma  = F(x) / (2 r_s^2 m(c)) - 4 mu / R_c^2 (1 - y^2)^3,
    mean inside R = (F + G)(x) / (2 r_s^2 m(c)) - mu (1 - (1 - y^2)^4) / R^2,       gamma_t ~ mean - Sigma

F and G: Takada & Jain 2003 (MNRAS 340, 580, equation 27; 344, 857, equation 17). The disc takes back the mass that the
halo was made of: beyond R_c there is neither convergence nor shear, and the mean density stays what it was. Transforms:

    u(k): of a cut NFW sphere (Cooray & Sheth 2002, equation 81),     g(k) = 384 J_4(k R_c) / (k R_c)^4
"""

import numpy as np
from numba import njit
from scipy.special import jv, sici

_NEAR_ONE = 2e-3  # of x^2: there F and G lose digits, and are taken from both sides
_CENTRE = 1e-6  # least x: F has no limit at the centre


def nfw_transform(k, radius, c):
    """Return u(k), 1 at k = 0: k [1 / Mpc], virial radius [Mpc] and concentration broadcast."""
    x = np.asarray(k * radius / c, float)
    (si0, ci0), (si1, ci1) = sici(x), sici(x * (1 + c))
    return (np.sin(x) * (si1 - si0) + np.cos(x) * (ci1 - ci0) - np.sin(c * x) / ((1 + c) * x)) / nfw_mass(c)


@njit(cache=True)
def nfw_mass(c):
    """Return m(c) = ln(1 + c) - c / (1 + c)."""
    return np.log1p(c) - c / (1 + c)


def whole_mass(c, cuts):
    """Return mu, the mass of a halo of concentration c (broadcasts) over that within its virial radius."""
    return sum(nfw_mass(t * c) for t in cuts) / (len(cuts) * nfw_mass(c))


def halo_transform(k, radius, c, cuts):
    """Return the transform of a halo's density, 1 at k = 0; arguments as for `nfw_transform`."""
    parts = [nfw_mass(t * c) for t in cuts]
    return sum(m * nfw_transform(k, t * radius, t * c) for m, t in zip(parts, cuts, strict=True)) / sum(parts)


def disc_radius(mass_function, mass, numbers):
    """Return R_c [Mpc, comoving] of haloes of `mass` [solar]; numbers: section haloes of structure.yaml."""
    ratio = np.interp(np.log(mass), np.log(numbers["compensation"]["mass"]), numbers["compensation"]["ratio"])
    return ratio * mass_function.lagrangian_radius(mass)


def disc_transform(k, radius):
    """Return g(k), 1 at k = 0, of the disc of `radius` R_c."""
    x = np.maximum(np.asarray(k * radius, float), 0.1)  # nearer to 0 the quotient loses digits
    exact = 384 * jv(4, x) / x**4
    return np.where(k * radius < 0.1, 1 - (k * radius) ** 2 / 20, exact)


@njit(cache=True)
def nfw_projected(x, c):
    """Return F and G at x = R / r_s > 0 for a sphere cut at x = c; beyond, F is 0 and G = 2 m(c) / x^2."""
    x = max(x, _CENTRE)
    if x >= c:
        return 0.0, 2 * nfw_mass(c) / x**2
    if abs(x * x - 1) < _NEAR_ONE and c * c > 1 + _NEAR_ONE:
        t = (x * x - 1 + _NEAR_ONE) / (2 * _NEAR_ONE)
        low, high = _projected(np.sqrt(1 - _NEAR_ONE), c), _projected(np.sqrt(1 + _NEAR_ONE), c)
        return (1 - t) * low[0] + t * high[0], (1 - t) * low[1] + t * high[1]
    return _projected(x, c)


@njit(cache=True)
def _projected(x, c):
    x2 = x * x
    root, gap, ratio = np.sqrt(c * c - x2), 1 - x2, (x2 + c) / (x * (1 + c))
    if gap > 0:
        turn = np.arccosh(max(ratio, 1.0)) / gap**1.5
    else:
        turn = -np.arccos(min(ratio, 1.0)) / (-gap) ** 1.5
    f = turn - root / (gap * (1 + c))
    g = ((2 - x2) * root / gap - 2 * c) / (1 + c) + 2 * np.log(x * (1 + c) / (c + root)) + (2 - 3 * x2) * turn
    return f, g / x2
