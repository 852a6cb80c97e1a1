"""Spectra of galaxies: a few rest-frame templates, mixed, redshifted and absorbed (first version).

    S(lambda) = scale x IGM(lambda, z) x sum_k c_k P_k(lambda / (1 + z))      photon / s / m2 / angstrom

P_0..3 are broken lines (config/universe/): old, intermediate, young, dusty; P_4 is emission lines. Each
P_k is a photon density, 1 at 5500 A rest for the stellar ones; below 912 A the stars fade by `lyman_limit`. The
intergalactic medium is the mean Lyman forest and a floor below the Lyman limit (after Madau 1995). Left out:
single absorption lines, scatter between sight-lines, AGN.

Templates live on a grid uniform in ln(lambda), so a redshift that is a whole number of steps is a shift, and all
band fluxes of all galaxies are sum_k c_k M_k(z) with one table M per set of bands.
"""

from functools import lru_cache

import numpy as np

from csstsim.instrument.filter import GRID
from csstsim.units import C_KM_S
from csstsim.universe.igm import LYMAN_LIMIT, Intergalactic
from csstsim.universe.star_sed import _Weights

COEFFICIENTS = 5
_STEP = 1e-4  # ln(angstrom) of the template grid: 0.5 A at 5000 A
_SHIFT = 5  # steps of ln(1 + z) per row of a band table: 5e-4, half the width (sigma) of an emission line
_OBSERVED = (np.log(GRID[0]), np.log(GRID[-1]))


class GalaxySeds:
    """Spectra of galaxies from (z, coefficients, scale); see the module."""

    def __init__(self, numbers):
        self.z_max = float(numbers["redshift"]["z_max"])
        self._igm = numbers["igm"]
        # Whole steps: the observed grid starts at row `origin` of the template grid.
        self._observed = np.arange(_OBSERVED[0], _OBSERVED[1] + _STEP, _STEP)
        self._reach = int(np.ceil(np.log1p(self.z_max) / _STEP / _SHIFT)) * _SHIFT
        self._ln_rest = _OBSERVED[0] - _STEP * (self._reach - np.arange(self._reach + len(self._observed)))
        self.templates = self._make_templates(numbers)
        self._table = lru_cache(maxsize=64)(self._make_table)

    def _make_templates(self, numbers):
        """Return (5, n) photon densities on the rest-frame grid."""
        wave = np.exp(self._ln_rest)
        out = np.zeros((COEFFICIENTS, len(wave)))
        for k, name in enumerate(("old", "intermediate", "young", "dusty")):
            knots = np.asarray(numbers["templates"][name], dtype=float)
            magnitude = np.interp(self._ln_rest, np.log(knots[:, 0]), knots[:, 1])
            magnitude = magnitude + numbers["lyman_limit"] * 0.5 * (1 - np.tanh((wave - LYMAN_LIMIT) / 4.0))
            out[k] = 10 ** (-0.4 * magnitude) * 5500.0 / wave  # AB magnitude to photons: f_nu / lambda
        sigma = numbers["lines"]["sigma_km_s"] / C_KM_S
        for centre, width in numbers["lines"]["table"]:
            offset = (self._ln_rest - np.log(centre)) / sigma
            out[4] += width / (centre * sigma * np.sqrt(2 * np.pi)) * np.exp(-0.5 * offset**2)
        return out

    def spectra(self, z, coefficients, scale, wavelength=GRID):
        """Return (n, len(wavelength)) spectra; z (n,), coefficients (n, 5), scale (n,)."""
        out = np.empty((len(z), len(wavelength)))
        ln_wave, forest = np.log(wavelength), Intergalactic(wavelength, self._igm)
        for i, (redshift, mix, size) in enumerate(zip(z, coefficients, scale, strict=True)):
            used = np.flatnonzero(mix)
            rest = np.einsum("k,kw->w", np.asarray(mix, dtype=float)[used], self.templates[used])
            out[i] = float(size) * np.interp(ln_wave - np.log1p(float(redshift)), self._ln_rest, rest)
            forest.absorb(out[i], float(redshift))
        return out

    def integrate(self, z, coefficients, weights):
        """Return (n, bands): int S w dlambda at unit scale, for `weights` (bands, 18001) on the paper's grid."""
        table = self._table(_Weights(weights))
        x = np.clip(np.log1p(np.asarray(z, dtype=float)) / (_STEP * _SHIFT), 0, len(table) - 1)
        row = np.minimum(x.astype(int), len(table) - 2)
        t = (x - row)[:, None]
        total = np.zeros((len(row), table.shape[1]))
        for k in range(COEFFICIENTS):
            m = table[:, :, k]
            total += np.asarray(coefficients[:, k], dtype=float)[:, None] * (m[row] * (1 - t) + m[row + 1] * t)
        return total

    def _make_table(self, weights):
        """Return (redshifts, bands, 5) integrals; row j is ln(1 + z) = j x 5e-4."""
        wave = np.exp(self._observed)
        # Density of the weights on the log grid: w dlambda = w lambda dln; the 0.5 A grid's weights hold its step.
        step = GRID[1] - GRID[0]
        dense = np.stack([np.interp(wave, GRID, w / step, left=0.0, right=0.0) for w in weights.array]) * wave * _STEP
        rows = self._reach // _SHIFT + 1
        table = np.zeros((rows, len(dense), COEFFICIENTS))
        for b, w in enumerate(dense):
            used = np.flatnonzero(w)
            band = slice(used[0], used[-1] + 1)
            forest = Intergalactic(wave[band], self._igm)
            for j in range(rows):
                start = self._reach - j * _SHIFT
                absorbed = forest.absorb(w[band].copy(), np.expm1(j * _SHIFT * _STEP))
                table[j, b] = np.einsum("w,kw->k", absorbed, self.templates[:, start + band.start : start + band.stop])
        return table
