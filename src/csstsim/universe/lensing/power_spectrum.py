"""Power spectrum of matter: Eisenstein & Hu (1998) transfer function, and halofit revised by Takahashi et al. (2012).

    P_lin(k, z) = A k^n_s T(k)^2 D(z)^2, A such that sigma(8 Mpc / h) = sigma_8;      Delta^2 = k^3 P / (2 pi^2)

k in 1 / Mpc, P in Mpc^3 (no h). The fits err by about 2 % (transfer function, with 1 % of sigma_8) and by 5 to 10 %
(halofit, k < 30). Left out: massive neutrinos, baryonic feedback, dark energy other than Lambda.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from csstsim.base.types import FloatArray, Floats

if TYPE_CHECKING:
    from csstsim.universe.lensing.cosmology import Cosmology

_LN_K = np.linspace(np.log(1e-5), np.log(1e4), 1200)  # of the variance integrals [ln 1 / Mpc]
_LN_R = np.linspace(np.log(1e-4), np.log(50.0), 150)  # Gaussian radii searched for sigma = 1 [ln Mpc]


def transfer(k: Floats, numbers: Mapping[str, Any]) -> FloatArray:
    """Return T(k), 1 at k = 0: Eisenstein & Hu 1998, ApJ 496, 605, equations 2 to 24, with the acoustic wiggles.

    `numbers`: the mapping of config/universe/cosmology.yaml.
    """
    k = np.asarray(k, float)
    theta = numbers["t_cmb"] / 2.7
    h = numbers["h0"] / 100.0
    m = numbers["omega_m"] * h**2
    b = numbers["omega_b"] * h**2
    fb = b / m
    z_eq = 2.50e4 * m / theta**4
    k_eq = 7.46e-2 * m / theta**2
    b1 = 0.313 * m**-0.419 * (1 + 0.607 * m**0.674)
    b2 = 0.238 * m**0.223
    z_d = 1291 * m**0.251 / (1 + 0.659 * m**0.828) * (1 + b1 * b**b2)
    r_d = 31.5e3 * b / theta**4 / z_d
    r_eq = 31.5e3 * b / theta**4 / z_eq
    sound = 2 / (3 * k_eq) * np.sqrt(6 / r_eq) * np.log((np.sqrt(1 + r_d) + np.sqrt(r_d + r_eq)) / (1 + np.sqrt(r_eq)))
    silk = 1.6 * b**0.52 * m**0.73 * (1 + (10.4 * m) ** -0.95)
    a1 = (46.9 * m) ** 0.670 * (1 + (32.1 * m) ** -0.532)
    a2 = (12.0 * m) ** 0.424 * (1 + (45.0 * m) ** -0.582)
    alpha_c = a1**-fb * a2 ** -(fb**3)
    c1 = 0.944 / (1 + (458 * m) ** -0.708)
    c2 = (0.395 * m) ** -0.0266
    beta_c = 1 / (1 + c1 * ((1 - fb) ** c2 - 1))
    y = (1 + z_eq) / (1 + z_d)
    root = np.sqrt(1 + y)
    g = y * (-6 * root + (2 + 3 * y) * np.log((root + 1) / (root - 1)))
    alpha_b = 2.07 * k_eq * sound * (1 + r_d) ** -0.75 * g
    beta_b = 0.5 + fb + (3 - 2 * fb) * np.sqrt((17.2 * m) ** 2 + 1)
    node = 8.41 * m**0.435

    q = k / (13.41 * k_eq)

    def tilde(alpha: float, beta: float) -> FloatArray:
        log = np.log(np.e + 1.8 * beta * q)
        return log / (log + (14.2 / alpha + 386 / (1 + 69.9 * q**1.08)) * q**2)

    f = 1 / (1 + (k * sound / 5.4) ** 4)
    cold = f * tilde(1, beta_c) + (1 - f) * tilde(alpha_c, beta_c)
    x = np.maximum(k * sound, 1e-30)
    shifted = x / np.cbrt(1 + (node / x) ** 3)
    baryon = tilde(1, 1) / (1 + (x / 5.2) ** 2) + alpha_b / (1 + (beta_b / x) ** 3) * np.exp(-((k / silk) ** 1.4))
    return fb * baryon * np.sinc(shifted / np.pi) + (1 - fb) * cold


class MatterPower:
    """Linear and nonlinear P(k, z). `cosmology`: cosmology.Cosmology; `numbers`: the same file's mapping."""

    def __init__(self, cosmology: Cosmology, numbers: Mapping[str, Any]) -> None:
        self.cosmology = cosmology
        self.numbers = numbers
        self._amplitude: Floats = 1.0
        k = np.exp(_LN_K)
        h = numbers["h0"] / 100.0
        x = k * 8.0 / h
        # Below x = 0.01 the closed form of the top hat loses digits by cancellation; 1 - x^2 / 10 is exact to 1e-11.
        hat = np.where(x < 0.01, 1 - x**2 / 10, 3 * (np.sin(x) - x * np.cos(x)) / np.maximum(x, 0.01) ** 3)
        self._amplitude = numbers["sigma_8"] ** 2 / _integral(self._delta2(k) * hat**2)
        # Variance in Gaussian spheres with its first and second derivative in ln R, today (Smith et al. 2003, C6-C8).
        y2 = (k * np.exp(_LN_R)[:, None]) ** 2
        shell = self._delta2(k) * np.exp(-y2)
        self._variance = _integral(shell)
        self._slope = 2 * _integral(shell * y2) / self._variance  # - dln s2 / dlnR
        self._curvature = self._slope**2 + 4 * _integral(shell * (y2 * (1 - y2))) / self._variance  # - d2ln s2 / dlnR2

    def linear(self, k: Floats, z: Floats) -> FloatArray:
        """Return P_lin [Mpc^3]; k [1 / Mpc] > 0 and z broadcast."""
        return 2 * np.pi**2 / k**3 * self._delta2(k) * self.cosmology.growth(z) ** 2

    def nonlinear(self, k: Floats, z: Floats) -> FloatArray:
        """Return the halofit P [Mpc^3]; k [1 / Mpc] > 0 and z (>= 0) broadcast. Linear where nothing has collapsed."""
        k = np.asarray(k, float)
        z = np.asarray(z, float)
        growth2 = self.cosmology.growth(z) ** 2
        linear = self._delta2(k) * growth2
        # sigma(R) = 1 at redshift z is sigma = 1 / D today. The variance falls with R, so the search runs backwards.
        ln_r = np.interp(np.log(growth2), -np.log(self._variance), _LN_R)
        n = np.interp(ln_r, _LN_R, self._slope - 3)
        c = np.interp(ln_r, _LN_R, self._curvature)
        quasi, halo = _halofit(k * np.exp(ln_r), linear, n, c, self.cosmology.matter_fraction(z))
        return 2 * np.pi**2 / k**3 * (quasi + halo)

    def _delta2(self, k: Floats) -> FloatArray:
        return self._amplitude * k ** (3 + self.numbers["n_s"]) * transfer(k, self.numbers) ** 2


def _halofit(
    y: FloatArray, linear: FloatArray, n: FloatArray, c: FloatArray, omega: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return the two terms of Delta^2: Takahashi et al. 2012, ApJ 761, 152, equations A1 to A14, for w = -1.

    y = k / k_sigma; n, c: effective slope and curvature; omega: matter fraction at that redshift.
    """
    a = 10 ** (1.5222 + 2.8553 * n + 2.3706 * n**2 + 0.9903 * n**3 + 0.2250 * n**4 - 0.6038 * c)
    b = 10 ** (-0.5642 + 0.5864 * n + 0.5716 * n**2 - 1.5474 * c)
    cn = 10 ** (0.3698 + 2.0404 * n + 0.8161 * n**2 + 0.5869 * c)
    gamma = 0.1971 - 0.0843 * n + 0.8460 * c
    alpha = np.abs(6.0835 + 1.3373 * n - 0.1959 * n**2 - 5.5274 * c)
    beta = 2.0379 - 0.7354 * n + 0.3157 * n**2 + 1.2490 * n**3 + 0.3980 * n**4 - 0.1682 * c
    nu = 10 ** (5.2105 + 3.6902 * n)
    f1 = omega**-0.0307
    f2 = omega**-0.0585
    f3 = omega**0.0743
    quasi = linear * (1 + linear) ** beta / (1 + alpha * linear) * np.exp(-y / 4 - y**2 / 8)
    halo = a * y ** (3 * f1) / (1 + b * y**f2 + (cn * f3 * y) ** (3 - gamma)) / (1 + nu / y**2)
    return quasi, halo


def _integral(values: FloatArray) -> FloatArray:
    """Integrate over ln k (trapezium; the last axis)."""
    step = _LN_K[1] - _LN_K[0]
    return step * (values.sum(axis=-1) - 0.5 * (values[..., 0] + values[..., -1]))
