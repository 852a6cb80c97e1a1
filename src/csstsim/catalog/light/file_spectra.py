"""Spectra from files, for rows of a table: the shape is the file's, the flux is that of the row's one magnitude.

A file is .csv, .ecsv or .fits with WAVELENGTH [angstrom, rising] and FLUX [photon / s / m2 / angstrom, or a unit that
converts, also by its name in CALSPEC], as observed. Between samples it is linear, beyond its ends zero. On the paper's
grid it keeps its integral.
"""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from csstsim.base.errors import InputError, first_line
from csstsim.base.files.fits_headers import check_headers
from csstsim.base.files.lru_by_file_state import lru_by_file_state
from csstsim.base.resampling import on_grid
from csstsim.catalog.light.photometry import ab_mag, bin_means
from csstsim.catalog.light.spectrum_tables import read_columns
from csstsim.instrument.filter import GRID, Filter

if TYPE_CHECKING:
    from collections.abc import Sequence

    from csstsim.base.types import AnyArray, FloatArray, IntArray, PathLike

FORMATS = {".csv": "ascii.csv", ".ecsv": "ascii.ecsv", ".fits": "fits"}
_CACHED = 64  # files
_LARGEST = 1e100  # photon / s / m2 / angstrom: sums stay finite


class Spectrum(NamedTuple):
    """A file: (18001,) photon / s / m2 / angstrom on the paper's grid, and the ends of its wavelengths [angstrom]."""

    shape: FloatArray
    first: float
    last: float


def read_spectrum(path: PathLike) -> FloatArray:
    """Return (18001,) photon / s / m2 / angstrom of a file on the paper's grid. Raises InputError."""
    return load_spectrum(path).shape


@lru_by_file_state(_CACHED)
def load_spectrum(path: PathLike) -> Spectrum:
    """Return the Spectrum of a file. Raises InputError."""
    from astropy.table import Table
    from astropy.units import UnitsWarning

    path = Path(path)
    if path.suffix.lower() not in FORMATS:
        raise InputError("unknown kind of spectrum", file=path, key="spectrum_file", allowed=", ".join(FORMATS))
    if not path.is_file():
        raise InputError("no such file", file=path, key="spectrum_file")
    form = FORMATS[path.suffix.lower()]
    if form == "fits":
        check_headers(path)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UnitsWarning)  # of CALSPEC's units, which spectrum_tables reads
            table = Table.read(path, format=form)
    except Exception as exc:  # astropy's readers raise exceptions of many types
        raise InputError(f"not a table that can be read: {first_line(exc)}", file=path) from None
    if missing := [name for name in ("WAVELENGTH", "FLUX") if name not in table.colnames]:
        found = ", ".join(table.colnames) or "none"
        message = f"has no column {missing[0]}; its columns: {found}"
        raise InputError(message, file=path, allowed="WAVELENGTH and FLUX, in capital letters")
    wave, flux = read_columns(table, "FLUX", str(path))
    if not np.isfinite(flux).all() or (flux < 0).any():
        raise InputError("contains values that are negative or not finite", file=path, key="FLUX")
    if flux.max() > _LARGEST:
        raise InputError("is too large", file=path, key="FLUX", value=float(flux.max()), allowed=f"up to {_LARGEST:g}")
    shape = on_grid(GRID, wave, flux)
    if not shape.any():
        allowed = f"flux above 0 within {GRID[0]:g}-{GRID[-1]:g} angstrom"
        raise InputError("has no flux", file=path, key="FLUX", allowed=allowed)
    return Spectrum(shape, float(wave[0]), float(wave[-1]))


class FileSpectra:
    """The spectra of n rows: names (n,) of files, and AB magnitudes (n, bands), of which one is known, in `filters`."""

    def __init__(self, names: Sequence[str] | AnyArray, mags: FloatArray, filters: Sequence[Filter]) -> None:
        files, self._file = np.unique(np.asarray(names, str), return_inverse=True)
        self._shapes = np.array([read_spectrum(name) for name in files]).reshape(-1, len(GRID))
        band = np.argmax(np.isfinite(mags), axis=1)
        file_mags = np.full((len(files), len(filters)), np.nan)
        for f, b in set(zip(self._file.tolist(), band.tolist(), strict=True)):
            file_mags[f, b] = ab_mag(self._shapes[f], GRID, filters[b].at(GRID))
        rows = np.arange(len(band))
        with np.errstate(over="ignore", invalid="ignore"):  # zero in its band: NaN, which is flagged
            self._scale = 10 ** (0.4 * (file_mags[self._file, band] - np.asarray(mags, float)[rows, band]))

    def spectra(self, rows: list[int] | IntArray) -> FloatArray:
        """Return (len(rows), 18001) photon / s / m2 / angstrom."""
        return self._shapes[self._file[rows]] * self._scale[rows, None]

    def rates(self, rows: IntArray, weights: FloatArray) -> FloatArray:
        """Return (len(rows), len(weights)): sums of the spectra times weights (m, 18001)."""
        return np.einsum("fw,mw->fm", self._shapes, weights)[self._file[rows]] * self._scale[rows, None]

    def bins(self, rows: IntArray, edges: FloatArray) -> FloatArray:
        """Return (len(rows), len(edges) - 1): means over bins of `edges`, samples of the grid."""
        at = np.searchsorted(GRID, edges)
        means = bin_means(self._shapes[:, at[0] : at[-1] + 1], at - at[0])
        return means[self._file[rows]] * self._scale[rows, None]
