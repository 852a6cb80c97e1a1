"""Bias of the wavelength and flux of emission lines, by contamination.

For each line, measure.spectra.line_fluxes gives the flux F, the shift s (measured minus true position), and the true
flux F_0:

    ratio = F / F_0,        shift = s F / F_0

Both are linear in the data, because the fit has s F as a parameter, so the mean of noisy lines is not biased.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np

from csstsim.base.types import FloatArray
from csstsim.measure.spectra.line_columns import BLIND, PART
from csstsim.studies.budget.redshift.stack import UNUSED

if TYPE_CHECKING:
    from csstsim.catalog.table import ObjectTable

HALF_WIDTH = 30  # columns on each side of a line: those of its contamination, and without another line
EDGES = 0.0, 0.01, 0.1, 0.3, 1.0, np.inf  # of classes of contamination over the object's electrons
SNR_MIN = 1.0  # of a line by its true flux; the means are linear in the data, so weak lines do not bias them


def line_biases(tables: Sequence[ObjectTable], lines: Sequence[ObjectTable]) -> list[dict[str, Any]]:
    """Return [{name: value}], one for each line of the frames: its contamination, ratio of fluxes and shift [px].

    tables, lines: of the same frames, as `csstsim extract` writes them. Lines are included if they are on complete,
    usable columns and have a true S/N of at least SNR_MIN; of several within HALF_WIDTH columns, only the strongest.
    """
    frames = zip(tables, lines, strict=True)
    return [bias for table, lines_of_frame in frames for bias in _frame_biases(table, lines_of_frame)]


def _frame_biases(table: ObjectTable, lines: ObjectTable) -> Iterator[dict[str, Any]]:
    order = np.argsort(table["id"], kind="stable")
    table = table.take(order[table["order"][order] == 1])
    usable = (lines["line"] != "") & (lines["flags"] & (BLIND | PART | UNUSED) == 0) & (lines["order"] == 1)
    usable &= (lines["flux_true"] >= SNR_MIN * lines["flux_err"]) & (lines["flux_err"] > 0)  # so no ratio is 0 / 0
    columns_by_id: dict[int, list[float]] = {}  # {id: columns of its lines so far}, from the strongest: blends are one
    strength = lines["flux_true"][usable] / lines["flux_err"][usable]
    for k in np.flatnonzero(usable)[np.argsort(-strength, kind="stable")]:
        columns = columns_by_id.setdefault(int(lines["id"][k]), [])
        if any(abs(lines["column"][k] - column) <= HALF_WIDTH for column in columns):
            continue
        columns.append(float(lines["column"][k]))
        low, high = np.searchsorted(table["id"], [lines["id"][k], lines["id"][k] + 1])
        spectrum = table.take(slice(low, high))
        near = np.abs(spectrum["column"] - lines["column"][k]) <= HALF_WIDTH
        spectrum = spectrum.take(near & (spectrum["flags"] & UNUSED == 0) & np.isfinite(spectrum["model"]))
        electrons = float(spectrum["model"].sum())
        contamination = float(np.nan_to_num(spectrum["contamination"]).sum()) / electrons if electrons > 0 else np.inf
        flux = float(lines["flux"][k])
        flux_err = float(lines["flux_err"][k])
        true = float(lines["flux_true"][k])
        shift = float(lines["shift"][k])
        shift_err = float(lines["shift_err"][k])
        yield {
            "id": int(lines["id"][k]),
            "line": str(lines["line"][k]),
            "contamination": contamination,
            "ratio": flux / true,
            "ratio_err": flux_err / true,
            "shift": shift * flux / true,
            "shift_err": shift_err * abs(flux) / true,
        }


def by_contamination(biases: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Return [{low, high, lines, ratio, ratio_err, shift, shift_err}], one for each class of EDGES.

    Means are weighted by inverse variance; an error is the larger of those from the weights and from the scatter.
    """
    contamination = np.abs([bias["contamination"] for bias in biases])
    classes = []
    for low, high in pairwise(EDGES):
        rows = np.flatnonzero((contamination >= low) & (contamination < high))
        row = {"low": low, "high": high, "lines": len(rows)}
        for name in ("ratio", "shift"):
            values = np.array([biases[k][name] for k in rows.tolist()], float)
            errors = np.array([biases[k][f"{name}_err"] for k in rows.tolist()], float)
            row[name], row[f"{name}_err"] = mean(values, errors)
        classes.append(row)
    return classes


def mean(values: FloatArray, errors: FloatArray) -> tuple[float, float]:
    """Return (mean, error) of values (n,) with errors (n,); NaN without values."""
    if len(values) == 0:
        return np.nan, np.nan
    weight = 1 / errors**2
    average = float((values * weight).sum() / weight.sum())
    scatter = np.sqrt((((values - average) * weight) ** 2).sum()) / weight.sum()
    return average, float(max(scatter, 1 / np.sqrt(weight.sum())))
