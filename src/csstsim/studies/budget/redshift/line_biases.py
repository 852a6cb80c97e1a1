"""Bias of the wavelength and flux of emission lines, by how much light of others there is.

Of each line, measure.spectra.line_fluxes has the flux F, the shift s (its position less that of its wavelength), and
the true flux F_0:

    ratio = F / F_0,        shift = s F / F_0

Both are linear in the data, because the fit has s F as a number of its own: the mean of noisy lines is not biased.
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

SIDE = 30  # columns about a line whose contamination counts, and that another line must be away
EDGES = 0.0, 0.01, 0.1, 0.3, 1.0, np.inf  # of contamination over the object's own electrons: classes
STRONG = 1.0  # S/N that a line has by its true flux: the means are linear in the data, so weak lines do not bias them


def line_biases(tables: Sequence[ObjectTable], lines: Sequence[ObjectTable]) -> list[dict[str, Any]]:
    """Return [{name: value}], one for each line of the frames: its contamination, ratio of fluxes and shift [px].

    tables, lines: of the same frames, as `csstsim extract` writes them. Lines on whole,
    usable columns, whose true S/N is at least STRONG; of several within SIDE columns the strongest stands for all.
    """
    return [one for table, found in zip(tables, lines, strict=True) for one in _of_frame(table, found)]


def _of_frame(table: ObjectTable, lines: ObjectTable) -> Iterator[dict[str, Any]]:
    order = np.argsort(table["id"], kind="stable")
    table = table.take(order[table["order"][order] == 1])
    known = (lines["line"] != "") & (lines["flags"] & (BLIND | PART | UNUSED) == 0) & (lines["order"] == 1)
    known &= (lines["flux_true"] >= STRONG * lines["flux_err"]) & (lines["flux_err"] > 0)  # so no ratio is 0 / 0
    seen: dict[int, list[float]] = {}  # {id: columns of lines so far}, the strongest first: lines that blend are one
    strength = lines["flux_true"][known] / lines["flux_err"][known]
    for k in np.flatnonzero(known)[np.argsort(-strength, kind="stable")]:
        before = seen.setdefault(int(lines["id"][k]), [])
        if any(abs(lines["column"][k] - column) <= SIDE for column in before):
            continue
        before.append(float(lines["column"][k]))
        low, high = np.searchsorted(table["id"], [lines["id"][k], lines["id"][k] + 1])
        part = table.take(slice(low, high))
        near = np.abs(part["column"] - lines["column"][k]) <= SIDE
        part = part.take(near & (part["flags"] & UNUSED == 0) & np.isfinite(part["model"]))
        light = float(part["model"].sum())
        contamination = float(np.nan_to_num(part["contamination"]).sum()) / light if light > 0 else np.inf
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


def by_contamination(found: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Return [{low, high, lines, ratio, ratio_err, shift, shift_err}], one for each class of EDGES.

    Means have the weights of the inverse variances; an error is the larger of that of the weights and of the scatter.
    """
    contamination = np.abs([one["contamination"] for one in found])
    out = []
    for low, high in pairwise(EDGES):
        some = np.flatnonzero((contamination >= low) & (contamination < high))
        row = {"low": low, "high": high, "lines": len(some)}
        for name in ("ratio", "shift"):
            values = np.array([found[k][name] for k in some.tolist()], float)
            errors = np.array([found[k][f"{name}_err"] for k in some.tolist()], float)
            row[name], row[f"{name}_err"] = mean(values, errors)
        out.append(row)
    return out


def mean(values: FloatArray, errors: FloatArray) -> tuple[float, float]:
    """Return (mean, error) of values with errors, (n,); NaN of nothing."""
    if len(values) == 0:
        return np.nan, np.nan
    weight = 1 / errors**2
    middle = float((values * weight).sum() / weight.sum())
    spread = np.sqrt((((values - middle) * weight) ** 2).sum()) / weight.sum()
    return middle, float(max(spread, 1 / np.sqrt(weight.sum())))
