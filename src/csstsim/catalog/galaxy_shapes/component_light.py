"""Colour gradients of the embedded universe's galaxies (`components: full`): fractions of components by wavelength.

A star-forming galaxy's bulge, disk and knots have populations of their own (config/components.yaml). At a rest-frame
wavelength the components have the fractions

    bulge : disk : knots  =  B b(lambda) : (1 - B - K) d(lambda) : K k(lambda)

of the galaxy's flux, where b, d and k are the spectra of these populations, B = bulge_frac and K = knots_frac. At one
wavelength b equals d, at another one k equals d: there the ratio to the disk is that of the table. The fractions sum
to 1, so that the galaxy keeps its spectrum, and its magnitudes, for any populations. Bluer galaxies have bluer bulges
and bluer disks (Kennedy et al. 2016, MNRAS 460, 3458). Quiescent galaxies have one spectrum: bulges and disks of early
types are alike (Quilley et al. 2025, arXiv:2508.21461).

Through a band, the fractions are those of the populations' flux in it. Omitted: the slope of the galaxy's own spectrum
within a band, and differences between the sub-bands of the PSF.
"""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from csstsim.catalog.galaxy_shapes.full_components import STAR_FORMING, load_numbers
from csstsim.catalog.table import GALAXY, ObjectTable
from csstsim.instrument.filter import GRID, Filter
from csstsim.universe.galaxies.star_formation import mixture

if TYPE_CHECKING:
    from csstsim.base.types import BoolArray, FloatArray
    from csstsim.universe.parameters import Universe

BULGE, DISK, KNOTS = range(3)
_STEP = 4  # samples of GRID: 2 angstrom, finer than the populations' spectra
_FLAT = 50.0  # angstrom on either side of a reference wavelength


class ComponentLight:
    """The fractions of flux of the components of galaxies, from the populations of config/components.yaml.

    universe: universe.parameters.Universe, whose spectra of populations are used.
    """

    def __init__(self, universe: Universe) -> None:
        self._universe = universe

    @cached_property
    def spectra(self) -> FloatArray:
        """(3, n) photon density of bulge, disk and knots at the rest wavelengths of GalaxySeds.wavelength."""
        seds = self._universe.galaxy_seds
        numbers = load_numbers()
        laws = [numbers.populations[name] for name in ("bulge", "disk", "knots")]
        mix = mixture(np.array([law.formed for law in laws]), self._universe.numbers["galaxies"]["star_formation"])
        mixes = seds.coefficients(mix, [law.dust for law in laws], np.array([law.lines for law in laws]))
        spectra = np.maximum(np.einsum("ck,kw->cw", mixes, seds.basis), 0.0)
        bulge, knots = (self._mean_near(spectra, at) for at in (numbers.equal.bulge, numbers.equal.knots))
        return spectra / np.array([bulge[BULGE] / bulge[DISK], 1.0, knots[KNOTS] / knots[DISK]])[:, None]

    def _mean_near(self, spectra: FloatArray, wavelength: float) -> FloatArray:
        """Return (3,) the mean of spectra within _FLAT of a rest wavelength [angstrom]."""
        near = np.abs(self._universe.galaxy_seds.wavelength - wavelength) < _FLAT
        return spectra[:, near].mean(axis=1)

    @cached_property
    def _running(self) -> tuple[FloatArray, FloatArray]:
        """Edges of the samples [A, rest frame] (n + 1,) and integrals of the spectra up to them (3, n + 1)."""
        seds = self._universe.galaxy_seds
        edges = seds.start + seds.step * (np.arange(self.spectra.shape[1] + 1) - 0.5)
        return edges, np.pad(np.cumsum(self.spectra, axis=1) * seds.step, ((0, 0), (1, 0)))

    @staticmethod
    def has_gradient(table: ObjectTable) -> BoolArray:
        """Return (n,) bool: the galaxies of a table with several components, which have spectra of their own."""
        parts = np.stack([table["bulge_frac"], table["knots_frac"], 1.0 - table["bulge_frac"] - table["knots_frac"]])
        return _forming(table) & ((parts > 0).sum(axis=0) > 1)

    def through(self, filter: Filter, table: ObjectTable) -> FloatArray:
        """Return (n, 3): the fractions of bulge, disk and knots in the flux of a table's objects through a Filter."""
        wave = GRID[::_STEP]
        response = filter.at(wave)
        rest_wave = self._universe.galaxy_seds.wavelength
        used = np.flatnonzero(response)
        wave = wave[used[0] : used[-1] + 1]
        response = response[used[0] : used[-1] + 1]
        farthest = max(float(np.max(table["z"], initial=0.0)), 0.01)
        nodes = np.linspace(0.0, np.log1p(farthest), int(np.ceil(np.log1p(farthest) / 0.01)) + 1)
        flux = np.array(
            [[response @ np.interp(wave * np.exp(-x), rest_wave, row) for row in self.spectra] for x in nodes]
        )
        at = np.log1p(np.maximum(table["z"].astype(float), 0.0))
        return _fractions(table, np.stack([np.interp(at, nodes, part) for part in flux.T], axis=-1))

    def binned(self, table: ObjectTable, edges: FloatArray) -> FloatArray:
        """Return (n, bins, 3) fractions as `through`, in bins of observed wavelength with these edges [angstrom]."""
        samples, running = self._running
        rest = np.asarray(edges, float) / (1.0 + table["z"].astype(float)[:, None])
        flux = np.stack([np.diff(np.interp(rest, samples, row), axis=1) for row in running], axis=-1)
        return _fractions(table, flux)


def _forming(table: ObjectTable) -> BoolArray:
    return (table["obj_type"] == GALAXY) & (table["gal_type"] == STAR_FORMING)


def _fractions(table: ObjectTable, flux: FloatArray) -> FloatArray:
    """Return the fractions (n, ..., 3) of components; flux (n, ..., 3): of each component if it were the whole galaxy.

    Galaxies that form no stars have one spectrum, and the fractions of the table; so do wavelengths without flux.
    """
    galaxy = table["obj_type"] == GALAXY
    bulge, knots = (np.where(galaxy, table[name].astype(float), 0.0) for name in ("bulge_frac", "knots_frac"))
    listed = np.stack([bulge, 1.0 - bulge - knots, knots], axis=-1)
    listed = np.maximum(listed, 0.0).reshape(len(listed), *(1,) * (flux.ndim - 2), 3)
    plain = ~_forming(table)
    flux = np.where(plain.reshape(-1, *(1,) * (flux.ndim - 1)), 1.0, flux)
    parts = listed * flux
    total = parts.sum(axis=-1, keepdims=True)
    return np.where(total > 0, parts / np.where(total > 0, total, 1.0), listed)
