"""E(B-V) of the whole column of Milky Way dust, read from a full-sky HEALPix map (paper, appendix C).

    E(B-V) = EBV where EBV < 0.3 mag, else 1.49e4 TAU353        (a map of Planck's thermal dust)

A map with a single column is used as it is. The shipped one, of SFD with Planck's structure below 55 arcmin
(builders/build_dust_map.py), is brought to the scale of Schlafly & Finkbeiner (2011, ApJ 737, 103), who found 0.86 of
SFD's reddening in the colours of stars. Between pixel centres, E(B-V) is the mean of the four nearest pixels with
bilinear weights. The limit of 0.3 mag applies to each pixel, so E(B-V) is continuous on the sky. Only pixels that are
needed are read (Planck's map has 50 million). Left out: structure smaller than a pixel, dust beyond the Milky Way.
"""

import hashlib
import math
from collections.abc import Mapping
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from csstsim.base.errors import InputError
from csstsim.base.files.damage import reading
from csstsim.base.files.fits_headers import check_headers
from csstsim.base.healpix import colatitude
from csstsim.base.shipped import SHIPPED
from csstsim.base.types import AnyArray, FloatArray, Floats, IntArray, PathLike
from csstsim.universe.dust.extinction import LAWS, star_ebv

SFD = "sfd"
_LAW = "odonnell94"  # if dust.yaml names none
_KEYS = ("map", "sfd_scale", "columns", "coordsys", "optical_depth", "r_v", "height", "reach", "law")  # of dust.yaml
_FILE = "dust_map.fits"  # of a universe folder
_ALLOWED = "sfd, or the path of a FITS file"
_EBV_MAX = 1e4  # mag; the galactic centre has about 100
_GALACTIC = {"GALACTIC": True, "G": True, "EQUATORIAL": False, "CELESTIAL": False, "C": False}
# Galactic from equatorial (J2000) axes: that of healpy's Rotator, 0.01" from erfa's icrs2g
_TO_GALACTIC = (
    (-0.05487553939571453, -0.8734371047274332, -0.48383499177032235),
    (0.49410945362336356, -0.4448295942988166, 0.74698224870205),
    (-0.8676661356858695, -0.19807638961094987, 0.45598379451756915),
)
_UNSEEN_BELOW = -1e30  # above UNSEEN (-1.6375e30), HEALPix's mark of a pixel without a value


class _Map(NamedTuple):
    """A map: its columns (memory-mapped), its NSIDE, whether pixels are nested and coordinates galactic."""

    columns: list[AnyArray]
    nside: int
    nested: bool
    galactic: bool


class DustMap:
    """A map of E(B-V) (see the module); numbers: those of config/universe/dust.yaml; folder: that of the file.

    A path of the map is relative to the folder. `sfd` is the folder's dust_map.fits, or else the shipped one.
    Raises InputError for a file that is missing or not a full-sky HEALPix table of E(B-V).
    """

    def __init__(self, numbers: Mapping[str, Any], folder: PathLike = SHIPPED / "universe") -> None:
        self._numbers = numbers
        name = numbers["map"]
        columns = numbers["columns"]
        source = Path(folder) / "dust.yaml"
        for key in numbers:
            if key not in _KEYS:  # such as a misspelt `law`
                raise InputError("unknown", file=source, key=key, allowed=", ".join(_KEYS))
        if not isinstance(name, str) or not name.strip():
            raise InputError("not a dust map", file=source, key="map", value=name, allowed=_ALLOWED)
        if not (isinstance(columns, list) and 0 < len(columns) < 3 and all(isinstance(one, str) for one in columns)):
            allowed = "a list of one or two names"
            raise InputError("not columns of a dust map", file=source, key="columns", value=columns, allowed=allowed)
        law = numbers.get("law", _LAW)  # optional: without the key, the shipped file keeps its digest
        if not isinstance(law, str) or law not in LAWS:
            raise InputError("not an extinction law", file=source, key="law", value=law, allowed=", ".join(LAWS))
        self._law = LAWS[law]
        self.path = Path(folder) / (_FILE if name == SFD else name)
        if name == SFD and not self.path.exists():
            self.path = SHIPPED / "universe" / _FILE
        if not self.path.is_file():
            raise InputError(f"no such file: {self.path}", file=source, key="map", value=name, allowed=_ALLOWED)

    @cached_property
    def _map(self) -> _Map:
        """The map, read on first use: most stages need only the digest."""
        columns, header = _open(self.path, self._numbers["columns"])
        galactic_frame = _is_galactic(header["COORDSYS"] or self._numbers["coordsys"], self.path)
        return _Map(columns, *_pixelisation(columns[0].size, header, self.path), galactic_frame)

    @property
    def nside(self) -> int:
        """HEALPix NSIDE of the map."""
        return self._map.nside

    @cached_property
    def digest(self) -> str:
        """16 hex digits of the map file's BLAKE2b (twice as fast as SHA-256: a Planck map is 2 GB)."""
        with open(self.path, "rb") as file:
            return hashlib.file_digest(file, "blake2b").hexdigest()[:16]

    def ebv(self, ra: Floats, dec: Floats) -> FloatArray:
        """Return E(B-V) of the whole column of dust.

        Parameters
        ----------
        ra, dec : float or ndarray
            Directions [deg, ICRS], which broadcast.

        Returns
        -------
        ndarray, shape of `ra` and `dec`
            Mag, 0 or more. A pixel without a value (not finite, or UNSEEN) is left out of the mean.

        Raises
        ------
        InputError
            For a direction that is not finite, if none of the four pixels has a value, or if the map has more than 1e4
            mag.
        """
        import hpgeom

        ra, dec = np.broadcast_arrays(*(np.atleast_1d(np.asarray(angle, dtype=float)) for angle in (ra, dec)))
        invalid = ~(np.isfinite(ra) & (np.abs(dec) <= 90))
        if invalid.any():
            raise InputError("not a direction", key="ra, dec", value=(float(ra[invalid][0]), float(dec[invalid][0])))
        lon, lat = galactic(ra, dec) if self._map.galactic else (ra, dec)
        angles = colatitude(lon, lat)
        pixel, fraction = hpgeom.get_interpolation_weights(
            self._map.nside, *angles, lonlat=False, nest=self._map.nested
        )
        neighbours = pixel.T  # (4, n)
        weight = fraction.T
        pixels, inverse = np.unique(neighbours, return_inverse=True)
        value = self._pixels(pixels)
        if (value > _EBV_MAX).any():
            pixel_index = np.argmax(value > _EBV_MAX)
            allowed = f"to {_EBV_MAX:g}"
            raise InputError(
                "no E(B-V)",
                file=self.path,
                key=f"pixel {pixels[pixel_index]}",
                value=float(value[pixel_index]),
                allowed=allowed,
            )
        value = value[inverse.reshape(neighbours.shape)]
        weight = np.where(np.isnan(value), 0.0, weight)
        total = weight.sum(axis=0)
        empty = ~(total > 0)
        if empty.any():
            position = f"ra {ra[empty][0]:.4f}, dec {dec[empty][0]:.4f}"
            raise InputError("the dust map has no value here", file=self.path, key=position)
        scale = self._numbers["sfd_scale"] if self._numbers["map"] == SFD else 1.0
        return np.maximum(scale * (weight * np.nan_to_num(value)).sum(axis=0) / total, 0.0)

    def star_ebv(self, ra: Floats, dec: Floats, distance: Floats) -> FloatArray:
        """Return E(B-V) in front of stars, as extinction.star_ebv.

        Parameters
        ----------
        ra, dec : float or ndarray
            Directions [deg, ICRS].
        distance : float or ndarray
            Distances [pc], which broadcast with the directions.

        Returns
        -------
        ndarray, shape of the arguments
            E(B-V) [mag].
        """
        latitude = galactic(ra, dec)[1]
        return star_ebv(self.ebv(ra, dec), distance, latitude, self._numbers["height"], self._numbers["reach"])

    def curve(self, wavelength: Floats) -> FloatArray:
        """Return A(lambda)/A(V) at `wavelength` [angstrom] for this configuration's law and R_V."""
        return self._law(wavelength, self._numbers["r_v"])

    def _pixels(self, pixels: IntArray) -> FloatArray:
        """Return E(B-V) of pixels, NaN where the map has no value."""
        columns = self._map.columns
        first = _values_of(columns[0], pixels)
        if len(columns) == 1:
            return first
        switch = self._numbers["optical_depth"]
        dense = ~(first < switch["limit"])  # NaN (too dense to measure) also takes the optical depth
        first[dense] = switch["per_tau"] * _values_of(columns[1], pixels[dense])
        return first


def galactic(ra: Floats, dec: Floats) -> tuple[FloatArray, FloatArray]:
    """Return galactic longitude and latitude [deg] of ICRS `ra`, `dec` [deg]."""
    ra, dec = np.broadcast_arrays(ra, dec)
    theta, phi = colatitude(ra.ravel(), dec.ravel())
    x, y, z = np.tensordot(
        _TO_GALACTIC, [np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], (1, 0)
    )
    lon = np.degrees(np.arctan2(y, x))
    lat = 90.0 - np.degrees(np.arccos(z / np.sqrt(x**2 + y**2 + z**2)))
    return lon.reshape(ra.shape), lat.reshape(ra.shape)


def _values_of(column: AnyArray, pixels: IntArray) -> FloatArray:
    """Return the values of `pixels`; a row of a map's table has one pixel or many."""
    value = column[np.unravel_index(pixels, column.shape)].astype(float)
    return np.where(np.isfinite(value) & (value > _UNSEEN_BELOW), value, np.nan)


def _open(path: Path, requested: list[str]) -> tuple[list[AnyArray], dict[str, str]]:
    """Return the `requested` columns (or the only one), memory-mapped, and header keywords that describe the map."""
    from astropy.io import fits

    check_headers(path)
    with reading(path, "a dust map", strict=False), fits.open(path, memmap=True) as hdus:
        table = next((hdu for hdu in hdus if isinstance(hdu, fits.BinTableHDU)), None)
        if table is None:
            raise InputError("the dust map has no table", file=path)
        names = {name.upper(): name for name in table.columns.names}
        missing = [name for name in requested if name.upper() not in names]
        if len(names) == 1:
            requested = list(names)
        elif missing:
            raise InputError("the dust map lacks a column", file=path, key=missing[0], allowed=", ".join(names))
        columns = [table.data.field(names[name.upper()]) for name in requested]
        for name, column in zip(requested, columns, strict=True):
            if column.dtype.kind not in "fiu":
                raise InputError("not a column of numbers", file=path, key=name, value=str(column.dtype))
        about = {key: str(table.header.get(key, "")) for key in ("COORDSYS", "ORDERING", "INDXSCHM", "NSIDE")}
        return columns, about


def _pixelisation(size: int, header: Mapping[str, str], path: Path) -> tuple[int, bool]:
    """Return (nside, nested) of a full-sky map of `size` pixels. Raises InputError."""
    ordering = header["ORDERING"].strip().upper()
    if ordering not in ("RING", "NESTED", "NEST"):
        raise InputError("unknown order of pixels", file=path, key="ORDERING", value=ordering, allowed="RING, NESTED")
    nside = math.isqrt(size // 12)
    full_sky = size == 12 * nside**2 > 0 and (ordering == "RING" or nside & (nside - 1) == 0)
    if not full_sky or (header["INDXSCHM"].strip() or "IMPLICIT") != "IMPLICIT":
        raise InputError("not a full-sky HEALPix map", file=path, key="pixels", value=size)
    if header["NSIDE"] not in ("", str(nside)):
        raise InputError("not that of its pixels", file=path, key="NSIDE", value=header["NSIDE"], allowed=nside)
    return nside, ordering != "RING"


def _is_galactic(frame: object, path: Path) -> bool:
    try:
        return _GALACTIC[str(frame).strip().upper()]
    except KeyError:
        allowed = ", ".join(_GALACTIC)
        raise InputError("unknown coordinates", file=path, key="COORDSYS", value=frame, allowed=allowed) from None
