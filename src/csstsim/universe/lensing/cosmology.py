"""Distances, volumes and growth in a flat universe of matter and a cosmological constant.

    H(z) = H0 E(z),  E^2 = Om (1 + z)^3 + OL,  Om + OL = 1,      chi(z) = int_0^z c dz' / H(z')

Radiation and neutrino masses are left out: at z = 6 they shorten chi by 2e-4.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np
from scipy.interpolate import CubicHermiteSpline
from scipy.special import hyp2f1

from csstsim.base.types import FloatArray, Floats
from csstsim.base.units import C_KM_S

_Z_MAX = 1200.0
_NODES = 2048  # of ln(1 + z): the spline errs by 1e-11
_SKY_DEG2 = 4 * 180.0**2 / np.pi


FLATNESS = 1e-9  # largest difference of omega_m + omega_lambda from 1


class Cosmology:
    """Distances and growth in a flat universe of matter and a cosmological constant.

    For redshifts outside 0 to 1200, and for NaN, results are NaN.

    Parameters
    ----------
    numbers : mapping
        omega_m, omega_lambda and h0 [km / s / Mpc], as in config/universe/cosmology.yaml.

    Raises
    ------
    ValueError
        For a universe that is not flat, or invalid numbers.
    """

    def __init__(self, numbers: Mapping[str, Any]) -> None:
        self.omega_m = float(numbers["omega_m"])
        self.omega_lambda = float(numbers["omega_lambda"])
        self.h0 = float(numbers["h0"])
        if not (0 < self.omega_m <= 1 and self.h0 > 0 and abs(self.omega_m + self.omega_lambda - 1) < FLATNESS):
            raise ValueError("cosmology: needs 0 < omega_m <= 1, omega_lambda = 1 - omega_m and h0 > 0")
        x = np.linspace(0.0, np.log1p(_Z_MAX), _NODES)

        def slope(x: FloatArray) -> FloatArray:  # d chi / d ln(1 + z)
            return self.hubble_distance * np.exp(x) / self.expansion(np.expm1(x))

        nodes, weights = np.polynomial.legendre.leggauss(5)
        half = 0.5 * np.diff(x)
        pieces = (slope(x[:-1, None] + half[:, None] * (1 + nodes)) * weights).sum(axis=1) * half
        self._distance = CubicHermiteSpline(x, np.append(0.0, np.cumsum(pieces)), slope(x), extrapolate=False)

    @property
    def hubble_distance(self) -> float:
        """c / H0 [Mpc]."""
        return C_KM_S / self.h0

    def expansion(self, z: Floats) -> FloatArray:
        """Return the expansion rate relative to today.

        Parameters
        ----------
        z : float or (n,) array of float
            Redshift.

        Returns
        -------
        float or (n,) array of float
            E(z) = H(z) / H0.
        """
        return np.sqrt(self.omega_m * (1.0 + np.asarray(z, float)) ** 3 + self.omega_lambda)

    def comoving_distance(self, z: Floats) -> FloatArray:
        """Return the line-of-sight comoving distance (in a flat universe also the transverse one).

        Parameters
        ----------
        z : float or (n,) array of float
            Redshift.

        Returns
        -------
        float or (n,) array of float
            Distance [Mpc].
        """
        return self._distance(np.log1p(np.asarray(z, float)))

    def luminosity_distance(self, z: Floats) -> FloatArray:
        """Return the luminosity distance.

        Parameters
        ----------
        z : float or (n,) array of float
            Redshift.

        Returns
        -------
        float or (n,) array of float
            Distance [Mpc].
        """
        return (1.0 + np.asarray(z, float)) * self.comoving_distance(z)

    def angular_diameter_distance(self, z: Floats) -> FloatArray:
        """Return the angular diameter distance: a length of d Mpc spans d / distance [rad].

        Parameters
        ----------
        z : float or (n,) array of float
            Redshift.

        Returns
        -------
        float or (n,) array of float
            Distance [Mpc].
        """
        return self.comoving_distance(z) / (1.0 + np.asarray(z, float))

    def distance_modulus(self, z: Floats) -> FloatArray:
        """Return the distance modulus m - M without K correction.

        Parameters
        ----------
        z : float or (n,) array of float
            Redshift.

        Returns
        -------
        float or (n,) array of float
            Modulus [mag]; -inf at z = 0.
        """
        with np.errstate(divide="ignore"):
            return 5.0 * np.log10(self.luminosity_distance(z)) + 25.0

    def volume(self, z0: Floats, z1: Floats) -> FloatArray:
        """Return the comoving volume between two redshifts.

        Parameters
        ----------
        z0, z1 : float or (n,) array of float
            Redshifts.

        Returns
        -------
        float or (n,) array of float
            Volume [Mpc3 per deg2 of sky]; negative if z1 < z0.
        """
        near = self.comoving_distance(z0)
        far = self.comoving_distance(z1)
        return 4 * np.pi / 3 * (far**3 - near**3) / _SKY_DEG2

    def matter_fraction(self, z: Floats) -> FloatArray:
        """Return the matter density as a fraction of the critical density, Om(z) = Om (1 + z)^3 / E^2.

        Parameters
        ----------
        z : float or (n,) array of float
            Redshift.

        Returns
        -------
        float or (n,) array of float
            Fraction, 0 to 1.
        """
        return self.omega_m * (1.0 + np.asarray(z, float)) ** 3 / self.expansion(z) ** 2

    def growth(self, z: Floats) -> FloatArray:
        """Return the linear growth factor, exact for matter and a cosmological constant.

        D ~ a 2F1(1/3, 1; 11/6; -a^3 OL / Om) (for example Silveira & Waga 1994).

        Parameters
        ----------
        z : float or (n,) array of float
            Redshift.

        Returns
        -------
        float or (n,) array of float
            Growth factor, 1 at z = 0.
        """
        a = 1.0 / (1.0 + np.asarray(z, float))
        ratio = self.omega_lambda / self.omega_m
        return a * hyp2f1(1 / 3, 1.0, 11 / 6, -ratio * a**3) / hyp2f1(1 / 3, 1.0, 11 / 6, -ratio)
