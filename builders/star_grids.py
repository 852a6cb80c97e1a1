"""Real grids of model atmospheres: ATLAS9 (Castelli & Kurucz 2004) and BT-Settl, read and used in place of the model.

    GridSeds(read_ck04("ck04models"), extinction_curve)

has the interface of `star_sed.StarSeds`. Fluxes are erg / s / cm2 / angstrom at the surface of the star, averaged over
the 5 A about each knot (the exact mean of the piecewise linear curve through the file's samples), so a grid of any
resolution keeps its photometry. A node missing in the grid gets the spectrum of the nearest existing one: it differs in
log g rather than in [Fe/H], and in [Fe/H] rather than in Teff.
"""

import bz2
import gzip
import lzma
import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from astropy.io import fits

from csstsim.base.errors import InputError
from csstsim.base.files.damage import reading
from csstsim.base.files.fits_headers import check_headers
from csstsim.base.units import C_A_S, H_J_S
from csstsim.universe.stars.star_sed import KNOTS, Seds, linear

_J_M2_PER_ERG_CM2 = 1e-3
_FLOOR = 1e-30  # erg / s / cm2 / angstrom: a flux of zero has no logarithm
_BTSETTL_DF = -8.0  # per cm to per angstrom (phoenix.ens-lyon.fr/Grids/FORMAT): flux = 10^(column 2 + DF)
_BTSETTL_NAME = re.compile(r"lte(?P<teff>\d+(\.\d+)?)(?P<logg>[+-]\d+(\.\d+)?)(?P<feh>[+-]\d+(\.\d+)?)")
_OPEN = {".gz": gzip.open, ".bz2": bz2.open, ".xz": lzma.open}


@dataclass(frozen=True, eq=False)
class Grid:
    """`flux` (n, m) [erg / s / cm2 / angstrom at the surface] of n atmospheres at `wavelength` (m,) [angstrom]."""

    wavelength: np.ndarray
    teff: np.ndarray
    logg: np.ndarray
    feh: np.ndarray
    flux: np.ndarray


def read_ck04(folder):
    """Return the Grid below `folder`, in the form of STScI's ck04models (ckp00/ckp00_5750.fits, columns g00 ... g50).

    The models are those of the files found, whatever catalog.fits lists; a column of zeros is a missing model. Raises
    InputError for a folder without such files or a file that cannot be read.
    """
    rows = [row for path in _found(folder, "ck[pm]??/*.fits") for row in _ck04_file(path)]
    return _grid(folder, rows)


def _ck04_file(path):
    check_headers(path)
    with reading(path, "an ATLAS9 spectrum"), fits.open(path, memmap=False) as file:
        teff, feh, table = float(file[0].header["TEFF"]), float(file[0].header["LOG_Z"]), file[1].data
        wave = np.float64(table["WAVELENGTH"])
        columns = {name: np.float64(table[name]) for name in table.names if re.fullmatch(r"g\d\d", name)}
    for name, flux in columns.items():
        if flux.any():
            yield teff, int(name[1:]) / 10, feh, resample(path, wave, flux)


def read_btsettl(folder):
    """Return the Grid of the BT-Settl text files below `folder` (lte058.0-4.5-0.0a+0.0.BT-Settl...; gz, bz2, xz too).

    Two columns are angstrom and flux; three or more, as on the authors' site, angstrom, log10 flux per cm and log10
    black body, in Fortran numbers (1.5D+04, columns that may touch), in any order of wavelength. Raises InputError.
    """
    rows = [_btsettl_file(path) for path in _found(folder, "lte*")]
    return _grid(folder, rows)


def _btsettl_file(path):
    name = _BTSETTL_NAME.match(path.name)
    if not name:
        raise InputError("the name does not give Teff, log g and [Fe/H]", file=path, allowed="lte058.0-4.5-0.0a+0.0...")
    with reading(path, "a BT-Settl spectrum"), _OPEN.get(path.suffix, open)(path, "rt") as file:
        # A minus sign after a digit starts a column; that of an exponent follows its letter
        lines = (re.sub(r"(?<=[\d.])-", " -", line.upper().replace("D", "E")).split() for line in file)
        lines = [line for line in lines if line and not line[0].startswith("#")]
        logarithmic = len(lines[0]) > 2
        wave, flux = np.array([line[:2] for line in lines], dtype=float).T
    wave, first = np.unique(wave, return_index=True)
    flux = 10 ** (flux[first] + _BTSETTL_DF) if logarithmic else flux[first]
    # The sign before log g is a hyphen of the name: "-4.5" is log g 4.5
    return 100 * float(name["teff"]), -float(name["logg"]), float(name["feh"]), resample(path, wave, flux)


def read_packed(path, wavelength="WAVELENGTH_AA", spectra="SPECTRA"):
    """Return the Grid of a FITS file with wavelengths in one HDU and rows teff, logg, feh, flux in another.

    Without a column feh, [Fe/H] is 0. Raises InputError.
    """
    check_headers(path)
    with reading(path, "packed spectra"), fits.open(path, memmap=False) as file:
        wave, table = np.float64(file[wavelength].data), file[spectra].data
        feh = np.float64(table["feh"]) if "feh" in table.names else np.zeros(len(table))
        flux = resample(path, wave, np.float64(table["flux"]))
        rows = list(zip(np.float64(table["teff"]), np.float64(table["logg"]), feh, flux, strict=True))
    return _grid(path, rows)


def _found(folder, pattern):
    paths = sorted(Path(folder).rglob(pattern))
    if not paths:
        raise InputError("no spectra found", file=Path(folder), allowed=pattern)
    return paths


def resample(path, wave, flux):
    """Return means (..., 1801), over 5 A about each knot, of the piecewise linear flux (..., m) at wave (m,)."""
    half = 0.5 * (KNOTS[1] - KNOTS[0])
    cells = np.append(KNOTS - half, KNOTS[-1] + half)
    covers = len(wave) > 1 and wave[0] <= cells[0] and wave[-1] >= cells[-1] and (np.diff(wave) > 0).all()
    if not (covers and np.isfinite(flux).all() and (flux >= 0).all() and flux.any(axis=-1).all()):
        raise InputError(
            "needs rising wavelengths and finite fluxes >= 0", file=Path(path), allowed="all of 1997.5-11002.5 A"
        )
    every = np.union1d(wave[(wave > cells[0]) & (wave < cells[-1])], cells)
    (left, right), (a, b) = (part.T for part in linear(wave, every))
    value = flux[..., left] * a + flux[..., right] * b
    total = np.cumsum(0.5 * (value[..., 1:] + value[..., :-1]) * np.diff(every), axis=-1)
    total = np.concatenate([np.zeros_like(value[..., :1]), total], axis=-1)
    return np.diff(total[..., np.searchsorted(every, cells)], axis=-1) / np.diff(cells)


def _grid(source, rows):
    if not rows:
        raise InputError("no spectra found", file=Path(source))
    teff, logg, feh, flux = zip(*sorted(rows, key=lambda row: row[:3]), strict=True)
    return Grid(KNOTS, np.array(teff), np.array(logg), np.array(feh), np.array(flux))


def ln_photons(grid):
    """Return (n, m) ln of photon / s / m2 / angstrom of a Grid."""
    energy = np.maximum(grid.flux, _FLOOR) * _J_M2_PER_ERG_CM2
    return np.log(energy * grid.wavelength / (H_J_S * C_A_S))


class GridSeds(Seds):
    """A Grid with the interface of `StarSeds`: interpolated in ln S, as the coefficients there."""

    def __init__(self, grid, extinction_curve):
        axes = [np.unique(5040.0 / grid.teff), np.unique(grid.logg), np.unique(grid.feh)]
        # An axis of one value gets a second node, which has no effect
        nodes = [axis if len(axis) > 1 else np.append(axis, axis + 1.0) for axis in axes]
        self._table = np.empty([len(axis) for axis in nodes], dtype=int)
        for i, theta in enumerate(nodes[0]):
            mine = np.flatnonzero(np.abs(5040.0 / grid.teff - theta) == np.abs(5040.0 / grid.teff - theta).min())
            far = [np.abs(v[mine, None] - axis) for v, axis in zip((grid.logg, grid.feh), nodes[1:], strict=True)]
            far = far[0][:, :, None] + 1e3 * far[1][:, None, :]  # [Fe/H] counts more than log g
            self._table[i] = mine[far.argmin(axis=0)]
        super().__init__(nodes, ln_photons(grid), extinction_curve)

    def _mix(self, teff, logg, feh):
        (i, a), (j, b), (k, c) = self._cells(teff, logg, feh)
        index = self._table[i[:, :, None, None], j[:, None, :, None], k[:, None, None, :]]
        weight = a[:, :, None, None] * b[:, None, :, None] * c[:, None, None, :]
        return index.reshape(len(teff), -1), weight.reshape(len(teff), -1)
