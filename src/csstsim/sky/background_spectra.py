"""Spectra of the background, and the electrons they give in a band.

    rate [e-/s/px] = G integral L(lambda) T(lambda) dlambda

with L in photons and T the throughput, in electrons per photon that enters the aperture. For a radiance (photon / s /
m2 / angstrom / arcsec2) G is aperture area times the pixel's solid angle; for an irradiance of the focal plane that has
yet to meet the throughput (transmittance), the pixel's area. A grating's T is its whole first order;
csstsim.sky.dispersed has all orders and where they end.
"""

import numpy as np

from csstsim.base.units import C_A_S, H_J_S, K_J_K

V_BAND = 5500.0  # angstrom, where a V magnitude fixes a spectrum


def photons(watts, wavelength):
    """Return photon / s / m2 / angstrom of W m-2 um-1 at `wavelength` [angstrom]."""
    return 1e-4 * watts * wavelength / (H_J_S * C_A_S)


def sunlight(wavelength, numbers):
    """Return the Sun's irradiance at 1 au [photon / s / m2 / angstrom]; numbers: SkyNumbers."""
    return photons(np.interp(wavelength, *numbers.solar_spectrum.T), wavelength)


def magnitude_ratio(magnitude, numbers):
    """Return irradiance over that of the Sun at 1 au for a V magnitude."""
    return 10.0 ** (-0.4 * (np.asarray(magnitude, dtype=float) - numbers.bodies.sun_magnitude))


def blackbody_over_sun(wavelength, temperature, numbers):
    """Return a black body's photon spectrum over the Sun's at V_BAND: sources of equal V differ by this shape.

    At V_BAND the Sun is the mean of its spectrum within 250 angstrom, so that no line of its own decides.
    """
    x = H_J_S * C_A_S / K_J_K / temperature
    planck = (V_BAND / wavelength) ** 4 * np.expm1(x / V_BAND) / np.expm1(x / wavelength)
    return planck * photons(solar_continuum(V_BAND, numbers), V_BAND)


def solar_continuum(wavelength, numbers):
    """Return the mean solar irradiance [W m-2 um-1] within 250 angstrom of a wavelength."""
    near = wavelength + np.linspace(-250.0, 250.0, 51)
    return np.interp(near, *numbers.solar_spectrum.T).mean()


def band(filter_, spectrum):
    """Return the integral of T times `spectrum` (..., n) [photon / angstrom and more] over the filter's grid."""
    return np.trapezoid(filter_.throughput * spectrum, filter_.wavelength)


def pixel_etendue(telescope):
    """Return aperture area times the pixel's solid angle [m2 arcsec2]."""
    return telescope.area_m2 * telescope.pixel_scale**2
