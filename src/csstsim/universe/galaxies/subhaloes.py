"""The number of galaxies of a halo by a proxy of their stellar mass: a central, and satellites in accreted subhaloes.

The proxy is log10 of the halo's mass (of a satellite: at accretion) plus normal scatter. Subhaloes of all orders have

    dN / dln x = gamma x^alpha exp(-beta x^omega),  x = mass at accretion / host's mass

(Jiang & van den Bosch 2016, MNRAS 458, 2848). A fraction of them still has its galaxy. A scatter of `scatter` dex in
stellar mass is one of scatter / slope in the proxy, with the slope of Moster, Naab & White (2013, MNRAS 428, 3121).
Left out: scatter in the number of subhaloes beyond Poisson's, and its dependence on a halo's age.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np
from scipy.special import gamma, gammaincc, ndtr

from csstsim.base.types import FloatArray, Floats

STEP = 0.025  # dex, of all tables of masses and proxies
# log10 of solar masses; lighter haloes host no galaxy
_LOG_MASS_MIN = 7.0
_LOG_MASS_MAX = 17.0


def host_masses() -> FloatArray:
    """Return log10 masses [solar] at the middle of the bins of haloes (H,)."""
    return np.arange(_LOG_MASS_MIN, _LOG_MASS_MAX, STEP) + STEP / 2


def proxies() -> FloatArray:
    """Return the proxies (X,) at which cumulative numbers are tabulated."""
    return np.arange(_LOG_MASS_MIN, _LOG_MASS_MAX + STEP / 2, STEP)


def scatter_in_proxy(log_mass: FloatArray, numbers: Mapping[str, Any]) -> FloatArray:
    """Return the scatter of the proxy [dex] of haloes of log_mass (n,); numbers: `stellar_to_halo`."""
    y = 10.0 ** (np.asarray(log_mass, float) - numbers["log_m1"])
    low = y ** -numbers["beta"]
    high = y ** numbers["gamma"]
    slope = 1 + (numbers["beta"] * low - numbers["gamma"] * high) / (low + high)
    return numbers["scatter"] / slope


def subhaloes_above(x: FloatArray, numbers: Mapping[str, Any]) -> FloatArray:
    """Return the number of accreted subhaloes above the mass ratio x (> 0; array); numbers: `subhaloes`.

    int_x dN/dlnx = gamma / omega beta^(-a) Gamma(a, beta x^omega), a = alpha / omega.
    """
    a = numbers["alpha"] / numbers["omega"]
    beta = numbers["beta"]
    omega = numbers["omega"]
    y = beta * np.asarray(x, float) ** omega
    upper = (gamma(a + 1) * gammaincc(a + 1, y) - y**a * np.exp(-y)) / a  # Gamma(a, y) for -1 < a < 0
    return numbers["gamma"] / omega * beta**-a * upper


def surviving_fraction(log_mass: Floats, z: Floats, numbers: Mapping[str, Any]) -> FloatArray:
    """Return the fraction of subhaloes with a galaxy in hosts of log_mass at z (broadcast); numbers: `surviving`."""
    fraction = numbers["today"] * 10 ** (numbers["host"] * (np.asarray(log_mass, float) - 13.0))
    return np.minimum(fraction * (1 + np.asarray(z, float)) ** numbers["growth"], numbers["most"])


def proxy_above(numbers: Mapping[str, Any]) -> FloatArray:
    """Return (H, X): the fraction of haloes of each mass whose proxy is above each of `proxies`."""
    mass = host_masses()
    scatter = scatter_in_proxy(mass, numbers["stellar_to_halo"])
    return ndtr((mass[:, None] - proxies()) / scatter[:, None])


def satellite_counts(numbers: Mapping[str, Any], central: FloatArray) -> FloatArray:
    """Return (H, X): mean number of satellites of a halo of each mass above each of `proxies`, if all survive.

    central: of proxy_above. Subhaloes are no more massive than their host at accretion.
    """
    offset = STEP * np.arange(len(central) + 1)  # of a subhalo's bin edges below the middle of the host's bin
    counts = np.diff(subhaloes_above(10.0 ** -np.maximum(offset - STEP / 2, 0.0), numbers["subhaloes"]))
    bins = np.tril(counts[np.abs(np.subtract.outer(*[np.arange(len(central))] * 2))])
    return bins @ central
