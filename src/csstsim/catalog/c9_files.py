"""The HDF5 files of the Cycle-9 input catalogues, read pixel by pixel.

Stars: /star_catalog/<pixel>/ with RA, DEC [deg], app_sdss_g [AB], teff [log10 K], grav [dex], z_met, AV [mag],
mass [solar] and, in some files, pmra, pmdec [mas/yr], RV [km/s], parallax [mas]; in any number of files.
Galaxies: galaxies_C6_bundle{bundle:06d}.h5 with /galaxies/<pixel>/ and ra, dec [deg], redshift, mag_csst_* [AB],
size [arcsec], ellipticity_true (n, 2), shear (n, 2), kappa, bulgemass, diskmass [solar], type, veldisp [km/s],
qsoindex (-1: none), coeff (n, 20).
A pixel is a HEALPix RING number at NSIDE 128, a bundle one at NSIDE 16. A pixel that is not in a file is empty.

The layout is that of the public converters to this format, github DUT-astro/make_c9_star_cat (and its earlier copy
Cirrus012/make_c9_star_cat), commit accee8d:

    csv_to_c9h5.py             groups, names and units of stars, float64, appended to; z_met as [Fe/H]
    gaia_fits_to_c9h5_v2.py    the official files hold log10 K, and z_met as a mass fraction; AV, DM and RV are 0
    hst-hugs.py                stars appended to such a file
    csv_to_c9_galaxies_h5.py   names of bundles and galaxies' columns, with their types; gzip, shuffled, with checksums
    make_galaxy_*_catalog*.py  read official bundles, which may have more columns; mag_csst_wf, _wh and _wi are older
                               names of GU, GV, GI; ellipticity turns as spin 2; detA is 1 without shear and kappa

DM, detA and the magnitudes of gratings are not read: they follow from other columns.
"""

from __future__ import annotations

import os
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from csstsim.base.errors import InputError
from csstsim.base.files.hdf5_file import group, numbers

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    import h5py
    from numpy.typing import ArrayLike

    from csstsim.base.types import AnyArray, FloatArray, IntArray, PathLike

STAR_COLUMNS = ("RA", "DEC", "app_sdss_g", "teff", "grav", "z_met", "AV", "mass")
STAR_OPTIONAL = ("pmra", "pmdec", "RV", "parallax")
BANDS = ("nuv", "u", "g", "r", "i", "z", "y")  # of CSST, for which the files are made
GALAXY_COLUMNS = (
    *("ra", "dec", "redshift", "size", "kappa", "bulgemass", "diskmass", "type", "veldisp", "qsoindex"),
    *(f"mag_csst_{band}" for band in BANDS),
)
GALAXY_WIDE = {"ellipticity_true": 2, "shear": 2, "coeff": 20}


def pixels(bricks: ArrayLike) -> tuple[IntArray, IntArray]:
    """Return the sorted (nested, ring) NSIDE-128 pixels that contain NSIDE-256 nested `bricks`, each an array."""
    import hpgeom

    nested = np.unique(np.asarray(bricks, dtype=np.int64) >> 2)
    return nested, hpgeom.nest_to_ring(128, nested)


def read_stars(files: Iterable[PathLike], bricks: ArrayLike) -> Iterator[tuple[int, dict[str, AnyArray]]]:
    """Yield (pixel, {name: values}) of every pixel under `bricks`, once for each file that has it."""
    for file in files:
        with _open(file) as h5:
            root = group(h5, "star_catalog", file)
            for pixel in pixels(bricks)[1]:
                if str(pixel) in root:
                    yield (
                        int(pixel),
                        _columns(group(root, str(pixel), file), dict.fromkeys(STAR_COLUMNS), STAR_OPTIONAL, file),
                    )


def read_galaxies(folder: PathLike, bricks: ArrayLike, partial: bool) -> Iterator[tuple[int, dict[str, AnyArray]]]:
    """Yield (pixel, {name: values}) as `read_stars`. If `partial`, a missing bundle is empty sky."""
    import hpgeom

    wanted = dict.fromkeys(GALAXY_COLUMNS) | GALAXY_WIDE
    for nested, pixel in zip(*pixels(bricks), strict=True):
        file = Path(folder) / f"galaxies_C6_bundle{hpgeom.nest_to_ring(16, nested >> 6):06d}.h5"
        if partial and not file.exists():
            continue
        with _open(file) as h5:
            root = group(h5, "galaxies", file)
            if str(pixel) in root:
                yield int(pixel), _columns(group(root, str(pixel), file), wanted, (), file)


def read_array(file: PathLike, name: str, ndim: int) -> FloatArray:
    """Return dataset `name` of an HDF5 file as float64. Raises InputError if it is not an array of `ndim` axes."""
    with _open(file) as h5:
        values = numbers(h5, name, file)
    if values.ndim != ndim or not np.isfinite(values).all():
        raise InputError(f"must be finite and have {ndim} axes", file=file, key=name, value=values.shape)
    return values.astype(float)


@contextmanager
def _open(file: PathLike) -> Iterator[h5py.File]:
    import h5py

    try:
        with h5py.File(file, "r") as h5:
            yield h5
    except (OSError, RuntimeError, KeyError) as exc:
        errno = getattr(exc, "errno", None)
        reason = os.strerror(errno) if errno else "truncated, damaged or not HDF5"
        raise InputError(f"cannot read the catalogue: {reason}", file=file) from exc


def _columns(
    pixel: h5py.Group, wanted: dict[str, int | None], optional: Iterable[str], file: PathLike
) -> dict[str, AnyArray]:
    """Return {name: values} of a pixel's group; wanted: {name: number of columns, None for one axis}."""
    wanted = wanted | {name: None for name in optional if name in pixel}
    found = {name: np.atleast_1d(numbers(pixel, name, file)) for name in wanted}
    count = len(next(iter(found.values())))
    for name, width in wanted.items():
        shape = (count,) if width is None else (count, width)
        if found[name].shape != shape:
            key = f"{pixel.name.strip('/')}/{name}"
            raise InputError("wrong shape", file=file, key=key, value=found[name].shape, allowed=shape)
    return found
