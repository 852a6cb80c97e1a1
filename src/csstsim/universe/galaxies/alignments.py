"""Intrinsic alignments: how shapes follow the halo and the tidal field.

Ellipticities are e = (a - b) / (a + b) exp(2 i phi), phi from east to north. A small mean ellipticity g is given as
a shear, e -> (e + g) / (1 + conj(g) e), which keeps |e| < 1 (Seitz & Schneider 1997). In the NLA model (Bridle &
King 2007, NJP 9, 444) it is

    g = -A_IA C1 rho_crit Om / D(z) gamma,

with gamma the shear of a convergence equal to the overdensity. So quiescent galaxies point to overdensities.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from csstsim.base.types import ComplexArray, FloatArray

if TYPE_CHECKING:
    from csstsim.universe.lensing.cosmology import Cosmology


def sheared(e: ComplexArray, g: ComplexArray) -> ComplexArray:
    """Return complex ellipticities e after a mean ellipticity g (complex, |g| < 1), each (n,)."""
    return (e + g) / (1 + np.conj(g) * e)


def tidal_alignment(
    z: FloatArray, tide: ComplexArray, cosmology: Cosmology, numbers: Mapping[str, Any]
) -> ComplexArray:
    """Return g (n,) of the NLA model for red galaxies; tide (n,) complex: shear of the overdensity as convergence."""
    strength = numbers["tidal"] * numbers["normalisation"] * cosmology.omega_m / cosmology.growth(z)
    return -strength * tide


def radial_alignment(east: FloatArray, north: FloatArray, numbers: Mapping[str, Any]) -> ComplexArray:
    """Return g (n,) of satellites at offsets (n,) from their halo's centre, to which their long axes point."""
    offset = np.asarray(east, float) + 1j * np.asarray(north, float)
    length = np.abs(offset)
    return numbers["radial"] * np.divide(offset, length, out=np.zeros(offset.shape, complex), where=length > 0) ** 2


def turned_to(
    e: ComplexArray, east: FloatArray, north: FloatArray, normal: FloatArray, numbers: Mapping[str, Any]
) -> ComplexArray:
    """Return e (n,) with long axes along (east, north), rotated by an angle of rms `central_angle`.

    normal (n,): standard normal deviates.
    """
    angle = np.arctan2(north, east) + np.radians(numbers["central_angle"]) * normal
    return np.abs(e) * np.exp(2j * angle)
