"""Spectra of the background and their electron rates in a band.

    rate [e-/s/px] = G integral L(lambda) T(lambda) dlambda

L is in photons; T is the throughput, in electrons per photon that enters the aperture. For a radiance (photon / s /
m2 / angstrom / arcsec2), G is the aperture area times the pixel's solid angle. For an irradiance of the focal plane
before throughput (from the point-source transmittance), G is the pixel's area. A grating's T is that of its whole first
order; csstsim.optics.sky.dispersed treats all orders and where they end.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from csstsim.base.resampling import read_at
from csstsim.base.units import C_A_S, H_J_S, K_J_K

if TYPE_CHECKING:
    from typing import TypeVar

    from csstsim.base.types import FloatArray, Floats
    from csstsim.instrument.filter import Filter
    from csstsim.instrument.telescope import Telescope
    from csstsim.optics.sky.parameters import SkyNumbers

    FloatsT = TypeVar("FloatsT", float, FloatArray)

V_BAND = 5500.0  # angstrom, where spectra are normalised to the V magnitude


def photons(watts: FloatsT, wavelength: FloatsT) -> FloatsT:
    """Return photon / s / m2 / angstrom of W m-2 um-1 at `wavelength` [angstrom]."""
    return 1e-4 * watts * wavelength / (H_J_S * C_A_S)


def sunlight(wavelength: FloatArray, numbers: SkyNumbers) -> FloatArray:
    """Return the Sun's irradiance at 1 au [photon / s / m2 / angstrom]; numbers: SkyNumbers."""
    return photons(read_at(wavelength, *numbers.solar_spectrum.T), wavelength)


def magnitude_ratio(magnitude: Floats, numbers: SkyNumbers) -> FloatArray:
    """Return the irradiance of a source of given V magnitude over that of the Sun at 1 au."""
    return 10.0 ** (-0.4 * (np.asarray(magnitude, dtype=float) - numbers.bodies.sun_magnitude))


def blackbody_over_sun(wavelength: FloatArray, temperature: float, numbers: SkyNumbers) -> FloatArray:
    """Return a black body's photon spectrum, scaled to equal the Sun's at V_BAND: same V, another shape.

    The Sun's value at V_BAND is the mean of its spectrum within 250 angstrom, so that single lines matter little.
    """
    x = H_J_S * C_A_S / K_J_K / temperature
    planck = (V_BAND / wavelength) ** 4 * np.expm1(x / V_BAND) / np.expm1(x / wavelength)
    return planck * photons(solar_continuum(V_BAND, numbers), V_BAND)


def solar_continuum(wavelength: float, numbers: SkyNumbers) -> float:
    """Return the mean solar irradiance [W m-2 um-1] within 250 angstrom of a wavelength."""
    near = wavelength + np.linspace(-250.0, 250.0, 51)
    return read_at(near, *numbers.solar_spectrum.T).mean()


def band(filter_: Filter, spectrum: FloatArray) -> FloatArray:
    """Return the integral of T times `spectrum` (..., n) [photon / angstrom / ...] over the filter's grid."""
    return np.trapezoid(filter_.throughput * spectrum, filter_.wavelength)  # type: ignore[return-value]  # of any shape


def pixel_etendue(telescope: Telescope) -> float:
    """Return aperture area times the pixel's solid angle [m2 arcsec2]."""
    return telescope.area_m2 * telescope.pixel_scale**2
