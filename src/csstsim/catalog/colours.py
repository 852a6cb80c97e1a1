"""Spectra of magnitudes in the camera's bands, for tables of objects (catalog.own_table).

A spectrum's AB magnitude is linear in the logarithm of wavelength between the pivots of the bands given, constant
beyond them, and set so that each band has its own. One magnitude means a flat spectrum, in f_nu. Colours that jump
(bright in y, dark in z, which holds y's light) have no such spectrum: it then goes through the magnitudes at the
pivots, and the truth table's `mag` says what was drawn.
"""

import numpy as np

from csstsim.instrument.filter import GRID
from csstsim.units import ab_photon_density

MAG_TOLERANCE, PASSES = 1e-4, 30  # of the spectra's magnitudes [mag]; Newton's steps, three or four for most


def colour_spectra(mags, filters):
    """Return (n, 18001) spectra [photon / s / m2 / A] of AB magnitudes (n, len(filters)), NaN where not known."""
    mags = np.asarray(mags, dtype=float)
    spectra = np.zeros((len(mags), len(GRID)))
    known, kind = np.unique(np.isfinite(mags), axis=0, return_inverse=True)
    for number, bands in enumerate(known):
        rows = np.flatnonzero(kind.reshape(-1) == number)
        here = sorted((f for f, has in zip(filters, bands, strict=True) if has), key=lambda f: f.pivot)
        wanted = mags[np.ix_(rows, [filters.index(f) for f in here])]
        spectra[rows] = _light(_nodes(wanted, here), here, GRID) * ab_photon_density(GRID)
    return spectra


def _light(nodes, filters, wave):
    """Return (n, len(wave)): flux density over that of magnitude 0, of magnitudes (n, bands) at the bands' pivots."""
    return 10 ** (-0.4 * np.einsum("nb,bw->nw", nodes, _hats(filters, wave)))


def _hats(filters, wave):
    """Return (bands, len(wave)): 1 at a band's pivot, 0 at its neighbours', linear in the logarithm of wavelength."""
    pivots = np.log([f.pivot for f in filters])
    return np.stack([np.interp(np.log(wave), pivots, row) for row in np.eye(len(filters))])


def _nodes(mags, filters):
    """Return (n, bands) magnitudes at the pivots with which spectra have `mags`, by Newton's method.

    Rows for which there are none keep their magnitudes as those at the pivots.
    """
    wave = GRID[::4]  # 2 A: bands are smooth, the magnitudes the same to 1e-5
    hats, weights = _hats(filters, wave), np.stack([f.at(wave) for f in filters]) * ab_photon_density(wave)
    weights /= weights.sum(axis=1, keepdims=True)
    nodes, found = mags.copy(), np.zeros(len(mags), bool)
    with np.errstate(all="ignore"):  # colours that no spectrum has
        for _ in range(PASSES):
            light = _light(nodes, filters, wave)
            through = np.einsum("nw,bw->nb", light, weights)
            off = mags + 2.5 * np.log10(through)
            found = np.abs(off).max(axis=1, initial=0.0) < MAG_TOLERANCE
            if found.all():
                break
            slopes = np.einsum("nw,bw,cw->nbc", light, weights, hats, optimize=True) / through[:, :, None]
            go = ~found & np.isfinite(slopes).all(axis=(1, 2)) & (np.linalg.cond(np.nan_to_num(slopes)) < 1e6)
            step = np.linalg.solve(slopes[go], off[go][:, :, None])[:, :, 0]
            nodes[go] += np.clip(step, -1.0, 1.0)
    nodes[~found] = mags[~found]
    return nodes
