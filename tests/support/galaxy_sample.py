"""The shipped galaxy population for tests, builders and benchmarks, with magnitudes in all bands."""

from functools import cache

import numpy as np
from scipy.special import gammainc

from csstsim.base.rng import stream
from csstsim.base.shipped import SHIPPED
from csstsim.catalog.light.photometry import rate_to_mag, subband_weights
from csstsim.instrument.camera import load_camera
from csstsim.instrument.filter import GRID
from csstsim.instrument.load import read_data
from csstsim.universe.coefficients import COEFFICIENTS
from csstsim.universe.dust.extinction import odonnell
from csstsim.universe.galaxies.galaxies import GalaxyPopulation
from csstsim.universe.galaxies.galaxy_sed import GalaxySeds
from csstsim.universe.lensing.cosmology import Cosmology
from support.csst import BANDS

FOLDER = SHIPPED / "universe"


@cache
def numbers():
    return read_data(FOLDER / "galaxies.yaml")


@cache
def filters():
    """Return the seven imaging filters in the order of BANDS, and the telescope."""
    camera = load_camera(SHIPPED / "instrument")
    by_name = {name.lower(): f for name, f in camera.filters.items()}
    return [by_name[band] for band in BANDS], camera.telescope


@cache
def weights():
    """Return (7, 18001): electrons / s per photon density."""
    bands, telescope = filters()
    return np.stack([subband_weights(f, telescope).sum(axis=0) for f in bands])


@cache
def seds():
    return GalaxySeds(FOLDER / "galaxy_spectra.fits", numbers()["igm"], odonnell(GRID))


@cache
def cosmology():
    return Cosmology(read_data(FOLDER / "cosmology.yaml"))


def population(values=None):
    """Return the GalaxyPopulation of the shipped (or given) numbers, with the shipped camera's i filter."""
    return _shipped() if values is None else _population(values)


@cache
def _shipped():
    return _population(numbers())


def _population(values):
    band = BANDS.index("i")
    bands, telescope = filters()
    return GalaxyPopulation(values, seds(), cosmology(), weights()[band : band + 1], bands[band].zeropoint(telescope))


@cache
def sample(area, seed=1):
    """Return the columns of the galaxies on `area` [deg2]."""
    return population().draw(lambda name: stream(seed, "sample", name), area)


def half_light(columns):
    """Return the half-light radius [arcsec] of de Vaucouleurs bulge and exponential disc together."""
    disk, bulge = (np.asarray(columns[name], float) for name in ("size_disk", "size_bulge"))
    low, high = np.minimum(disk, bulge), np.maximum(disk, bulge)
    for _ in range(30):  # halving
        middle = 0.5 * (low + high)
        light = gammainc(8, 7.669 * (middle / bulge) ** 0.25) * columns["bulge_frac"]
        light += gammainc(2, 1.678 * middle / disk) * (1 - columns["bulge_frac"])
        low, high = np.where(light < 0.5, middle, low), np.where(light < 0.5, high, middle)
    return middle


def magnitudes(columns, bands=BANDS):
    """Return {band: AB magnitude (n,)} without extinction or lensing."""
    mix = np.stack([columns[f"coeff{k}"] for k in range(COEFFICIENTS)], axis=1)
    where = [BANDS.index(band) for band in bands]
    rates = seds().rates(columns["z"], mix, np.zeros(len(mix)), weights()[where]) * columns["sed_scale"][:, None]
    every, telescope = filters()
    return {
        band: rate_to_mag(rates[:, j], every[k], telescope)
        for j, (band, k) in enumerate(zip(bands, where, strict=True))
    }


def top_hat(columns, low, high):
    """Return AB magnitudes (n,), but for a constant, in a filter between two wavelengths [A]: other cameras' bands."""
    mix = np.stack([columns[f"coeff{k}"] for k in range(COEFFICIENTS)], axis=1)
    band = ((low <= GRID) & (high >= GRID)).astype(float)
    rate = seds().rates(columns["z"], mix, np.zeros(len(mix)), band[None])[:, 0] * columns["sed_scale"]
    return -2.5 * np.log10(np.maximum(rate, 1e-300) / (band / GRID).sum())  # AB: photons per angstrom go as 1 / lambda


def line_width(z, log_mass, low, high, count=400):
    """Return the median equivalent width of the lines between two wavelengths [A, rest frame], and the median rate.

    Of `count` star-forming galaxies of one redshift and log10 mass, seen at |e| = 0.3. The rate is the specific
    star-formation rate [1e-9 / yr].
    """
    every = np.ones(count)
    mix, dust, lines, history = population()._stars(
        lambda name: stream(6, name), z * every, log_mass * every, 0 * every, 0.3 * every
    )
    inside = (seds().wavelength > low) & (seds().wavelength < high)
    full, plain = (seds().coefficients(mix, dust, factor) @ seds().basis[:, inside] for factor in (lines, 0 * lines))
    return np.median((full / plain - 1).sum(axis=1)) * seds().step, np.median(history["sfr"]) / 10 ** (log_mass - 9)
