"""Spectra of one object from several frames, gratings and position angles, stacked on one grid of wavelengths.

A column contributes to the bins that it overlaps, with inverse-variance weights:

    f = sum_c w_c f_c / sum_c w_c,    w_c = overlap_c / sigma_c^2,    sigma^2 = sum_c w_c^2 sigma_c^2 / (sum_c w_c)^2

Bins that share a column are correlated: adjacent ones by up to a half.
"""

from collections.abc import Iterable
from typing import NamedTuple

import numba
import numpy as np

from csstsim.base.types import BoolArray, FloatArray, IntArray
from csstsim.base.units import C_A_S, H_J_S
from csstsim.catalog.table import ObjectTable
from csstsim.measure.spectra.spectrum_columns import BESIDE, CUT, DIM, LOST, SATURATED

STEP = 4.0  # angstrom, width of a bin
UNUSED = DIM | LOST | SATURATED | BESIDE | CUT
ERG_PER_CM2 = 1e3  # J / m2 in erg / cm2
COLUMNS = {
    "id": "the object",
    "wavelength": "angstrom, of the bin's middle",
    "flux": "erg / s / cm2 / angstrom",
    "flux_err": "its error",
    "contamination": "erg / s / cm2 / angstrom of others, subtracted or only stated, as in the spectra",
    "frames": "how many spectra the bin has light of",
}


# planes of the sums of a bin
WEIGHT = 0
FLUX = 1
VARIANCE = 2
OTHERS = 3
FRAMES = 4


class _Columns(NamedTuple):
    """Columns of spectra, each field (n,): object, first and last wavelength [angstrom, then bins], flux, error,
    contamination [erg / s / cm2 / angstrom], and number of the frame."""

    id: IntArray
    low: FloatArray
    high: FloatArray
    flux: FloatArray
    error: FloatArray
    others: FloatArray
    frame: IntArray


def usable(table: ObjectTable) -> BoolArray:
    """Return (n,) bool: columns of a table of spectra whose flux can be used."""
    return (table["flags"] & UNUSED == 0) & np.isfinite(table["flux"]) & (table["flux_err"] > 0)


def stack_spectra(tables: Iterable[ObjectTable]) -> ObjectTable:
    """Return the ObjectTable of COLUMNS, by id and wavelength: bins with first orders of at least one frame.

    tables: ObjectTables of measure.spectra.spectrum_columns.COLUMNS, one a frame.
    """
    frames = [_columns(table.take(usable(table) & (table["order"] == 1)), k) for k, table in enumerate(tables)]
    columns = _Columns._make(np.concatenate(fields) for fields in zip(*frames, strict=True))
    if len(columns.id) == 0:
        empty = {name: np.zeros(0) for name in COLUMNS}
        return ObjectTable(empty | {"id": np.zeros(0, np.int64), "frames": np.zeros(0, np.int16)})
    start = np.floor(columns.low.min() / STEP) * STEP
    bins = int(np.ceil((columns.high.max() - start) / STEP))
    ids, row = np.unique(columns.id, return_inverse=True)
    order = np.argsort(row, kind="stable")
    columns = _Columns._make(values[order] for values in columns)
    columns = columns._replace(low=(columns.low - start) / STEP, high=(columns.high - start) / STEP)
    sums = _accumulate(row[order], len(ids), columns, bins)
    spectrum, bin_ = np.nonzero(sums[WEIGHT] > 0)
    weight = sums[WEIGHT, spectrum, bin_]
    return ObjectTable(
        {
            "id": ids[spectrum],
            "wavelength": start + STEP * (bin_ + 0.5),
            "flux": sums[FLUX, spectrum, bin_] / weight,
            "flux_err": np.sqrt(sums[VARIANCE, spectrum, bin_]) / weight,
            "contamination": sums[OTHERS, spectrum, bin_] / weight,
            "frames": sums[FRAMES, spectrum, bin_].astype(np.int16),
        }
    )


def _columns(table: ObjectTable, frame: int) -> _Columns:
    """Return the _Columns of a frame, given its number, with wavelengths in angstrom."""
    wave = np.asarray(table["wavelength"], float)
    erg = H_J_S * C_A_S / wave * ERG_PER_CM2
    half = 0.5 * np.abs(_steps(table))
    sensitivity = np.where(table["sensitivity"] > 0, table["sensitivity"], np.nan).astype(float)
    others = np.nan_to_num(table["contamination"].astype(float) / sensitivity) * erg
    flux = table["flux"].astype(float) * erg
    error = table["flux_err"].astype(float) * erg
    return _Columns(table["id"], wave - half, wave + half, flux, error, others, np.full(len(wave), frame))


def _steps(table: ObjectTable) -> FloatArray:
    """Return (n,) angstrom per column of each column's spectrum: wavelengths are linear in x."""
    wave = np.asarray(table["wavelength"], float)
    column = np.asarray(table["column"], float)
    ids = np.asarray(table["id"])  # not as floats: an id has more digits
    if len(wave) < 2:
        return np.full(len(wave), STEP)
    same = np.append(ids[1:] == ids[:-1], False)
    with np.errstate(divide="ignore", invalid="ignore"):
        step = np.append(np.diff(wave) / np.diff(column), np.nan)
    step = np.where(same & np.isfinite(step), step, np.nan)
    before = np.append(np.nan, step[:-1])
    return np.nan_to_num(np.where(np.isfinite(step), step, before), nan=STEP)


@numba.njit(cache=True)
def _accumulate(row: IntArray, rows: int, columns: _Columns, bins: int) -> FloatArray:
    """Return (5, rows, bins): sums of weight, flux, variance and contamination, and the number of frames.

    row (n,): of each column's object; columns are sorted by it, with wavelengths in bins.
    """
    out = np.zeros((5, rows, bins))
    last = np.full((rows, bins), -1)
    for c in range(len(row)):
        k = row[c]
        low = columns.low[c]
        high = columns.high[c]
        variance = columns.error[c] ** 2
        for b in range(int(low), min(int(np.ceil(high)), bins)):
            overlap = min(high, b + 1.0) - max(low, float(b))
            if overlap <= 0.0:
                continue
            w = overlap / variance
            out[WEIGHT, k, b] += w
            out[FLUX, k, b] += w * columns.flux[c]
            out[VARIANCE, k, b] += w * w * variance
            out[OTHERS, k, b] += w * columns.others[c]
            if last[k, b] != columns.frame[c]:
                last[k, b] = columns.frame[c]
                out[FRAMES, k, b] += 1
    return out
