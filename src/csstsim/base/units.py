"""The units of plain floats inside csstsim, and the physical constants.

| quantity                      | unit                         |
|-------------------------------|------------------------------|
| image                         | electron (DN after `gain`)   |
| time, exposure                | second                       |
| wavelength                    | angstrom                     |
| SED                           | photon / s / m2 / angstrom   |
| ra, dec, position angle       | degree (axes of the ICRS)    |
| small angle, object size      | arcsec                       |
| proper motion, parallax       | mas / yr, mas                |
| focal plane                   | mm                           |
| pixel position                | pixel, centre of the first pixel at (0, 0); FITS +1 only in io and in geometry.wcs |
| area                          | m2                           |
| magnitude                     | AB                           |
| spacecraft position, velocity | km, km / s, geocentric GCRS  |

Astropy quantities are used only at the interfaces to users.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from typing import TypeVar

    from csstsim.base.types import FloatArray

    FloatsT = TypeVar("FloatsT", float, FloatArray)

C_KM_S = 299_792.458  # speed of light, exact (SI)
H_J_S = 6.626_070_15e-34  # Planck constant, exact (SI)
K_J_K = 1.380_649e-23  # Boltzmann constant, exact (SI)
C_A_S = 1e13 * C_KM_S  # speed of light in angstrom / s

AB_ZERO_W_M2_HZ = 3631e-26  # flux density of AB magnitude 0 (Oke & Gunn 1983)

AU_KM = 149_597_870.7  # exact (IAU 2012 B2)
DAY_S = 86_400.0
JULIAN_YEAR_DAYS = 365.25

EARTH_RADIUS_KM = 6378.137  # equatorial, WGS84
EARTH_GM_KM3_S2 = 398_600.4418  # WGS84
EARTH_J2 = 1.082_626_68e-3  # second zonal harmonic, WGS84 / EGM96

CRITICAL_DENSITY_H2 = 2.775_366_3e11  # solar mass / Mpc3, of H = 100 km / s / Mpc (IAU 2015 B3, CODATA 2018)
SOLAR_RADIUS_PC = 2.254_610e-8  # nominal solar radius 6.957e8 m (IAU 2015 B3) over 3.085_677_6e16 m

UM_PER_MM = NM_PER_UM = 1000.0

ARCSEC_PER_DEG = 3600.0
ARCSEC_PER_RAD = math.degrees(1.0) * 3600.0
MAS_PER_RAD = 1000.0 * ARCSEC_PER_RAD


def ab_photon_density(wavelength: FloatsT, magnitude: FloatsT | float = 0.0) -> FloatsT:
    """Return the photon flux density of a source of constant AB magnitude, f_nu / (h lambda).

    Parameters
    ----------
    wavelength : float or (n,) array of float
        Wavelengths [angstrom].
    magnitude : float or (n,) array of float
        AB magnitude [mag].

    Returns
    -------
    float or (n,) array of float
        Density [photon / s / m2 / angstrom].
    """
    return 10.0 ** (-0.4 * magnitude) * AB_ZERO_W_M2_HZ / (H_J_S * wavelength)
