"""Images of galaxies given by a user: files read and checked, and the scale and orientation of their pixels.

A file is FITS (the first image in it, or `name.fits[EXTENSION]`) or HDF5 (`name.h5[DATASET]`). A pixel contains the
flux that falls on it, in any unit: an object's flux comes from its magnitudes. The middle of the image is the object's
position. Without a WCS in its header, north is up and east left, turned by `image_pa` from north through east.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from csstsim.base.errors import InputError, first_line
from csstsim.base.files.fits_headers import check_headers
from csstsim.base.files.hdf5_file import numbers
from csstsim.base.files.lru_by_file_state import lru_by_file_state
from csstsim.base.image_wcs import ImageWCS

if TYPE_CHECKING:
    from astropy.io.fits import CompImageHDU, HDUList, ImageHDU, PrimaryHDU

    from csstsim.base.types import AnyArray, FloatArray

LARGEST = 1 << 24  # pixels
NEGATIVE = 0.05  # maximum fraction of the flux in negative pixels, which are set to 0
_KEPT = 256
_PLACE = re.compile(r"(.*\.(?:fits|fit|fits\.gz|h5|hdf5))(?:\[([^\[\]]+)\])?", re.IGNORECASE)
_HALF = 0.5  # of the flux, for the half-light radius


@dataclass(frozen=True, eq=False)
class GalaxyImage:
    """Pixels (rows, columns) float64 with sum 1, none negative, and their scale and orientation."""

    pixels: FloatArray
    sky: FloatArray | None  # (2, 2) arcsec: east, north of a step of one column, one row; None: the file has no WCS
    negative: float  # fraction of the flux that was in negative pixels

    @property
    def radius(self) -> float:
        """The distance of the corners from the middle [pixel]."""
        return 0.5 * float(np.hypot(*self.pixels.shape))

    @property
    def half_light(self) -> float:
        """The radius about the middle that contains half of the flux [pixel]."""
        rows, columns = ((np.arange(n) - (n - 1) / 2) for n in self.pixels.shape)
        r = np.hypot(rows[:, None], columns).ravel()
        order = np.argsort(r, kind="stable")
        flux = np.cumsum(self.pixels.ravel()[order])
        return float(max(r[order][np.searchsorted(flux, _HALF * flux[-1])], 0.5))


def sky_of(image: GalaxyImage, scale: float, angle: float) -> FloatArray:
    """Return (2, 2) arcsec, as `image.sky`, for a scale [arcsec per pixel] and an angle [deg]; scale 0: the file's."""
    if not scale > 0:
        turn = np.radians(angle)
        return np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]]) @ image.sky
    sin = np.sin(np.radians(angle))
    cos = np.cos(np.radians(angle))
    return scale * np.array([[-cos, sin], [sin, cos]])


@lru_by_file_state(_KEPT)
def read_image(name: str) -> GalaxyImage:
    """Return the GalaxyImage of a file. Raises InputError for one that is missing, damaged or not an image."""
    found = _PLACE.fullmatch(str(name))
    if not found:
        allowed = "a file .fits or .h5, with [extension] or [dataset] if it holds more than one image"
        raise InputError("not an image file", key="image_file", value=str(name), allowed=allowed)
    path = Path(found[1])
    part = found[2]
    if not path.is_file():
        raise InputError("no such file", file=path, key="image_file")
    fits = ".fit" in path.name.lower()
    values, sky = (_read_fits if fits else _read_hdf5)(path, part)
    return _checked(np.asarray(values), sky, name)


def _read_fits(path: Path, part: str | None) -> tuple[AnyArray, FloatArray | None]:
    from astropy.io import fits

    check_headers(path)
    try:
        with fits.open(path, memmap=False) as file:
            where = part if part is None or not part.isdigit() else int(part)
            hdus = [h for h in file if h.is_image and h.header["NAXIS"] > 0] if part is None else [file[where]]
            if not hdus or not hdus[0].is_image:
                raise InputError("holds no image", file=path, key="image_file", value=part or "")
            return hdus[0].data, _sky(hdus[0], file, path)
    except InputError:
        raise
    except Exception as exc:  # astropy raises exceptions of many types
        raise InputError(f"not an image that can be read: {first_line(exc)}", file=path, value=part) from None


def _sky(hdu: PrimaryHDU | ImageHDU | CompImageHDU, file: HDUList, path: Path) -> FloatArray | None:
    """Return (2, 2) arcsec east, north of a step in the middle of an image, by its celestial WCS, or None."""
    from astropy.wcs import WCS

    if "CTYPE1" not in hdu.header or not WCS(hdu.header, file, naxis=2).has_celestial:
        return None
    ny, nx = hdu.shape[-2:]
    sky = ImageWCS(hdu.header, path, file).per_pixel((nx - 1) / 2, (ny - 1) / 2)
    if not np.isfinite(sky).all():
        raise InputError("the WCS has no sky in the middle of the image", file=path, key="image_file")
    return sky


def _read_hdf5(path: Path, part: str | None) -> tuple[AnyArray, None]:
    import h5py

    try:
        with h5py.File(path, "r") as file:
            names = [part] if part else [name for name in file if isinstance(file.get(name), h5py.Dataset)]
            if len(names) != 1 or not isinstance(file.get(names[0]), h5py.Dataset):
                value = part or ", ".join(names)
                raise InputError("name the dataset: name.h5[DATASET]", file=path, key="image_file", value=value)
            return numbers(file, names[0], path), None
    except (OSError, ValueError, RuntimeError, KeyError, TypeError) as exc:
        raise InputError(f"not an image that can be read: {first_line(exc)}", file=path, value=part) from None


def _checked(values: AnyArray, sky: FloatArray | None, name: str) -> GalaxyImage:
    """Return the GalaxyImage of pixel values."""
    if values.ndim != 2 or values.dtype.kind not in "iuf" or not 0 < values.size <= LARGEST:
        allowed = f"two axes of numbers, up to {LARGEST} pixels"
        raise InputError(
            "not an image", file=name, key="image_file", value=f"{values.dtype} {values.shape}", allowed=allowed
        )
    pixels = values.astype(np.float64)
    bad = np.argwhere(~np.isfinite(pixels))
    if len(bad):
        where = f"row {bad[0, 0]}, column {bad[0, 1]} (from 0)"
        raise InputError(f"{len(bad)} pixels are not numbers", file=name, key="image_file", value=where)
    flux = np.maximum(pixels, 0).sum()
    below = -np.minimum(pixels, 0).sum()
    if not flux > 0 or not np.isfinite(flux):
        raise InputError("has no flux", file=name, key="image_file")
    if below > NEGATIVE * flux:
        value = f"{below / flux:.1%} of the flux"
        allowed = f"at most {NEGATIVE:.0%}: subtract the background, and mask other objects"
        raise InputError("too much flux in negative pixels", file=name, key="image_file", value=value, allowed=allowed)
    return GalaxyImage(np.maximum(pixels, 0) / flux, sky, float(below / flux))
