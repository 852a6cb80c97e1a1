"""The WCS of external images, with any frame, order of axes, projection and distortion that astropy supports.

Positions are ICRS, for any frame of the header. Pixels count from 0.
"""

from __future__ import annotations

import math
import re
import warnings
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from csstsim.base.errors import InputError, first_line
from csstsim.base.sphere import frames

if TYPE_CHECKING:
    from astropy.io.fits import HDUList, Header

    from csstsim.base.types import FloatArray, Floats, PathLike

_SOURCE_LINE = re.compile(r"ERROR \d+ in \w+\(\) at line \d+")
_STEP = 0.5  # px or arcsec: half the interval of finite differences
_CLOSE = 0.1  # px: error of an inverted distortion, of 1e-4 px where the iteration converges


class ImageWCS:
    """The mapping between ICRS and the pixels of an image. Raises InputError if the header has no WCS.

    header: astropy Header; file: the HDUList with tables of a distortion, or None; path: named in errors.
    """

    def __init__(self, header: Header, path: PathLike, file: HDUList | None = None) -> None:
        from astropy.wcs import WCS
        from astropy.wcs.utils import wcs_to_celestial_frame

        self.path = path
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                self.wcs = WCS(header, file, naxis=2)
        except Exception as exc:  # of many types
            raise InputError(f"the WCS cannot be used: {_reason(exc)}", file=path) from None
        if not self.wcs.has_celestial:
            raise InputError("no WCS", file=path, key="CTYPE1, CTYPE2", allowed="two axes on the sky")
        try:
            self.frame = wcs_to_celestial_frame(self.wcs)
        except ValueError:
            raise InputError(
                "a frame that astropy does not know",
                file=path,
                key="CTYPE1, RADESYS",
                value=", ".join([*self.wcs.wcs.ctype, self.wcs.wcs.radesys]),
                allowed="equatorial, galactic, ecliptic",
            ) from None

    @cached_property
    def _is_icrs(self) -> bool:
        return self.frame.name == "icrs"

    @cached_property
    def _pixel_side(self) -> float:
        """Mean side of a pixel at the reference [rad], without the distortion."""
        return math.radians(math.sqrt(abs(np.linalg.det(self.wcs.pixel_scale_matrix))))

    def pixels(self, ra: FloatArray, dec: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return x, y (n,) [px] of ICRS positions [deg]; NaN where the projection is undefined.

        NaN also where a distortion cannot be inverted. Far from the image, astropy's iteration ends anywhere.
        """
        from astropy.coordinates import SkyCoord

        ra = np.asarray(ra, float)
        dec = np.asarray(dec, float)
        if not self._is_icrs:
            position = SkyCoord(ra, dec, unit="deg").transform_to(self.frame).spherical
            ra = position.lon.deg
            dec = position.lat.deg
        world = [ra, dec] if self.wcs.wcs.lng == 0 else [dec, ra]
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            try:
                x, y = self.wcs.all_world2pix(*world, 0, quiet=True)
                back = self.wcs.all_pix2world(x, y, 0)
            except Exception:  # of many types
                return np.full(ra.shape, np.nan), np.full(ra.shape, np.nan)
        lon, lat = back if self.wcs.wcs.lng == 0 else back[::-1]
        error = np.linalg.norm(_vectors((lon, lat)) - _vectors((ra, dec)), axis=-1)
        inverted = error < _CLOSE * self._pixel_side
        return np.where(inverted, x, np.nan), np.where(inverted, y, np.nan)

    def sky(self, x: Floats, y: Floats) -> tuple[FloatArray, FloatArray]:
        """Return ICRS ra, dec (n,) [deg] of pixels; NaN where the projection is undefined."""
        from astropy.coordinates import SkyCoord

        world = self.wcs.all_pix2world(np.asarray(x, float), np.asarray(y, float), 0)
        lon, lat = world if self.wcs.wcs.lng == 0 else world[::-1]
        if self._is_icrs:
            return lon, lat
        position = SkyCoord(lon, lat, unit="deg", frame=self.frame).icrs
        return position.ra.deg, position.dec.deg

    def jacobian(
        self, ra: FloatArray, dec: FloatArray, seen: tuple[FloatArray, FloatArray] | None = None
    ) -> FloatArray:
        """Return (n, 2, 2) d(pixel) / d(arcsec east, north) at ICRS positions [deg], also at the poles.

        `seen`, of WCS classes with apparent positions, is not used.
        """
        centre, *axes = frames(np.radians(ra), np.radians(dec))
        step = np.radians(_STEP / 3600)
        ends = [[self.pixels(*_angles(centre + k * step * axis)) for k in (1, -1)] for axis in axes]
        return np.moveaxis(np.array([np.subtract(plus, minus) for plus, minus in ends]), (0, 1, 2), (2, 1, 0)) / (
            2 * _STEP
        )

    def per_pixel(self, x: float, y: float) -> FloatArray:
        """Return (2, 2): arcsec east, north of a step of one column and of one row, at a pixel."""
        _, east, north = frames(*(np.radians(v) for v in self.sky(x, y)))
        ends = [[_vectors(self.sky(x + k * a, y + k * b)) for k in (_STEP, -_STEP)] for a, b in ((1, 0), (0, 1))]
        steps = [np.subtract(*pair) for pair in ends]
        radians = np.array([[axis @ step for step in steps] for axis in (east, north)]) / (2 * _STEP)
        return np.degrees(radians) * 3600


def _angles(vectors: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return ra, dec (n,) [deg] of vectors (n, 3)."""
    x, y, z = np.moveaxis(vectors, -1, 0)
    return np.degrees(np.arctan2(y, x)) % 360.0, np.degrees(np.arctan2(z, np.hypot(x, y)))


def _vectors(angles: tuple[FloatArray, FloatArray]) -> FloatArray:
    return frames(*(np.radians(v) for v in angles))[0]


def _reason(exc: Exception) -> str:
    """Return what an exception of astropy.wcs says, without the lines on the source code of wcslib."""
    lines = [line.strip() for line in str(exc).splitlines()]
    reasons = [line for line in lines if line and not _SOURCE_LINE.match(line)]
    return " ".join(reasons) or first_line(exc)
