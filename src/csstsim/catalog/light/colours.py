"""Spectra that reproduce magnitudes in the camera's bands, for tables of objects (catalog.own_table).

A spectrum's AB magnitude is linear in the logarithm of wavelength between the pivots of the bands given, constant
beyond them, and chosen so that each band has its given magnitude. A single magnitude gives a spectrum flat in f_nu.
Colours that jump (bright in y, faint in z, which overlaps y) have no such spectrum: it then has the given magnitudes at
the pivots, and the truth table's `mag` states what was rendered.

Such a spectrum is a power law between pivots. So neither its flux through a band nor its mean over a bin of
wavelength needs its 18001 samples (catalog.light.colour_sums). BLAS and LAPACK are not used.
"""

from __future__ import annotations

from functools import lru_cache
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from csstsim.base.units import ab_photon_density
from csstsim.catalog.light.colour_sums import PivotMoments, bins, newton
from csstsim.instrument.filter import GRID, Filter

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from csstsim.base.types import FloatArray, IntArray

# of the spectra's magnitudes [mag]; Newton's steps, three or four for most
MAG_TOLERANCE = 1e-4
PASSES = 30
_STEP = 4  # samples of GRID: bands are smooth, the magnitudes the same to 1e-5


def colour_spectra(mags: FloatArray, filters: list[Filter] | tuple[Filter, ...]) -> FloatArray:
    """Return (n, 18001) spectra [photon / s / m2 / A] of AB magnitudes (n, len(filters)), NaN where not known."""
    spectra = np.zeros((len(mags), len(GRID)))
    for rows, bands, nodes in _groups(mags, filters):
        hats = _hats(bands, GRID)
        spectra[rows] = 10 ** (-0.4 * np.einsum("nb,bw->nw", nodes, hats)) * ab_photon_density(GRID)
    return spectra


def colour_rates(mags: FloatArray, filters: list[Filter] | tuple[Filter, ...], weights: FloatArray) -> FloatArray:
    """Return (n, len(weights)): sums of the spectra times weights (m, 18001), as photometry.subband_weights gives."""
    rates = np.zeros((len(mags), len(weights)))
    for rows, bands, nodes in _groups(mags, filters):
        rates[rows] = PivotMoments(_pivots(bands), GRID, weights * ab_photon_density(GRID)).sums(nodes)
    return rates


def colour_bins(mags: FloatArray, filters: list[Filter] | tuple[Filter, ...], edges: FloatArray) -> FloatArray:
    """Return (n, len(edges) - 1) photon / s / m2 / A: means of the spectra over bins of `edges` [angstrom]."""
    means = np.zeros((len(mags), len(edges) - 1))
    edges = np.asarray(edges, dtype=float)
    for rows, bands, nodes in _groups(mags, filters):
        means[rows] = bins(nodes, _pivots(bands), np.log(edges)) * ab_photon_density(1.0) / np.diff(edges)
    return means


class _Group(NamedTuple):
    """Rows (n,) with magnitudes in the same filters (b,), by pivot; nodes (n, b): AB magnitudes at the pivots."""

    rows: IntArray
    filters: tuple[Filter, ...]
    nodes: FloatArray


def _groups(mags: FloatArray, filters: list[Filter] | tuple[Filter, ...]) -> Iterator[_Group]:
    """Yield the groups of rows with the same known bands."""
    mags = np.asarray(mags, dtype=float)
    known, kind = np.unique(np.isfinite(mags), axis=0, return_inverse=True)
    for number, has in enumerate(known):
        rows = np.flatnonzero(kind.reshape(-1) == number)
        bands = sorted(np.flatnonzero(has), key=lambda b: filters[b].pivot)
        used = tuple(filters[b] for b in bands)
        yield _Group(rows, used, newton(mags[np.ix_(rows, bands)], _through(used), MAG_TOLERANCE, PASSES))


@lru_cache(128)
def _through(filters: tuple[Filter, ...]) -> PivotMoments:
    """Return the PivotMoments of the bands; their sums are the flux through each band, 1 for a flat spectrum."""
    wave = GRID[::_STEP]
    weights = np.stack([f.at(wave) for f in filters]) * ab_photon_density(wave)
    return PivotMoments(_pivots(filters), wave, weights / weights.sum(axis=1, keepdims=True))


def _pivots(filters: Sequence[Filter]) -> FloatArray:
    return np.log([f.pivot for f in filters])


def _hats(filters: Sequence[Filter], wave: FloatArray) -> FloatArray:
    """Return (bands, len(wave)): 1 at a band's pivot, 0 at its neighbours', linear in the logarithm of wavelength."""
    return np.stack([np.interp(np.log(wave), _pivots(filters), row) for row in np.eye(len(filters))])
