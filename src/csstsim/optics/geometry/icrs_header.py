"""The world coordinates of a window in ICRS as a TPV header, which source-extractor, SCAMP, SWarp and astropy read.

Pixels lead to apparent directions (ChipWCS), these to ICRS with aberration and light deflection undone. The linear part
is the derivative in the middle of the window; polynomials PV1_k, PV2_k of degree ORDER hold the rest, the field's
distortion and the gradient of aberration. TPV: https://fits.gsfc.nasa.gov/registry/tpvwcs/tpv.html
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from csstsim.base.sphere import frames, unit_vectors
from csstsim.base.types import FloatArray
from csstsim.catalog.astrometry.reduction import icrs
from csstsim.optics.geometry.wcs import ChipWCS, gnomonic

if TYPE_CHECKING:
    from csstsim.catalog.astrometry.ephemeris import Observer
    from csstsim.instrument.chip import Window

ORDER = 4
# PVi_k: (power of the axis' own coordinate, of the other's), without the odd powers of the radius (k = 3, 11)
TERMS = {
    0: (0, 0), 1: (1, 0), 2: (0, 1), 4: (2, 0), 5: (1, 1), 6: (0, 2), 7: (3, 0), 8: (2, 1), 9: (1, 2), 10: (0, 3),
    12: (4, 0), 13: (3, 1), 14: (2, 2), 15: (1, 3), 16: (0, 4),
}  # fmt: skip
# positions along a side for the fit; px of the derivative
_NODES = 21
_STEP = 8.0


def icrs_header(wcs: ChipWCS, observer: Observer, window: Window) -> dict[str, Any]:
    """Return the FITS keywords {name: value} of a window's world coordinates in ICRS, pixels counted in the window.

    wcs: ChipWCS; observer: catalog.astrometry.ephemeris.Observer; window: instrument.chip.Window. Within 0.1 mas of the
    reduction over a chip.
    """

    def sky(x: ArrayLike, y: ArrayLike) -> tuple[FloatArray, FloatArray]:
        return icrs(*wcs.pixel_to_world(np.asarray(x, float), np.asarray(y, float)), observer)

    middle = (window.x0 + window.x1 - 1) / 2, (window.y0 + window.y1 - 1) / 2
    ra, dec = (float(v[0]) for v in sky([middle[0]], [middle[1]]))
    crval = ra, dec
    cd = _derivative(sky, middle, crval)
    x, y = (
        v.ravel()
        for v in np.meshgrid(
            np.linspace(window.x0 - 0.5, window.x1 - 0.5, _NODES), np.linspace(window.y0 - 0.5, window.y1 - 0.5, _NODES)
        )
    )
    linear = cd @ np.stack([x - middle[0], y - middle[1]])
    wanted = np.degrees(gnomonic(crval, *sky(x, y)))
    header: dict[str, Any] = {
        "WCSAXES": 2,
        "CTYPE1": "RA---TPV",
        "CTYPE2": "DEC--TPV",
        "CUNIT1": "deg",
        "CUNIT2": "deg",
    }
    for axis in (0, 1):
        header[f"CRVAL{axis + 1}"] = crval[axis]
        header[f"CRPIX{axis + 1}"] = float(middle[axis] - (window.x0, window.y0)[axis] + 1)
        header |= {f"CD{axis + 1}_{i + 1}": float(cd[axis, i]) for i in (0, 1)}
    for axis in (0, 1):
        own = linear[axis]
        other = linear[1 - axis]
        scale = max(np.abs(linear).max(), 1e-12)
        matrix = np.stack([(own / scale) ** i * (other / scale) ** j for i, j in TERMS.values()], axis=1)
        # Normal equations with sums in a fixed order: the same digits whatever the number of threads
        found = np.linalg.solve(
            np.einsum("ni,nj->ij", matrix, matrix), np.einsum("ni,n->i", matrix, wanted[axis] - own)
        )
        for (k, (i, j)), value in zip(TERMS.items(), found, strict=True):
            header[f"PV{axis + 1}_{k}"] = float(value / scale ** (i + j)) + (1.0 if k == 1 else 0.0)
    return header | {"RADESYS": "ICRS", "EQUINOX": 2000.0}


def _derivative(
    sky: Callable[[ArrayLike, ArrayLike], tuple[FloatArray, FloatArray]],
    middle: tuple[float, float],
    crval: tuple[float, float],
) -> FloatArray:
    """Return d(east, north) / d(x, y) [deg / px] in the middle."""
    at = unit_vectors(*sky(middle[0] + _STEP * np.array([1, -1, 0, 0]), middle[1] + _STEP * np.array([0, 0, 1, -1])))
    _, east, north = frames(*np.radians(crval))
    moved = np.stack([(at[0] - at[1]), (at[2] - at[3])]) / (2 * _STEP)
    return np.degrees(np.stack([moved @ east, moved @ north]))


def corners(wcs: ChipWCS, observer: Observer, window: Window) -> list[list[float]]:
    """Return [[ra, dec], ...] of a window's corners, deg, ICRS, in order round it."""
    x = np.array([window.x0, window.x1, window.x1, window.x0]) - 0.5
    y = np.array([window.y0, window.y0, window.y1, window.y1]) - 0.5
    return np.transpose(icrs(*wcs.pixel_to_world(x, y), observer)).tolist()
