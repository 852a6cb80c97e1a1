"""Spectra of one object from several frames, gratings and position angles, added on one grid of wavelengths.

A column's flux is shared among the bins that it overlaps, with the weight of its inverse variance:

    f = sum_c w_c f_c / sum_c w_c,    w_c = overlap_c / sigma_c^2,    sigma^2 = sum_c w_c^2 sigma_c^2 / (sum_c w_c)^2

Bins that share a column are correlated: two next to each other by up to a half.
"""

from collections.abc import Iterable

import numba
import numpy as np

from csstsim.base.types import BoolArray, FloatArray, IntArray
from csstsim.base.units import C_A_S, H_J_S
from csstsim.catalog.table import ObjectTable
from csstsim.measure.spectra.spectrum_columns import BESIDE, CUT, DIM, LOST, SATURATED

STEP = 4.0  # angstrom
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


def usable(table: ObjectTable) -> BoolArray:
    """Return (n,) bool: columns of a table of spectra whose flux can be used."""
    return (table["flags"] & UNUSED == 0) & np.isfinite(table["flux"]) & (table["flux_err"] > 0)


def stacked(tables: Iterable[ObjectTable]) -> ObjectTable:
    """Return the ObjectTable of COLUMNS, by id and wavelength: bins with light of first orders of at least a frame.

    tables: ObjectTables of measure.spectra.spectrum_columns.COLUMNS.
    """
    parts = [_parts(table.take(usable(table) & (table["order"] == 1)), k) for k, table in enumerate(tables)]
    ids, low, high, flux, error, others, frame = (np.concatenate(one) for one in zip(*parts, strict=True))
    if len(ids) == 0:
        empty = {name: np.zeros(0) for name in COLUMNS}
        return ObjectTable(empty | {"id": np.zeros(0, np.int64), "frames": np.zeros(0, np.int16)})
    start = np.floor(low.min() / STEP) * STEP
    bins = int(np.ceil((high.max() - start) / STEP))
    known, row = np.unique(ids, return_inverse=True)
    order = np.argsort(row, kind="stable")
    sums = _added(
        row[order],
        len(known),
        (low[order] - start) / STEP,
        (high[order] - start) / STEP,
        flux[order],
        error[order],
        others[order],
        frame[order],
        bins,
    )
    weight, light, variance, more, frames = sums
    there, at = np.nonzero(weight > 0)
    w = weight[there, at]
    return ObjectTable(
        {
            "id": known[there],
            "wavelength": start + STEP * (at + 0.5),
            "flux": light[there, at] / w,
            "flux_err": np.sqrt(variance[there, at]) / w,
            "contamination": more[there, at] / w,
            "frames": frames[there, at].astype(np.int16),
        }
    )


def _parts(
    table: ObjectTable, k: int
) -> tuple[IntArray, FloatArray, FloatArray, FloatArray, FloatArray, FloatArray, IntArray]:
    """Return id, first and last wavelength, flux, error and contamination of each column, and the frame k."""
    wave = np.asarray(table["wavelength"], float)
    erg = H_J_S * C_A_S / wave * ERG_PER_CM2
    half = 0.5 * np.abs(_steps(table))
    per = np.where(table["sensitivity"] > 0, table["sensitivity"], np.nan).astype(float)
    others = np.nan_to_num(table["contamination"].astype(float) / per) * erg
    flux, error = (table[name].astype(float) * erg for name in ("flux", "flux_err"))
    return table["id"], wave - half, wave + half, flux, error, others, np.full(len(wave), k)


def _steps(table: ObjectTable) -> FloatArray:
    """Return (n,) angstrom per column of each column's spectrum: wavelengths are linear in x."""
    wave, column, ids = (np.asarray(table[name], float) for name in ("wavelength", "column", "id"))
    if len(wave) < 2:
        return np.full(len(wave), STEP)
    same = np.append(ids[1:] == ids[:-1], False)
    with np.errstate(divide="ignore", invalid="ignore"):
        step = np.append(np.diff(wave) / np.diff(column), np.nan)
    step = np.where(same & np.isfinite(step), step, np.nan)
    before = np.append(np.nan, step[:-1])
    return np.nan_to_num(np.where(np.isfinite(step), step, before), nan=STEP)


@numba.njit(cache=True)
def _added(
    row: IntArray,
    rows: int,
    low: FloatArray,
    high: FloatArray,
    flux: FloatArray,
    error: FloatArray,
    others: FloatArray,
    frame: IntArray,
    bins: int,
) -> FloatArray:
    """Return (5, rows, bins): sums of weight, flux, variance and contamination, and the number of frames."""
    out = np.zeros((5, rows, bins))
    last = np.full((rows, bins), -1)
    for c in range(len(row)):
        k = row[c]
        for b in range(int(low[c]), min(int(np.ceil(high[c])), bins)):
            share = min(high[c], b + 1.0) - max(low[c], float(b))
            if share <= 0.0:
                continue
            w = share / error[c] ** 2
            out[0, k, b] += w
            out[1, k, b] += w * flux[c]
            out[2, k, b] += w * w * error[c] ** 2
            out[3, k, b] += w * others[c]
            if last[k, b] != frame[c]:
                last[k, b] = frame[c]
                out[4, k, b] += 1
    return out
