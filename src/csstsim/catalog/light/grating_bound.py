"""Upper bound of an object's light through a grating, given its magnitudes in the imaging bands.

Light is not negative. So if c_b >= 0 are such that sum_b c_b T_b(lambda) >= T(lambda) at each wavelength, a grating of
throughput T gives at most sum_b c_b times the electrons of band b. A linear programme finds the c_b that overestimate a
flat spectrum least.

The bands' curves end 10 angstrom inside the blue end of GU's. Wavelengths of least throughput, up to `SPILL` of a flat
spectrum's electrons, are therefore left out; `MARGIN` covers them for spectra up to 16 times as bright there.
"""

from functools import lru_cache

import numpy as np

SPILL = 0.003  # of a flat spectrum's electrons
MARGIN = 1.05  # also covers the error of the magnitudes, 2e-3
_ROUNDING, _STEPS = 1e-12, 1000
_BLOCK = 4  # samples of filter.GRID (2 angstrom) that one constraint covers


@lru_cache(maxsize=16)
def band_shares(grating, bands):
    """Return ((band, c_b), ...) of a Filter and a tuple of Filters, c_b > 0; None if the bands do not cover it."""
    curve, bands_curves = grating.throughput, np.array([band.throughput for band in bands])
    dim_first = np.argsort(curve, kind="stable")
    used = np.zeros(curve.shape, bool)
    used[dim_first[np.cumsum(curve[dim_first]) > SPILL * curve.sum()]] = True
    starts = np.arange(0, len(curve), _BLOCK)
    # The largest throughput wanted and the smallest given in each block: the bound holds at every sample
    wanted = np.maximum.reduceat(np.where(used, curve, 0.0), starts)
    given = np.minimum.reduceat(np.where(used, bands_curves, np.inf), starts, axis=1)
    rows = np.flatnonzero(wanted)
    cover = _cheapest_cover(given[:, rows], wanted[rows], bands_curves.sum(axis=1))
    if cover is None:
        return None
    shares = cover * (1.0 + 1e-6)  # more than the solver's rounding
    return tuple((band, float(c)) for band, c in zip(bands, shares, strict=True) if c > 1e-9)


def _cheapest_cover(given, wanted, cost):
    """Return the c >= 0 of least c . cost with c @ given >= wanted, (m,); None if there is none.

    given: (m, n); wanted: (n,) > 0; cost: (m,) >= 0. The simplex method on the dual programme, whose table has a row
    for each c: max y . wanted with given @ y <= cost, y >= 0. (Importing a solver takes longer than this.)
    """
    count = len(cost)
    table = np.hstack([given, np.eye(count), cost[:, None]])
    gain = np.concatenate([wanted, np.zeros(count + 1)])  # of a unit of each y; in the end - c at the slack variables
    for _ in range(_STEPS):
        enter = int(np.argmax(gain[:-1]))
        if gain[enter] <= _ROUNDING * wanted.max():
            return np.maximum(-gain[-count - 1 : -1], 0.0)
        column = table[:, enter]
        usable = column > _ROUNDING
        if not usable.any():
            return None
        leave = int(np.argmin(np.where(usable, table[:, -1] / np.where(usable, column, 1.0), np.inf)))
        row = table[leave] / column[leave]
        table -= column[:, None] * row
        table[leave] = row
        gain -= gain[enter] * row
    return None


def grating_rate(grating, bands, rates):
    """Return electrons / s that no spectrum exceeds through `grating`, MARGIN included, or None.

    bands: tuple of Filters; rates(band) -> (n,) electrons / s through one of them; NaN where a rate is not known.
    """
    shares = band_shares(grating, bands)
    return shares and MARGIN * sum(c * rates(band) for band, c in shares)
