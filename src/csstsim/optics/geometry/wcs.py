"""Pixel <-> sky of one chip in one exposure: the gnomonic (TAN) projection about the boresight (paper, 5.2).

All chips share one tangent point, the boresight (CRVAL); each has its own CRPIX and, for the turned grating
chips, its own CD matrix. Source: Calabretta & Greisen 2002 for TAN; CD and CRPIX rules from published Level-1
headers of the Survey Camera, which they reproduce:

    CD = s [[cos pa, sin pa], [-sin pa, cos pa]],   CRPIX = (nx/2 - xc, ny/2 - yc),   s = 0.074 arcsec

`pa` is the position angle of mosaic +y, north through east; the determinant is positive. The published CRPIX are
read as FITS 1-based numbers, so (xc, yc) of chips.yaml is the mosaic position of FITS pixel (nx/2, ny/2), that is
0-based (nx/2 - 1, ny/2 - 1), half a pixel below the geometric centre. A grating chip is turned about its geometric
centre, whose sky position does not change.

With a distortion (optics.geometry.distortion) the pixels are those on which light actually falls. `header()` is always
the linear projection, as in the paper's Level-0 files; headers of optics.geometry.sip include the distortion.

Pixels are 0-based except in `crpix`, `nominal_crpix` and `header()`. Sky positions are apparent ones of the exposure,
including aberration and light deflection (catalog.astrometry.reduction), on axes parallel to the ICRS.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from csstsim.base.sphere import rotation
from csstsim.base.types import FloatArray
from csstsim.base.units import ARCSEC_PER_RAD

if TYPE_CHECKING:
    from csstsim.instrument.chip import Chip, Window
    from csstsim.instrument.pointing import Pointing
    from csstsim.instrument.telescope import Telescope
    from csstsim.optics.geometry.distortion import FieldDistortion


class ChipWCS:
    """The projection of `chip` at `pointing`, vectorised and valid at the poles.

    distortion: an optics.geometry.distortion.FieldDistortion, or None for the ideal, linear pixels.
    """

    def __init__(self, chip: Chip, pointing: Pointing, distortion: FieldDistortion | None = None) -> None:
        self.chip = chip
        self.distortion = distortion.on(chip) if distortion else None
        self.crval = (pointing.ra, pointing.dec)
        self.nominal_cd = mosaic_cd(pointing.pa, chip.telescope)
        self.nominal_crpix = nominal_crpix(chip)
        turn, origin = chip_plane(chip)
        self.cd = self.nominal_cd @ turn
        self.crpix = origin + 1
        self._inverse = np.linalg.inv(self.cd) * math.degrees(1.0)  # pixel per radian

    def world_to_pixel(self, ra: ArrayLike, dec: ArrayLike) -> tuple[FloatArray, FloatArray]:
        """Return 0-based pixel x, y of ra, dec [deg]; NaN at and behind the horizon of the tangent plane."""
        ideal = self._ideal(ra, dec)
        return self.distortion.forward(*ideal) if self.distortion else ideal

    def _ideal(self, ra: ArrayLike, dec: ArrayLike) -> tuple[FloatArray, FloatArray]:
        xi, eta = gnomonic(self.crval, ra, dec)
        x = self._inverse[0, 0] * xi + self._inverse[0, 1] * eta + (self.crpix[0] - 1)
        y = self._inverse[1, 0] * xi + self._inverse[1, 1] * eta + (self.crpix[1] - 1)
        return x, y

    def pixel_to_world(self, x: ArrayLike, y: ArrayLike) -> tuple[FloatArray, FloatArray]:
        """Return ra (0 <= ra < 360), dec [deg] of 0-based pixels x, y, with the same shape."""
        if self.distortion:
            x, y = self.distortion.inverse(x, y)
        u = np.asarray(x, dtype=float) - (self.crpix[0] - 1)
        v = np.asarray(y, dtype=float) - (self.crpix[1] - 1)
        xi = np.radians(self.cd[0, 0] * u + self.cd[0, 1] * v)
        eta = np.radians(self.cd[1, 0] * u + self.cd[1, 1] * v)
        sin0, cos0 = _sin_cos(self.crval[1])
        meridian = cos0 - eta * sin0
        ra = (self.crval[0] + np.degrees(np.arctan2(xi, meridian))) % 360.0
        dec = np.degrees(np.arctan2(sin0 + eta * cos0, np.hypot(xi, meridian)))
        return np.where(ra == 360.0, 0.0, ra)[()], dec

    def jacobian(self, ra: ArrayLike, dec: ArrayLike, seen: tuple[ArrayLike, ArrayLike] | None = None) -> FloatArray:
        """Return d(x, y)/d(east, north) at ra, dec [deg], (..., 2, 2) in pixel per arcsec of true angle.

        Axis -2 is x, y; axis -1 is the local tangent at the object: +RA (east), then north. At a pole, the given ra
        defines east. seen: the (ra, dec) [deg] at which the distortion is evaluated, by default ra, dec; the 26" of
        aberration change the shear by 3e-4 at the edge of the field.
        """
        east, north, depth, (sin_d, cos_d, sin_a, cos_a) = _frame(self.crval, ra, dec)
        sin0, cos0 = _sin_cos(self.crval[1])
        # Unit vectors towards east and north at the object, in the boresight's (east, north, depth) axes.
        along = (
            (cos_a, sin0 * sin_a, -cos0 * sin_a),
            (-sin_d * sin_a, cos_d * cos0 + sin_d * sin0 * cos_a, cos_d * sin0 - sin_d * cos0 * cos_a),
        )
        columns = [((e - east / depth * d) / depth, (n - north / depth * d) / depth) for e, n, d in along]
        plane = np.moveaxis(np.array(columns), (0, 1), (-1, -2))  # (..., xi | eta, east | north)
        linear = self._inverse @ plane / ARCSEC_PER_RAD
        return self.distortion.jacobian(*self._ideal(*(seen or (ra, dec)))) @ linear if self.distortion else linear

    def header(self) -> dict[str, Any]:
        """Return the FITS WCS keywords of the chip's own active-pixel frame, without the distortion.

        LONPOLE is written because its default changes at dec = +90.
        """
        return {
            "WCSAXES": 2,
            "CTYPE1": "RA---TAN",
            "CTYPE2": "DEC--TAN",
            "CUNIT1": "deg",
            "CUNIT2": "deg",
            "CRVAL1": float(self.crval[0]),
            "CRVAL2": float(self.crval[1]),
            "CRPIX1": float(self.crpix[0]),
            "CRPIX2": float(self.crpix[1]),
            "CD1_1": float(self.cd[0, 0]),
            "CD1_2": float(self.cd[0, 1]),
            "CD2_1": float(self.cd[1, 0]),
            "CD2_2": float(self.cd[1, 1]),
            "LONPOLE": 180.0,
            "RADESYS": "ICRS",
        }

    def footprint(self, window: Window | None = None, margin_px: float = 0) -> tuple[FloatArray, FloatArray]:
        """Return ra (4,), dec (4,) [deg] of the corners of `window` (default: the chip), at pixel edges plus a margin.

        Order: (x0, y0), (x1, y0), (x1, y1), (x0, y1).
        """
        w = window or self.chip.full_window
        x0 = w.x0 - 0.5 - margin_px
        x1 = w.x1 - 0.5 + margin_px
        y0 = w.y0 - 0.5 - margin_px
        y1 = w.y1 - 0.5 + margin_px
        return self.pixel_to_world(np.array([x0, x1, x1, x0]), np.array([y0, y0, y1, y1]))


def mosaic_cd(pa: float, telescope: Telescope) -> FloatArray:
    """Return the CD matrix (2, 2) [deg / pixel] of the unturned mosaic at position angle `pa` [deg]."""
    s = telescope.pixel_scale / 3600.0
    return s * rotation(-math.radians(pa)) @ np.diag([1.0, float(telescope.parity)])


def nominal_crpix(chip: Chip) -> FloatArray:
    """Return the FITS 1-based pixel (2,) of the boresight in the chip's frame, before any turn of the chip."""
    return np.array([chip.detector.nx / 2 - chip.xc, chip.detector.ny / 2 - chip.yc])


def chip_plane(chip: Chip) -> tuple[FloatArray, FloatArray]:
    """Return (rotation (2, 2), origin (2,)): mosaic position [px] = rotation @ (0-based chip pixel - origin).

    This is the nominal position of the chip, turned about its centre; the mosaic's origin is the boresight.
    """
    turn = rotation(math.radians(chip.rotation))
    nominal = nominal_crpix(chip) - 1
    centre = np.array([chip.detector.nx - 1, chip.detector.ny - 1]) / 2
    return turn, centre - turn.T @ (centre - nominal) if chip.rotation else nominal


def gnomonic(crval: tuple[float, float], ra: ArrayLike, dec: ArrayLike) -> tuple[FloatArray, FloatArray]:
    """Return xi, eta [rad], of the shape of ra, dec [deg], on the tangent plane at `crval`; NaN from 90 deg on."""
    east, north, depth, _ = _frame(crval, ra, dec)
    safe = np.where(depth > 0, depth, np.nan)
    return east / safe, north / safe


def _frame(
    crval: tuple[float, float], ra: ArrayLike, dec: ArrayLike
) -> tuple[FloatArray, FloatArray, FloatArray, tuple[FloatArray, FloatArray, FloatArray, FloatArray]]:
    """Return the unit vector of ra, dec along the boresight's east, north and depth, and its sines and cosines."""
    sin_d, cos_d = _sin_cos(dec)
    sin0, cos0 = _sin_cos(crval[1])
    # Wrap into +-180 deg before the sine, which would otherwise lose a digit for ra 359.99 against 0.01.
    step = np.remainder(np.asarray(ra, dtype=float) - crval[0] + 180.0, 360.0) - 180.0
    sin_a, cos_a = _sin_cos(step)
    east = cos_d * sin_a
    north = sin_d * cos0 - cos_d * sin0 * cos_a
    depth = sin_d * sin0 + cos_d * cos0 * cos_a
    return east, north, depth, (sin_d, cos_d, sin_a, cos_a)


def _sin_cos(degrees: ArrayLike) -> tuple[FloatArray, FloatArray]:
    angle = np.radians(degrees)
    return np.sin(angle), np.cos(angle)
