"""Zodiacal light: sunlight scattered by interplanetary dust (Leinert et al. 1998, A&AS 127, 1).

    L(lambda) = I(longitude from the Sun, latitude) S(lambda) / S(5000) (1 + k log10(lambda / 5000))

I is their Table 17: log I is interpolated by monotone cubics, along longitude and then latitude, flat at the table's
ends, which are lines of symmetry. S is the Sun's spectrum, S(5000) its mean within 250 A; the reddening k depends on
elongation (their equation 22). Left out: seasonal change as the Earth moves in the dust cloud (10%), faint structures.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from csstsim.base.errors import InputError
from csstsim.base.units import ARCSEC_PER_RAD
from csstsim.instrument.filter import sample_curve
from csstsim.optics.sky.background_spectra import solar_continuum, sunlight

if TYPE_CHECKING:
    from csstsim.base.types import FloatArray, Floats
    from csstsim.optics.sky.parameters import SkyNumbers

REFERENCE = 5000.0  # angstrom, of Table 17


def intensity(longitude: Floats, latitude: Floats, numbers: SkyNumbers) -> FloatArray:
    """Return I [1e-8 W m-2 sr-1 um-1 at 5000 A] at helio-ecliptic longitude and latitude [deg], any shape.

    Raises InputError closer to the Sun than the table reaches.
    """
    lon, lat = np.broadcast_arrays(np.abs(longitude), np.abs(latitude))
    nearest = elongation(lon, lat).min(initial=180.0)
    if nearest < numbers.zodiacal.nearest - 1e-9:
        raise InputError(
            "too close to the Sun for the table of zodiacal light",
            key="elongation [deg]",
            value=round(float(nearest), 3),
            allowed=f"{numbers.zodiacal.nearest} or more",
        )
    table = _filled(numbers)
    axes = numbers.zodiacal
    columns = [sample_curve(np.column_stack([axes.longitude, c]), lon.ravel()) for c in table.T]
    rows = zip(np.transpose(columns), lat.ravel(), strict=True)
    log = [sample_curve(np.column_stack([axes.latitude, row]), np.array([b]))[0] for row, b in rows]
    return np.exp(np.reshape(log, lon.shape))


def elongation(longitude: Floats, latitude: Floats) -> FloatArray:
    """Return the angle [deg] from the Sun."""
    return np.degrees(np.arccos(np.clip(np.cos(np.radians(longitude)) * np.cos(np.radians(latitude)), -1.0, 1.0)))


def _filled(numbers: SkyNumbers) -> FloatArray:
    """Return log I with the cells near the Sun filled.

    They only support the interpolation beyond 15 deg. Each extrapolates its column as a power law of elongation
    through the column's first two known cells.
    """
    axes = numbers.zodiacal
    log = np.log(numbers.zodiacal.intensity)
    away = np.log(np.maximum(elongation(axes.longitude[:, None], axes.latitude[None, :]), 5.0))
    for j in np.flatnonzero(np.isnan(log).any(axis=0)):
        empty = np.isnan(log[:, j])
        one, two = np.flatnonzero(~empty)[:2]
        slope = (log[two, j] - log[one, j]) / (away[two, j] - away[one, j])
        log[empty, j] = log[one, j] + slope * (away[empty, j] - away[one, j])
    return log


def spectrum(wavelength: FloatArray, numbers: SkyNumbers) -> FloatArray:
    """Return (2, n): photon / s / m2 / angstrom / arcsec2 for I = 1, with the colours at the law's two elongations.

    The light at any elongation is a mixture of the two: `mixture`.
    """
    step = np.log10(wavelength / REFERENCE)
    colour = [1.0 + np.where(step < 0, blue, red) * step for _, blue, red in numbers.zodiacal.colour]
    over_sun = 1e-8 / ARCSEC_PER_RAD**2 / solar_continuum(REFERENCE, numbers)
    return over_sun * np.array(colour) * sunlight(wavelength, numbers)


def mixture(angle: Floats, numbers: SkyNumbers) -> FloatArray:
    """Return (2, ...): the fractions of the two colours at an angle [deg] from the Sun; they sum to 1."""
    near, far = numbers.zodiacal.colour[:, 0]
    near_fraction = np.clip((far - angle) / (far - near), 0.0, 1.0)
    return np.stack([near_fraction, 1.0 - near_fraction])
