"""Sersic profiles of any index: flux, radii, brightness and transforms (photons: profiles.sersic_photons).

For the stamps of galaxies a profile is split in two: an inner part for the Fourier transform and an outer part for real
space.

With r in units of the half-light radius and the total flux 1,

    I(r) = b^(2n) / (2 pi n Gamma(2n)) exp(-b r^(1/n)),     inner: t(r) I(r),     outer: (1 - t(r)) I(r)

where t falls from 1 at half of `cut` to 0 at `cut` by a quintic in r. The inner part is compact, so it fits in a
transform of finite period. The outer part has no cusp, so it may be sampled at pixel centres. The transform of the
inner part,

    F(k) = 2 pi int t I J_0(k r) r dr,

is a Hankel transform on a logarithmic grid (Talman 1978; Hamilton 2000: two Fourier transforms). Tables of F against
k^2 and of the outer part against r^2 (profiles.log_table) are computed on first use and cached. F(0) is the flux of
the inner part, from the same integral.
"""

from functools import lru_cache
from typing import NamedTuple, cast

import numpy as np
from numpy.typing import ArrayLike

from csstsim.base.types import FloatArray, Floats

# indices of the two components of a galaxy, unless it has others
DISK = 1.0
BULGE = 4.0
# indices that are rendered
INDEX_MIN = 0.3
INDEX_MAX = 6.2
_B = {DISK: 1.678347, BULGE: 7.669249}  # b(n) for the series in `light_beyond`, without scipy (Ciotti & Bertin 1999)
# octaves of (k r_e)^2
K2_LOW = -28
K2_HIGH = 28
# octaves of (r / r_e)^2
R2_LOW = -32
R2_HIGH = 36
CUT_NONE = 2.0**-10  # r_e: with a cut at or below this, all of the profile is outer part
_STEPS_CUT = 4  # cuts to an octave
_LOG_R = np.linspace(-20.0, 18.0, 4096)
_STEP = _LOG_R[1] - _LOG_R[0]
_LOG_RATIO = np.linspace(-7.0, 7.0, 351)  # of radii over half-light radii, for `light_beyond`
_NEGLIGIBLE = 5e-5  # fraction of the flux beyond the radius at which a profile ends


def sersic_b(index: ArrayLike) -> FloatArray:
    """Return b(n), with which half of a Sersic profile's flux is within r_e (inverse incomplete gamma function)."""
    from scipy.special import gammaincinv

    return gammaincinv(2 * np.asarray(index, dtype=float), 0.5)


def radius_of(fraction: Floats, index: Floats) -> FloatArray:
    """Return the radius [r_e] that contains a fraction of a circular profile's flux."""
    from scipy.special import gammaincinv

    return (gammaincinv(2 * index, fraction) / gammaincinv(2 * index, 0.5)) ** index


def light_beyond(radius: Floats, half_light: Floats, index: Floats) -> FloatArray:
    """Return the fraction of a circular profile's flux beyond `radius`: Gamma(2n, x)/Gamma(2n).

    index: a number, or (n,) for each of the radii; indices other than a disk's and a bulge's are then interpolated in a
    table. The fraction is right to 1%. Below an index of 0.7, where a profile ends sharply, it is right to 5%, and to
    1% where it exceeds 1%.
    """
    ratio = radius / np.maximum(half_light, 1e-12)
    if np.ndim(index):
        return _each_beyond(ratio, np.asarray(index, dtype=float))
    index = cast("float", index)
    if index not in _B:
        from scipy.special import gammaincc

        return gammaincc(2 * index, sersic_b(index) * ratio ** (1.0 / index))
    x = _B[index] * ratio ** (1.0 / index)
    term = np.ones_like(x)
    total = np.ones_like(x)
    for k in range(1, 2 * int(index)):
        term = term * x / k
        total = total + term
    return np.exp(-x) * total


def _each_beyond(ratio: FloatArray, index: FloatArray) -> FloatArray:
    """Return `light_beyond` of ratios (n,) [half-light radii] and indices (n,); the same for equal pairs."""
    out = np.empty(np.broadcast(ratio, index).shape)
    known = np.zeros(out.shape, bool)
    for n in _B:
        mine = index == n
        if mine.any():
            out[mine] = light_beyond(ratio[mine], 1.0, n)
        known |= mine
    if not known.all():
        rest = ~known
        beyond = _beyond_table()
        table = beyond.table
        x = np.log(np.clip(ratio[rest], np.exp(_LOG_RATIO[0]), np.exp(_LOG_RATIO[-1])))
        across = (x - _LOG_RATIO[0]) / (_LOG_RATIO[1] - _LOG_RATIO[0])
        along = (np.log(index[rest]) - beyond.first) / beyond.step
        rows, columns = table.shape
        i = np.clip(along.astype(int), 0, rows - 2)
        j = np.clip(across.astype(int), 0, columns - 2)
        a = along - i
        b = across - j
        near = (1 - b) * table[i, j] + b * table[i, j + 1]
        out[rest] = np.exp((1 - a) * near + a * ((1 - b) * table[i + 1, j] + b * table[i + 1, j + 1]))
    return out


class _Beyond(NamedTuple):
    """Log of the flux beyond exp(_LOG_RATIO) half-light radii, (indices, radii); log of the first index and step."""

    first: float
    step: float
    table: FloatArray


@lru_cache
def _beyond_table() -> _Beyond:
    from scipy.special import gammaincc

    indices = np.geomspace(INDEX_MIN, INDEX_MAX, 240)[:, None]
    with np.errstate(divide="ignore", under="ignore"):
        beyond = np.log(gammaincc(2 * indices, sersic_b(indices) * np.exp(_LOG_RATIO) ** (1 / indices)))
    return _Beyond(np.log(INDEX_MIN), float(np.log(indices[1, 0] / indices[0, 0])), np.maximum(beyond, -50.0))


@lru_cache(1024)
def extent(index: float) -> float:
    """Return the radius [r_e] that contains all but a fraction _NEGLIGIBLE of the flux."""
    from scipy.special import gammainccinv

    return float((gammainccinv(2 * index, _NEGLIGIBLE) / sersic_b(index)) ** index)


def cut_for(index: float, radius: float) -> float:
    """Return the smallest tabulated cut [r_e] not below `radius`, or inf if the profile ends before `radius`."""
    if radius >= extent(index):
        return np.inf
    return float(2.0 ** (np.ceil(_STEPS_CUT * np.log2(max(radius, CUT_NONE))) / _STEPS_CUT))


@lru_cache(512)
def tables(index: float, cut: float) -> tuple[FloatArray, FloatArray]:
    """Return (F on the nodes of (k r_e)^2, outer part on those of (r / r_e)^2) of a Sersic index and a cut [r_e].

    F is that of a profile of flux 1 and any r_e; the outer part is per r_e^2.
    """
    # Imported here: selection does not call this and need not load numba and scipy
    from scipy.fft import fht, fhtoffset
    from scipy.interpolate import CubicSpline

    from csstsim.catalog.profiles.log_table import nodes

    r = np.exp(_LOG_R)
    offset = fhtoffset(_STEP, mu=0.0)
    transform = fht(r * _inside(r, cut) * brightness(r, index), _STEP, mu=0.0, offset=offset)
    log_k = offset - _LOG_R[::-1]
    spline = CubicSpline(log_k, 2 * np.pi * transform / np.exp(log_k))
    k2 = nodes(K2_LOW, K2_HIGH)
    r2 = nodes(R2_LOW, R2_HIGH)
    outer = (1 - _inside(np.sqrt(r2), cut)) * brightness(np.sqrt(r2), index)
    return spline(0.5 * np.log(k2)), outer


def brightness(r: Floats, index: float) -> FloatArray:
    """Return the profile per r_e^2 at r [r_e], of flux 1."""
    from scipy.special import gammaln

    b = float(sersic_b(index))
    with np.errstate(under="ignore"):
        return np.exp(2 * index * np.log(b) - np.log(2 * np.pi * index) - gammaln(2 * index) - b * r ** (1 / index))


def brightness_radius(limit: float, index: float) -> float:
    """Return the radius [r_e] where a profile of flux 1 falls to a brightness [per r_e^2]; 0: it is fainter."""
    return (np.log(max(float(brightness(0.0, index) / limit), 1.0)) / sersic_b(index)) ** index


def _inside(r: FloatArray, cut: float) -> FloatArray:
    if cut <= CUT_NONE:
        return np.zeros_like(r)
    t = np.clip(2 * r / cut - 1, 0.0, 1.0) if np.isfinite(cut) else np.zeros_like(r)
    return 1 - t**3 * (10 - 15 * t + 6 * t * t)
