"""Numbers, clustering and radii of dark-matter haloes.

    dn / dlnM = f(sigma) rho / M |dln sigma / dlnM|,   sigma^2(M) = int dlnk Delta^2(k) W^2(k R),   M = 4 pi / 3 rho R^3

f is that of Tinker et al. 2008 (ApJ 688, 709, equations 3, 5 to 8), the bias that of Tinker et al. 2010 (ApJ 724, 878,
equation 6 and table 2), with nu = 1.686 / sigma. A halo's mass is that inside the radius within which the density is
200 times the mean of all matter, so its comoving radius does not depend on redshift. W is that of a sphere.
Left out: baryons, neutrinos, the dependence of clustering on anything but mass.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from scipy.interpolate import CubicSpline

from csstsim.base.types import FloatArray, Floats
from csstsim.base.units import CRITICAL_DENSITY_H2

if TYPE_CHECKING:
    from csstsim.universe.lensing.cosmology import Cosmology
    from csstsim.universe.lensing.power_spectrum import MatterPower

CONTRAST = 200.0  # of a halo's mean density to that of all matter
COLLAPSE = 1.686  # linear overdensity at collapse
_LN_M = np.linspace(np.log(1e7), np.log(1e17), 240)  # solar
_LN_K = np.linspace(np.log(1e-5), np.log(1e4), 2400)  # 1 / Mpc


class HaloMassFunction:
    """`cosmology`: lensing.cosmology.Cosmology; `power`: lensing.power_spectrum.MatterPower.

    Masses [solar], 1e7 to 1e17; lengths comoving [Mpc]; no h. mass and z broadcast.
    """

    def __init__(self, cosmology: Cosmology, power: MatterPower) -> None:
        self.cosmology = cosmology
        self.power = power
        self.density = cosmology.omega_m * CRITICAL_DENSITY_H2 * (cosmology.h0 / 100) ** 2  # solar / Mpc^3, comoving
        k = np.exp(_LN_K)
        x = k * self.lagrangian_radius(np.exp(_LN_M))[:, None]
        small = x < 0.01  # the closed form loses digits by cancellation
        hat = np.where(small, 1 - x**2 / 10, 3 * (np.sin(x) - x * np.cos(x)) / np.where(small, 1, x) ** 3)
        variance = np.trapezoid(power.linear(k, 0.0) * k**3 / (2 * np.pi**2) * hat**2, _LN_K, axis=1)
        self._ln_sigma = CubicSpline(_LN_M, 0.5 * np.log(variance), extrapolate=False)
        self._slope = self._ln_sigma.derivative()

    def lagrangian_radius(self, mass: Floats) -> FloatArray:
        """Return the radius of the sphere of mean density with `mass`."""
        return np.cbrt(np.asarray(mass, float) / (4 * np.pi / 3 * self.density))

    def virial_radius(self, mass: Floats) -> FloatArray:
        """Return the radius within which a halo has 200 times the mean density (comoving)."""
        return self.lagrangian_radius(mass) / np.cbrt(CONTRAST)

    def sigma(self, mass: Floats, z: Floats) -> FloatArray:
        """Return the linear rms overdensity in spheres of `mass`."""
        return np.exp(self._ln_sigma(np.log(mass))) * self.cosmology.growth(z)

    def peak_height(self, mass: Floats, z: Floats) -> FloatArray:
        """Return nu = 1.686 / sigma."""
        return COLLAPSE / self.sigma(mass, z)

    def dn_dlnm(self, mass: Floats, z: Floats) -> FloatArray:
        """Return haloes per Mpc^3 and unit of ln mass."""
        mass = np.asarray(mass, float)
        z = np.asarray(z, float)
        sigma = self.sigma(mass, z)
        alpha = 10 ** -((0.75 / np.log10(CONTRAST / 75)) ** 1.2)
        a = 1.47 * (1 + z) ** -0.06
        b = 2.57 * (1 + z) ** -alpha
        f = 0.186 * (1 + z) ** -0.14 * ((sigma / b) ** -a + 1) * np.exp(-1.19 / sigma**2)
        return f * self.density / mass * -self._slope(np.log(mass))

    def bias(self, mass: Floats, z: Floats) -> FloatArray:
        """Return the linear bias."""
        nu = self.peak_height(mass, z)
        y = np.log10(CONTRAST)
        step = np.exp(-((4 / y) ** 4))
        large = 1 + 0.24 * y * step
        a = 0.44 * y - 0.88
        return 1 - large * nu**a / (nu**a + COLLAPSE**a) + 0.183 * nu**1.5 + (0.019 + 0.107 * y + 0.19 * step) * nu**2.4
