"""Upper bound of an object's flux through a grating, given its magnitudes in the imaging bands.

Flux is not negative. So if c_b >= 0 are such that sum_b c_b T_b(lambda) >= T(lambda) at each wavelength, a grating of
throughput T gives at most sum_b c_b times the electrons of band b. A linear programme finds the c_b with the smallest
overestimate of a flat spectrum.

The bands' curves end 10 angstrom inside the blue end of GU's. Wavelengths of lowest throughput, up to `SPILL` of a flat
spectrum's electrons, are therefore omitted; `MARGIN` covers them for spectra up to 16 times as bright there.
"""

from __future__ import annotations

from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Callable

    from csstsim.base.types import FloatArray
    from csstsim.instrument.filter import Filter

SPILL = 0.003  # fraction of a flat spectrum's electrons
MARGIN = 1.05  # also covers the error of the magnitudes, 2e-3
_BLOCK = 4  # samples of filter.GRID (2 angstrom) that one constraint covers


@lru_cache(maxsize=16)
def band_coefficients(grating: Filter, bands: tuple[Filter, ...]) -> tuple[tuple[Filter, float], ...] | None:
    """Return ((band, c_b), ...) of a Filter and a tuple of Filters, c_b > 0; None if the bands do not cover it."""
    from scipy.optimize import linprog  # 0.2 s that few commands need

    curve = grating.throughput
    bands_curves = np.array([band.throughput for band in bands])
    ascending = np.argsort(curve, kind="stable")
    used = np.zeros(curve.shape, bool)
    used[ascending[np.cumsum(curve[ascending]) > SPILL * curve.sum()]] = True
    starts = np.arange(0, len(curve), _BLOCK)
    # The maximum of the grating and the minimum of the bands in each block: the bound is then true at every sample
    wanted = np.maximum.reduceat(np.where(used, curve, 0.0), starts)
    given = np.minimum.reduceat(np.where(used, bands_curves, np.inf), starts, axis=1)
    rows = np.flatnonzero(wanted)
    solved = linprog(bands_curves.sum(axis=1), A_ub=-given[:, rows].T, b_ub=-wanted[rows])
    if not solved.success:
        return None
    coefficients = solved.x * (1.0 + 1e-6)  # the solver's tolerance
    return tuple((band, float(c)) for band, c in zip(bands, coefficients, strict=True) if c > 1e-9)


def grating_rate(
    grating: Filter, bands: tuple[Filter, ...], rates: Callable[[Filter], FloatArray]
) -> FloatArray | None:
    """Return electrons / s that no spectrum exceeds through `grating`, MARGIN included, or None.

    bands: tuple of Filters; rates(band) -> (n,) electrons / s through one of them; NaN where a rate is not known.
    """
    coefficients = band_coefficients(grating, bands)
    if coefficients is None:
        return None
    return MARGIN * sum(c * rates(band) for band, c in coefficients)  # type: ignore[return-value]  # one band or more
