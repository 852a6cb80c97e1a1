"""Synthetic photometry: electrons per second in each PSF sub-band, and AB magnitudes (paper, section 5.3).

The paper prints F = int(S T) / int(T), a mean density, but uses it as a rate. The rate is

    F_i = A int S(lambda) T_i(lambda) dlambda      electron / s in sub-band i of the filter,

S in photon / s / m2 / angstrom, T_i in electron / photon. Integrals are trapezoidal on the spectra's own grid.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from csstsim.base.errors import InputError
from csstsim.base.units import ab_photon_density
from csstsim.instrument.filter import GRID, SUBBANDS, Filter

if TYPE_CHECKING:
    from collections.abc import Callable

    from csstsim.base.types import FloatArray, Floats, IntArray
    from csstsim.instrument.telescope import Telescope

CHUNK = 256  # spectra integrated at a time: 256 x 18,001 samples are 37 MB


def subband_weights(filter: Filter, telescope: Telescope, wavelength: FloatArray = GRID) -> FloatArray:
    """Return (4, n) weights w such that `sed @ w.T` is electrons / s: A T_i(lambda) dlambda (trapezoid rule)."""
    step = np.zeros_like(wavelength)
    gaps = 0.5 * np.diff(wavelength)
    step[:-1] += gaps
    step[1:] += gaps
    return telescope.area_m2 * filter.subband(wavelength) * step


def subband_fluxes(seds: FloatArray, filter: Filter, telescope: Telescope, wavelength: FloatArray = GRID) -> FloatArray:
    """Return the electrons per second of spectra in the sub-bands of a filter.

    Parameters
    ----------
    seds : (n, m) array of float
        Spectra [photon / s / m2 / angstrom].
    filter : Filter
        A filter of the camera.
    telescope : Telescope
        The camera's telescope.
    wavelength : (m,) array of float
        Samples of the spectra [angstrom], rising; by default the paper's grid.

    Returns
    -------
    (n, 4) array of float
        Flux in each sub-band [electron / s].
    """
    weights = subband_weights(filter, telescope, wavelength)
    used = np.flatnonzero(weights.any(axis=0))
    band = slice(used[0], used[-1] + 1)
    # einsum, not a BLAS product: the same bits for any number of threads
    return np.einsum("nw,fw->nf", np.asarray(seds)[:, band], weights[:, band])


def load_fluxes(
    load_seds: Callable[[IntArray], FloatArray], rows: IntArray, filter: Filter, telescope: Telescope
) -> FloatArray:
    """Return (len(rows), 4) electrons / s, loading spectra in chunks by `load_seds(rows) -> (n, 18001)`."""
    fluxes = np.zeros((len(rows), SUBBANDS))
    for start in range(0, len(rows), CHUNK):
        part = slice(start, start + CHUNK)
        seds = np.asarray(load_seds(rows[part]))
        if seds.shape != (len(rows[part]), len(GRID)):
            raise InputError(
                "load_seds gave a wrong shape", key="catalog", value=seds.shape, allowed=(len(rows[part]), len(GRID))
            )
        fluxes[part] = subband_fluxes(seds, filter, telescope)
    return fluxes


def rate_to_mag(rate: Floats, filter: Filter, telescope: Telescope) -> FloatArray:
    """Return the AB magnitude of a flux.

    Parameters
    ----------
    rate : float or (n,) array of float
        Total flux in the filter [electron / s].
    filter : Filter
        A filter of the camera.
    telescope : Telescope
        The camera's telescope.

    Returns
    -------
    float or (n,) array of float
        AB magnitude [mag]; infinite for zero flux, NaN for a flux that is negative or NaN.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        return filter.zeropoint(telescope) - 2.5 * np.log10(np.asarray(rate, dtype=float))


def ab_mag(sed: FloatArray, wavelength: FloatArray, throughput: FloatArray) -> FloatArray:
    """Return the AB magnitude of one spectrum through a photon-counting response.

    Parameters
    ----------
    sed : (n,) array of float
        Spectrum [photon / s / m2 / angstrom].
    wavelength : (n,) array of float
        Samples of spectrum and response [angstrom], rising.
    throughput : (n,) array of float
        Response, in any unit.

    Returns
    -------
    float
        AB magnitude [mag].
    """
    counts = np.trapezoid(sed * throughput, wavelength)
    reference = np.trapezoid(ab_photon_density(wavelength) * throughput, wavelength)
    with np.errstate(divide="ignore", invalid="ignore"):
        return -2.5 * np.log10(counts / reference)


def bin_means(spectra: FloatArray, at: IntArray) -> FloatArray:
    """Return (n, len(at) - 1): means of evenly sampled spectra (n, samples), linear between, from sample to sample."""
    running = np.zeros(spectra.shape)
    np.cumsum(0.5 * (spectra[:, 1:] + spectra[:, :-1]), axis=1, out=running[:, 1:])
    return np.diff(running[:, at], axis=1) / np.diff(at)
