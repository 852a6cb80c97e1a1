"""The chip's WCS with its distortion as a FITS header: TAN-SIP (Shupe et al. 2005, ASP Conf. 347, 491).

    (xi, eta) = CD (u + A(u, v), v + B(u, v)),   (u, v) = pixel - CRPIX

A and B hold the terms of degree 2 to `order`. The reference point is the centre of the chip, not the boresight, because
polynomials about a point up to 30,000 px away lose digits. So CRVAL is the sky position of that pixel and CD the
derivative there; A and B contain both the distortion and the change of tangent plane. AP and BP are the inverse.
"""

from typing import Any

import numpy as np

from csstsim.base.types import FloatArray
from csstsim.base.units import ARCSEC_PER_DEG
from csstsim.optics.geometry.wcs import ChipWCS, gnomonic

ORDER = 4
_NODES = 25  # along a side of the chip, edge to edge


def sip_header(wcs: ChipWCS, order: int = ORDER) -> dict[str, Any]:
    """Return the FITS WCS keywords {name: value} of a ChipWCS, A_i_j, B_i_j, AP_i_j and BP_i_j fitted over the chip.

    order: 2 to 9. Measured against the model (benchmarks/distortion.py): within 2e-4 px on all chips at order 4.
    """
    detector = wcs.chip.detector
    middle = np.array([(detector.nx - 1) / 2, (detector.ny - 1) / 2])
    ra, dec = map(float, wcs.pixel_to_world(*middle))
    crval = ra, dec
    # East at crval is the direction of xi, so the derivative on the tangent plane there is that on the sky.
    cd = np.linalg.inv(wcs.jacobian(ra, dec)) / ARCSEC_PER_DEG
    edge_x, edge_y = (np.linspace(-0.5, n - 0.5, _NODES) for n in (detector.nx, detector.ny))
    x, y = (a.ravel() for a in np.meshgrid(edge_x, edge_y))
    seen = np.stack([x - middle[0], y - middle[1]])
    plane = np.degrees(gnomonic(crval, *wcs.pixel_to_world(x, y)))
    flat = np.linalg.solve(cd, plane)
    header = wcs.header() | {"CTYPE1": "RA---TAN-SIP", "CTYPE2": "DEC--TAN-SIP"}
    for axis in (1, 2):
        header |= {f"CRVAL{axis}": crval[axis - 1], f"CRPIX{axis}": float(middle[axis - 1] + 1)}
        header |= {f"CD{axis}_{i}": float(cd[axis - 1, i - 1]) for i in (1, 2)}
    there = _polynomials(seen, flat - seen, order)
    back = _polynomials(flat, seen - flat, order)
    for names, terms in ((("A", "B"), there), (("AP", "BP"), back)):
        for name, column in zip(names, range(2), strict=True):
            header[f"{name}_ORDER"] = order
            header |= {f"{name}_{i}_{j}": float(values[column]) for (i, j), values in terms.items()}
    return header


def _polynomials(points: FloatArray, wanted: FloatArray, order: int) -> dict[tuple[int, int], FloatArray]:
    """Return {(i, j): (a, b)} of x^i y^j, 2 <= i + j <= order, fitted to `wanted` (2, n) at `points` (2, n)."""
    powers = [(i, n - i) for n in range(2, order + 1) for i in range(n, -1, -1)]
    scale = np.abs(points).max()
    x, y = points / scale
    terms = np.stack([x**i * y**j for i, j in powers])
    # Normal equations with sums in a fixed order: the header's digits do not depend on the number of threads.
    solution = np.linalg.solve(np.einsum("in,jn->ij", terms, terms), np.einsum("in,kn->ik", terms, wanted))
    return {(i, j): row / scale ** (i + j) for (i, j), row in zip(powers, solution, strict=True)}
