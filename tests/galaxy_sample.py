"""The shipped galaxy population for tests, builders and benchmarks, with magnitudes in all bands."""

from functools import cache

import numpy as np
from csst import BANDS

from csstsim.base.rng import stream
from csstsim.base.shipped import SHIPPED
from csstsim.catalog.light.photometry import rate_to_mag, subband_weights
from csstsim.instrument.camera import load_camera
from csstsim.instrument.filter import GRID
from csstsim.instrument.load import read_data
from csstsim.universe.dust.extinction import odonnell
from csstsim.universe.galaxies.galaxies import GalaxyPopulation
from csstsim.universe.galaxies.galaxy_sed import COEFFICIENTS, GalaxySeds
from csstsim.universe.lensing.cosmology import Cosmology

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
