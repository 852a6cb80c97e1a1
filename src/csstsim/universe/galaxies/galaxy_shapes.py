"""Sizes, bulges and outlines of galaxies, given mass, redshift and type.

Half-light radii in kpc follow a mass-size relation that shrinks with redshift, with log-normal scatter. They are
semi-major axes, as the published ones. Catalogues have the radius of the circle of equal area, sqrt(b / a) times that.
The bulge has the same fraction of the flux as of the mass (one spectrum for both). Left out: sizes that change with
wavelength, spiral arms, clumps, mergers. Alignments with haloes are in universe.galaxies.alignments.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from csstsim.base.types import BoolArray, ComplexArray, FloatArray, Floats, IntArray
from csstsim.base.units import ARCSEC_PER_RAD

if TYPE_CHECKING:
    from csstsim.universe.lensing.cosmology import Cosmology

G_KPC_KM2_S2_MSUN = 4.300_917e-6


def disk_radius(log_mass: FloatArray, z: Floats, numbers: Mapping[str, Any]) -> FloatArray:
    """Return the median half-light semi-major axis [kpc] of a disc.

    log10 radius = offset(z) + slope(z) (log_mass - numbers["log_mass"]); offset and slope are linear in z between the
    rows of numbers["rows"] and constant outside.
    """
    table = np.transpose(np.asarray(numbers["rows"], float))
    offset = np.interp(z, table[0], table[1])
    slope = np.interp(z, table[0], table[2])
    return 10 ** (offset + slope * (log_mass - numbers["log_mass"]))


def bulge_radius(log_mass: FloatArray, z: Floats, numbers: Mapping[str, Any]) -> FloatArray:
    """Return the median half-light semi-major axis [kpc] of a bulge-dominated galaxy."""
    x = log_mass - numbers["log_mass"]
    bend = numbers["bend"] - numbers["log_mass"]
    steep = np.where(x > bend, numbers["slope"] * x, numbers["slope"] * bend + numbers["faint_slope"] * (x - bend))
    return numbers["radius"] * 10 ** (steep + numbers["growth"] * np.log10(1 + z))


def bulge_fraction(log_mass: FloatArray, kind: IntArray, normal: FloatArray, numbers: Mapping[str, Any]) -> FloatArray:
    """Return B/T (n,), at most 1: log-normal about a line in log mass, one line per type."""
    line = np.asarray([numbers["star_forming"], numbers["quiescent"]], float)[kind]
    log = line[:, 0] + line[:, 1] * (log_mass - 10.0) + numbers["scatter"] * normal
    return np.minimum(10 ** np.minimum(log, 0.0), 1.0)


def ellipticity_density(e: FloatArray, numbers: Mapping[str, Any]) -> FloatArray:
    """Return the unnormalised prior P(|e|) of discs, |e| = (a - b)/(a + b)."""
    cut = 1 - np.exp((e - numbers["e_max"]) / numbers["a"])
    return e * cut / ((1 + e) * np.sqrt(e**2 + numbers["e0"] ** 2))


def draw_ellipticity(generator: np.random.Generator, round_: BoolArray, numbers: Mapping[str, Any]) -> ComplexArray:
    """Return complex e (n,), isotropic: from the disc prior; where `round_`, from a Rayleigh law cut at `round_max`."""
    grid = np.linspace(0, numbers["e_max"], 2001)
    total = np.cumsum(ellipticity_density(grid, numbers))
    u = generator.random(len(round_))
    disc = np.interp(u * total[-1], total, grid)
    top = -np.expm1(-0.5 * (numbers["round_max"] / numbers["round_sigma"]) ** 2)
    bulge = numbers["round_sigma"] * np.sqrt(-2 * np.log1p(-u * top))
    return np.where(round_, bulge, disc) * np.exp(2j * np.pi * generator.random(len(u)))


def to_arcsec(radius_kpc: Floats, z: Floats, cosmology: Cosmology) -> FloatArray:
    """Return the angular size [arcsec] of a length [kpc] at redshift z."""
    return radius_kpc * 1e-3 * (1 + z) / cosmology.comoving_distance(z) * ARCSEC_PER_RAD


def equal_area(axis: FloatArray, e: FloatArray) -> FloatArray:
    """Return the radius of the circle with the area of an ellipse: semi-major axis `axis`, e = (a - b)/(a + b)."""
    return axis * np.sqrt((1 - e) / (1 + e))


def velocity_dispersion(log_mass: FloatArray, radius_kpc: FloatArray, virial: float) -> FloatArray:
    """Return sigma [km/s] from the virial theorem, sigma^2 = G M / (virial R)."""
    return np.sqrt(G_KPC_KM2_S2_MSUN * 10**log_mass / (virial * radius_kpc))
