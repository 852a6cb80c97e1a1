"""Spectra of stars: the Planck function under a broken line of blanketing (first version).

    f_lambda = B_lambda(Teff) 10^(-0.4 [solar(Teff, lambda) + per_dex(Teff, lambda) [Fe/H]])

The two tables (config/universe/) are fits to model atmospheres at some twenty wavelengths: metal
blanketing in the ultraviolet, the Balmer jump and the molecular bands of M dwarfs are there as steps of
broad-band colour. Left out: every single line, gravity, white dwarfs' own atmospheres.

Band fluxes come from a table in (ln Teff, [Fe/H]), interpolated in ln flux: a brick is linear algebra, not
one integral a star.
"""

from functools import lru_cache

import numpy as np

from csstsim.instrument.filter import GRID
from csstsim.units import C_A_S, H_J_S, K_J_K, ab_photon_density

REFERENCE = 5500.0  # angstrom: the scale of a star is its photon density here
_BAND_V = (5000.0, 5900.0)  # angstrom: the box whose AB magnitude stands for V
_TEFF_STEP = 0.01  # ln K; interpolating ln flux over it errs by less than 3e-4 at 2500 A and 2600 K
_FEH_NODES = 13


class StarSeds:
    """Spectra [photon / s / m2 / angstrom], up to the scale, as a function of (Teff [K], [Fe/H])."""

    def __init__(self, numbers):
        self._knots = np.log(np.asarray(numbers["wavelength"], dtype=float))
        self._ln_teff = np.log(np.asarray(numbers["teff"], dtype=float))
        self._solar = np.asarray(numbers["solar"], dtype=float)
        self._per_dex = np.asarray(numbers["per_dex"], dtype=float)
        self.feh_limits = tuple(numbers["feh_limits"])
        shape = (len(self._ln_teff), len(self._knots))
        if self._solar.shape != shape or self._per_dex.shape != shape:
            raise ValueError(f"stars.spectrum: solar and per_dex must be {shape[0]} rows of {shape[1]}")
        self._table = lru_cache(maxsize=64)(self._make_table)

    def shape(self, teff, feh, wavelength=GRID):
        """Return (n, len(wavelength)) photon densities relative to that at 5500 A."""
        teff, feh = (np.asarray(v, dtype=float)[:, None] for v in (teff, feh))
        dimming = self._dimming(teff[:, 0], np.clip(feh[:, 0], *self.feh_limits))
        knot, t = _cell(self._knots, np.log(wavelength))
        magnitude = dimming[:, knot] * (1 - t) + dimming[:, knot + 1] * t
        return _planck_photons(wavelength, teff) / _planck_photons(REFERENCE, teff) * 10 ** (-0.4 * magnitude)

    def _dimming(self, teff, feh):
        """Return (n, knots) magnitudes, linear in ln Teff, held outside the table."""
        row, t = _cell(self._ln_teff, np.log(teff))
        t = t[:, None]
        low, high = (self._solar[r] + self._per_dex[r] * feh[:, None] for r in (row, row + 1))
        return low * (1 - t) + high * t

    def integrate(self, teff, feh, weights):
        """Return (n, bands): int shape(lambda) w(lambda) dlambda for `weights` (bands, 18001) on the paper's grid."""
        table, ln_teff, fehs = self._table(_Weights(weights))
        i, t = _cell(ln_teff, np.log(np.asarray(teff, dtype=float)))
        j, u = _cell(fehs, np.asarray(feh, dtype=float))
        t, u = t[:, None], u[:, None]
        low = table[i, j] * (1 - u) + table[i, j + 1] * u
        high = table[i + 1, j] * (1 - u) + table[i + 1, j + 1] * u
        return np.exp(low * (1 - t) + high * t)

    def _make_table(self, weights):
        # Nodes on the table's own temperatures, where the blanketing has its kinks, and evenly between.
        steps = np.ceil(np.diff(self._ln_teff) / _TEFF_STEP).astype(int)
        parts = [np.arange(n) / n for n in steps]
        ln_teff = np.concatenate(
            [low + gap * t for low, gap, t in zip(self._ln_teff, np.diff(self._ln_teff), parts, strict=False)]
        )
        ln_teff = np.append(ln_teff, self._ln_teff[-1])
        fehs = np.linspace(*self.feh_limits, _FEH_NODES)
        used = np.flatnonzero(weights.array.any(axis=0))
        band = slice(used[0], used[-1] + 1)
        wave, w = GRID[band], weights.array[:, band]
        rows = [self.shape(np.full(len(fehs), teff), fehs, wave) for teff in np.exp(ln_teff)]
        return np.log([np.einsum("nw,fw->nf", row, w) for row in rows]), ln_teff, fehs

    def unit_v_mag(self, teff, feh):
        """Return the AB magnitude in the V box (5000-5900 A) of a star of unit scale."""
        low, high = _BAND_V
        box = np.where(np.abs(GRID - (low + high) / 2) <= (high - low) / 2, 1.0, 0.0)
        return -2.5 * np.log10(self.integrate(teff, feh, box[None])[:, 0] / (ab_photon_density(GRID) * box).sum())


def _planck_photons(wavelength, teff):
    """Planck photon density per wavelength, any scale."""
    return wavelength**-4.0 / np.expm1(H_J_S * C_A_S / (wavelength * K_J_K * teff))


def _cell(nodes, x):
    """Return the index of the cell of rising `nodes` that holds x, held at both ends, and the place (0..1) in it."""
    x = np.clip(x, nodes[0], nodes[-1])
    i = np.clip(np.searchsorted(nodes, x, side="right") - 1, 0, len(nodes) - 2)
    return i, (x - nodes[i]) / np.diff(nodes)[i]


class _Weights:
    """An array that can be the key of a cache, by content."""

    def __init__(self, array):
        self.array = np.ascontiguousarray(array, dtype=float)
        self._key = (self.array.shape, hash(self.array.tobytes()))

    def __hash__(self):
        return hash(self._key)

    def __eq__(self, other):
        return self._key == other._key
