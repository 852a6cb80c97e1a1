"""Bias of the wavelength and flux of emission lines, by how much light of others there is.

The electrons e(X) about a line are compared with those that the truth leads one to expect, m(X). Flux is the sum within
CORE columns less a quadratic through those from there to SIDE, of e over that of m. The shift comes from a fit,

    e(X) = a m(X) + k m'(X) + c_0 + c_1 u + c_2 u^2,        shift = -k [px],    u = (X - X_0) / SIDE

Both are linear in the data: the mean of noisy lines is not biased. The image of a resolved galaxy in one line is no
product of its profiles along and across the trace, as m(X) and the weights have it: it is sharper in the middle. So a
line is too bright, by the optimal weights (`electrons`) more than in the box, which adds all pixels.
"""

from itertools import pairwise

import numpy as np

from csstsim.budget.redshift.stack import UNUSED
from csstsim.measure.spectra.line_columns import BLIND, PART

CORE, SIDE = 10, 30  # columns
EDGES = 0.0, 0.01, 0.1, 0.3, 1.0, np.inf  # of contamination over the object's own electrons: classes
STRONG = 3.0  # S/N that a line should have by its true flux
LEAST = 50  # usable columns about a line
WAYS = "box", "electrons"


def line_biases(tables, lines):
    """Return [{name: value}], one for each line of the frames: its contamination, ratio of fluxes and shift, by WAYS.

    tables, lines: of the same frames, as `csstsim extract` writes them. Lines on whole,
    usable columns, whose true S/N is at least STRONG; of several within SIDE columns the strongest stands for all.
    """
    return [one for table, found in zip(tables, lines, strict=True) for one in _of_frame(table, found)]


def _of_frame(table, lines):
    order = np.argsort(table["id"], kind="stable")
    table = table.take(order[table["order"][order] == 1])
    known = (lines["line"] != "") & (lines["flags"] & (BLIND | PART | UNUSED) == 0) & (lines["order"] == 1)
    known &= lines["flux_true"] >= STRONG * lines["flux_err"]
    seen = {}  # {id: columns of lines so far}, the strongest first: lines that blend are one
    for k in np.flatnonzero(known)[np.argsort(-(lines["flux_true"] / lines["flux_err"])[known], kind="stable")]:
        before = seen.setdefault(int(lines["id"][k]), [])
        if any(abs(lines["column"][k] - column) <= SIDE for column in before):
            continue
        before.append(float(lines["column"][k]))
        low, high = np.searchsorted(table["id"], [lines["id"][k], lines["id"][k] + 1])
        part = table.take(slice(low, high))
        near = np.abs(part["column"] - lines["column"][k]) <= SIDE
        part = part.take(near & (part["flags"] & UNUSED == 0) & np.isfinite(part["model"]))
        if len(part) < LEAST:
            continue
        light = float(part["model"].sum())
        share = float(np.nan_to_num(part["contamination"]).sum()) / light if light > 0 else np.inf
        found = {"id": int(lines["id"][k]), "line": str(lines["line"][k]), "contamination": share}
        for way in WAYS:
            values, errors = line_fit(part, lines["column"][k], way)
            found |= {f"{way}_ratio": values[0], f"{way}_ratio_err": errors[0]}
            found |= {f"{way}_shift": -values[1], f"{way}_shift_err": errors[1]}
        yield found


def line_fit(part, middle, way):
    """Return ((flux over true, k), their errors) of a line; part: columns about it; middle: X_0 [px]; way: of WAYS."""
    x, error = part["column"].astype(float) - middle, part[f"{way}_err"].astype(float)
    model, light, u = part["model"].astype(float), part[way].astype(float), x / SIDE
    even = np.stack([np.ones_like(u), u, u * u], axis=1)
    core = np.abs(x) <= CORE
    weighted = even[~core] / error[~core, None]
    below = even[core].sum(axis=0) @ np.linalg.pinv(weighted) / error[~core]  # of the core's sum, by the side's columns
    true, found = (one[core].sum() - below @ one[~core] for one in (model, light))
    ratio_error = np.sqrt((error[core] ** 2).sum() + ((below * error[~core]) ** 2).sum()) / abs(true)
    matrix = np.concatenate([np.stack([model, np.gradient(model, x)], axis=1), even], axis=1)
    scale = np.maximum(np.abs(matrix).max(axis=0), 1e-300)
    scaled = matrix / scale / error[:, None]
    inverse = np.linalg.pinv(scaled.T @ scaled, rcond=1e-10, hermitian=True)
    values, errors = inverse @ (scaled.T @ (light / error)) / scale, np.sqrt(np.diag(inverse)) / scale
    return (float(found / true), float(values[1])), (float(ratio_error), float(errors[1]))


def by_contamination(found):
    """Return [{low, high, lines, WAY_ratio, WAY_ratio_err, WAY_shift, WAY_shift_err}], one for each class of EDGES.

    Means have the weights of the inverse variances; an error is the larger of that of the weights and of the scatter.
    """
    share = np.abs([one["contamination"] for one in found])
    out = []
    for low, high in pairwise(EDGES):
        some = np.flatnonzero((share >= low) & (share < high))
        row = {"low": low, "high": high, "lines": len(some)}
        for name in (f"{way}_{what}" for way in WAYS for what in ("ratio", "shift")):
            values, errors = (np.array([found[k][key] for k in some], float) for key in (name, f"{name}_err"))
            row[name], row[f"{name}_err"] = mean(values, errors)
        out.append(row)
    return out


def mean(values, errors):
    """Return (mean, error) of values with errors, (n,); NaN of nothing."""
    if len(values) == 0:
        return np.nan, np.nan
    weight = 1 / errors**2
    middle = float((values * weight).sum() / weight.sum())
    spread = np.sqrt((((values - middle) * weight) ** 2).sum()) / weight.sum()
    return middle, float(max(spread, 1 / np.sqrt(weight.sum())))
