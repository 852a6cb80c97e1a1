"""A galaxy's star-formation history, and the mixture of spectral templates that follows from it.

The star-formation rate goes as exp(lookback time / tau) over the last `A` years, with tau such that the rate now is the
specific rate drawn (a main sequence for star-forming galaxies, a low rate for quiescent ones):

    s A = x / (exp(x) - 1),  x = A / tau;    mass younger than a:  F(a) = (exp(x a / A) - 1) / (exp(x) - 1)

The mean age of the mass formed is A (1 / (1 - exp(-x)) - 1 / x).

A table gives the templates that represent the light of each age range, because templates fitted to galaxies mix several
ages, and some ages have no template. Left out: bursts beyond the scatter of the rate, metallicity as an independent
variable.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from csstsim.base.types import FloatArray, Floats

if TYPE_CHECKING:
    from csstsim.universe.lensing.cosmology import Cosmology

_X = np.concatenate([-np.logspace(3, -4, 3000), np.logspace(-4, np.log10(600.0), 3000)])
_CONSTANT_BELOW = 1e-3  # A / tau below which the rate counts as constant: errs by 1e-10
_LOG_SA = np.log(_X / np.expm1(_X))  # decreasing


def cosmic_age(z: Floats, cosmology: Cosmology) -> FloatArray:
    """Return the age of the flat universe [yr] at redshift z."""
    ratio = np.sqrt(cosmology.omega_lambda / cosmology.omega_m) * (1 + np.asarray(z, float)) ** -1.5
    hubble_time = 977.792e9 / cosmology.h0  # yr: Mpc / (km / s) = 977.792 Gyr
    return hubble_time * 2 / (3 * np.sqrt(cosmology.omega_lambda)) * np.arcsinh(ratio)


def main_sequence(log_mass: Floats, z: Floats, numbers: Mapping[str, Any]) -> FloatArray:
    """Return log10 of the specific star-formation rate [yr-1] of star-forming galaxies.

    numbers["near"], rows of z and dex, is added: the published law is of z > 0.5, the nearby sequence is lower.
    """
    r = np.log10(1 + np.asarray(z, float))
    m = np.asarray(log_mass, float) + numbers["imf_shift"] - 9.0
    bend = np.maximum(m - numbers["m1"] - numbers["a2"] * r, 0.0)
    near = np.interp(z, *np.transpose(numbers["near"]))
    return -9.0 - numbers["m0"] + numbers["a0"] * r - numbers["a1"] * bend**2 + near


def young_fractions(log_rate: FloatArray, age: FloatArray, edges: Sequence[float]) -> FloatArray:
    """Return (n, len(edges) + 1): fractions of the mass formed, by age: below the first edge, between, above the last.

    log_rate: log10 of the specific rate [yr-1] (n,); age: since the first star [yr] (n,); edges: ages [yr] rising.
    """
    age = np.asarray(age, float)[:, None]
    x = _steepness(log_rate, age[:, 0])[:, None]
    below = np.expm1(x * np.minimum(np.asarray(edges, float) / age, 1.0)) / np.expm1(x)
    return np.diff(below, prepend=0.0, append=1.0, axis=1)


def mean_age(log_rate: FloatArray, age: FloatArray) -> FloatArray:
    """Return the mean age [yr] of the mass formed; log_rate and age (n,) of `young_fractions`."""
    age = np.asarray(age, float)
    x = _steepness(log_rate, age)
    constant = np.abs(x) < _CONSTANT_BELOW  # half the age, and the first term of the series
    safe = np.where(constant, 1.0, x)
    return age * np.where(constant, 0.5 + x / 12, -1 / np.expm1(-safe) - 1 / safe)


def _steepness(log_rate: FloatArray, age: FloatArray) -> FloatArray:
    """Return A / tau of the specific rate now [log10 yr-1] and the age A [yr]."""
    return np.interp(-(np.asarray(log_rate) * np.log(10) + np.log(age)), -_LOG_SA, _X)


def mixture(fractions: FloatArray, numbers: Mapping[str, Any]) -> FloatArray:
    """Return (n, templates): solar masses of each template per solar mass of living stars and remnants.

    fractions: (n, ages), fractions of the mass formed; numbers["light"]: (ages, templates), template masses with the
    light of one solar mass formed in the age range; numbers["surviving"]: (ages,), the fraction of that mass that still
    exists.
    """
    template_masses = np.einsum("na,ak->nk", fractions, np.asarray(numbers["light"], float))
    return template_masses / np.einsum("na,a->n", fractions, np.asarray(numbers["surviving"], float))[:, None]


def attenuation(log_mass: Floats, z: Floats, numbers: Mapping[str, Any]) -> FloatArray:
    """Return the median A_V [mag] of face-on star-forming galaxies, a cubic of log mass, constant outside its range.

    It falls with redshift as (1 + z)^growth.
    """
    x = np.clip(np.asarray(log_mass, float) - 10.0, *numbers["range"])
    return np.polyval(numbers["cubic"][::-1], x) * (1 + z) ** numbers["growth"]
