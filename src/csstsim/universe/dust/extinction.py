"""Extinction by the Milky Way's dust: its wavelength dependence, and E(B-V) in front of a star.

    S_obs(lambda) = S(lambda) 10^(-0.4 A(V) k(lambda)),   k = A(lambda)/A(V)

`odonnell94`, the default (paper, appendix C), is k = a(x) + b(x) / R_V with x = 1 um / lambda: O'Donnell (1994,
ApJ 422, 158) between 1.1 and 3.3 um-1, Cardelli, Clayton & Mathis (1989, ApJ 345, 245) elsewhere. The two join with
steps of 1% or less, kept as published. `fitzpatrick99` is Fitzpatrick (1999, PASP 111, 63): below 2700 A the form of
Fitzpatrick & Massa (1990, ApJS 72, 163), above a cubic spline through points. Left out: variation of R_V on the sky.
"""

from collections.abc import Callable

import numpy as np
from numpy.polynomial.polynomial import polyval

from csstsim.base.errors import InputError
from csstsim.base.types import FloatArray, Floats

# The published polynomials, (a, b) each, lowest power first.
_INFRARED = 0.574, -0.527  # times x^1.61
_OPTICAL = (  # in x - 1.82
    (1.0, 0.104, -0.609, 0.701, 1.137, -1.718, -0.827, 1.647, -0.505),
    (0.0, 1.952, 2.908, -3.989, -7.985, 11.102, 5.491, -10.805, 3.347),
)
_ULTRAVIOLET = (  # c0 + c1 x + c2 / ((x - c3)^2 + c4)
    (1.752, -0.316, -0.104, 4.67, 0.341),
    (-3.090, 1.825, 1.206, 4.62, 0.263),
)
_RISE = (0.0, 0.0, -0.04473, -0.009779), (0.0, 0.0, 0.2130, 0.1207)  # in x - 5.9, above 5.9 um-1
_FAR_ULTRAVIOLET = (-1.073, -0.628, 0.137, -0.070), (13.670, 4.257, -0.420, 0.374)  # in x - 8, above 8 um-1

# Fitzpatrick 1999: the bump's and the rise's strength, the bump's middle and width [um-1]
_BUMP = 3.23
_FAR_RISE = 0.41
_BUMP_X = 4.596
_BUMP_WIDTH = 0.99
_SPLINE = (26500.0, 12200.0, 6000.0, 5470.0, 4670.0, 4110.0)  # angstrom, points of the optical and infrared spline
_SPLINE_END = (2700.0, 2600.0)  # angstrom, further points, on the ultraviolet form, which begins at the first


def odonnell(wavelength: Floats, r_v: float = 3.1) -> FloatArray:
    """Return the extinction curve of O'Donnell (1994).

    Parameters
    ----------
    wavelength : float or ndarray
        Angstrom, 1000 to 33,333.
    r_v : float
        R_V = A(V) / E(B-V).

    Returns
    -------
    float or ndarray, shape of `wavelength`
        A(lambda) / A(V).

    Raises
    ------
    InputError
        If a wavelength is outside the range or NaN.

    Examples
    --------
    >>> print(odonnell(5500.0).round(3))
    0.999
    """
    x = _wavenumber(wavelength)
    return _coefficient(x, 0) + _coefficient(x, 1) / r_v


def fitzpatrick(wavelength: Floats, r_v: float = 3.1) -> FloatArray:
    """Return A(lambda)/A(V) as `odonnell`, by the law of Fitzpatrick (1999)."""
    from scipy.interpolate import CubicSpline

    x = _wavenumber(wavelength)
    points = 1e4 / np.array(_SPLINE)
    ends = 1e4 / np.array(_SPLINE_END)
    over_ebv = np.array(
        [
            0.265 * r_v / 3.1,
            0.829 * r_v / 3.1,
            -0.426 + 1.0044 * r_v,
            -0.050 + 1.0016 * r_v,
            0.701 + 1.0016 * r_v,
            1.208 + 1.0032 * r_v - 0.00033 * r_v**2,  # table 4 prints -1.208, which is not the curve of table 3
        ]
    )
    spline = CubicSpline(
        [0.0, *points, *ends], [0.0, *over_ebv / r_v, *_fitzpatrick_massa(ends, r_v)], bc_type="natural"
    )
    return np.where(x < ends[0], spline(x), _fitzpatrick_massa(x, r_v))


LAWS: dict[str, Callable[[Floats, float], FloatArray]] = {"odonnell94": odonnell, "fitzpatrick99": fitzpatrick}


def star_ebv(ebv_inf: Floats, distance: Floats, b: Floats, height: float, reach: float) -> FloatArray:
    """Return E(B-V) [mag] in front of a star at `distance` [pc] and galactic latitude `b` [deg].

    E(d) = E_inf (1 - exp(-d / s)), s = height / |sin b|: the column through an exponential layer of scale height
    `height` [pc], scaled to the whole column `ebv_inf` (paper, appendix C; Chen et al. 2023). Towards b = 0, s would be
    infinite and no star reddened; because the disc of dust ends, s is at most `reach` [pc]. An infinite distance gives
    E_inf, a zero or negative one gives 0, NaN gives NaN.
    """
    with np.errstate(divide="ignore"):
        scale = np.minimum(height / np.abs(np.sin(np.radians(b))), reach)
    return -ebv_inf * np.expm1(-np.maximum(distance, 0.0) / scale)


def _wavenumber(wavelength: Floats) -> FloatArray:
    """Return 1 / wavelength [1 / um]. Raises InputError outside the range of the laws, 1000 to 33,333 angstrom."""
    wavelength = np.asarray(wavelength, dtype=float)
    with np.errstate(divide="ignore"):
        x = 1e4 / wavelength
    bad = ~((x >= 0.3 * (1 - 1e-12)) & (x <= 10 * (1 + 1e-12)))
    if bad.any():
        raise InputError(
            "outside the extinction law", key="wavelength", value=float(wavelength[bad][0]), allowed="1000..33333 A"
        )
    return x


def _coefficient(x: FloatArray, k: int) -> FloatArray:
    """Return a(x) (k = 0) or b(x) (k = 1) of O'Donnell's law."""
    pieces = [x < 1.1, x < 3.3, x <= 8.0]
    values = [_infrared(x, k), polyval(x - 1.82, _OPTICAL[k]), _ultraviolet(x, k)]
    return np.select(pieces, values, _far_ultraviolet(x, k))


def _fitzpatrick_massa(x: FloatArray, r_v: float) -> FloatArray:
    """Return A(lambda)/A(V) in the ultraviolet: a line, a bump at 2175 A and a rise beyond 5.9 um-1."""
    slope = -0.824 + 4.717 / r_v
    line = 2.030 - 3.007 * slope + slope * x
    bump = _BUMP * x**2 / ((x**2 - _BUMP_X**2) ** 2 + x**2 * _BUMP_WIDTH**2)
    beyond = np.maximum(x - 5.9, 0.0)
    rise = _FAR_RISE * (0.5392 * beyond**2 + 0.05644 * beyond**3)
    return 1 + (line + bump + rise) / r_v


def _infrared(x: FloatArray, k: int) -> FloatArray:
    return _INFRARED[k] * x**1.61


def _ultraviolet(x: FloatArray, k: int) -> FloatArray:
    c = _ULTRAVIOLET[k]
    return c[0] + c[1] * x + c[2] / ((x - c[3]) ** 2 + c[4]) + polyval(np.maximum(x - 5.9, 0.0), _RISE[k])


def _far_ultraviolet(x: FloatArray, k: int) -> FloatArray:
    return polyval(x - 8.0, _FAR_ULTRAVIOLET[k])
