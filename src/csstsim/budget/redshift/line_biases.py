"""Bias of the wavelength and flux of emission lines, by how much light of others there is.

The electrons e(X) within SIDE columns of a line are compared with those that the truth leads one to expect, m(X):

    e(X) = a m(X) + k m'(X) + c_0 + c_1 X,        shift = -k [px]

So the shift is that of the line's light along the trace against its known wavelength; with a near 1 it is linear in the
data, and the mean of noisy lines is not biased. The ratio of fluxes is that of the tables of line fluxes to
`flux_true`: the slope through the origin, sum w F F_true / sum w F_true^2, with w = 1 / flux_err^2.
"""

from itertools import pairwise

import numpy as np

from csstsim.budget.redshift.stack import UNUSED
from csstsim.measure.spectra.line_columns import BLENDED, BLIND, PART

SIDE = 12  # columns
EDGES = 0.0, 0.01, 0.1, 0.3, 1.0, np.inf  # of contamination over the object's own electrons: classes
STRONG = 3.0  # S/N that a line should have by its true flux
LEAST = 12  # usable columns about a line


def line_biases(tables, lines):
    """Return a list of {name: value}, one for each line of the frames: its contamination, flux and shift.

    tables, lines: of the same frames, as `csstsim extract` writes them. Lines without a flag (a neighbour's within its
    width, part beyond the spectrum), whose true S/N is at least STRONG.
    """
    return [one for table, found in zip(tables, lines, strict=True) for one in _of_frame(table, found)]


def _of_frame(table, lines):
    order = np.argsort(table["id"], kind="stable")
    table = table.take(order[table["order"][order] == 1])
    known = (lines["line"] != "") & (lines["flags"] & (BLENDED | BLIND | PART | UNUSED) == 0) & (lines["order"] == 1)
    known &= lines["flux_true"] >= STRONG * lines["flux_err"]
    for k in np.flatnonzero(known):
        low, high = np.searchsorted(table["id"], [lines["id"][k], lines["id"][k] + 1])
        part = table.take(slice(low, high))
        near = np.abs(part["column"] - lines["column"][k]) <= SIDE
        part = part.take(near & (part["flags"] & UNUSED == 0) & np.isfinite(part["model"]))
        if len(part) < LEAST:
            continue
        shift, error = line_shift(part, lines["column"][k])
        light = float(part["model"].sum())
        share = float(np.nan_to_num(part["contamination"]).sum()) / light if light > 0 else np.inf
        yield {
            "id": int(lines["id"][k]), "line": str(lines["line"][k]), "contamination": share, "shift": shift,
            "shift_err": error, "flux": float(lines["flux"][k]), "flux_err": float(lines["flux_err"][k]),
            "flux_true": float(lines["flux_true"][k]),
        }  # fmt: skip


def line_shift(part, middle):
    """Return (shift, error) [px] of the light about a line against the expected; part: columns of a spectrum."""
    x, error = part["column"].astype(float) - middle, part["electrons_err"].astype(float)
    model = part["model"].astype(float)
    matrix = np.stack([model, np.gradient(model, x), np.ones_like(x), x], axis=1)
    scale = np.maximum(np.abs(matrix).max(axis=0), 1e-300)
    scaled = matrix / scale / error[:, None]
    inverse = np.linalg.pinv(scaled.T @ scaled, rcond=1e-10, hermitian=True)
    values = inverse @ (scaled.T @ (part["electrons"] / error))
    return float(-values[1] / scale[1]), float(np.sqrt(inverse[1, 1]) / scale[1])


def by_contamination(found):
    """Return [{low, high, lines, flux_ratio, flux_ratio_err, shift, shift_err}], one for each class of EDGES."""
    names = ("contamination", "flux", "flux_err", "flux_true", "shift", "shift_err")
    values = {name: np.array([one[name] for one in found], float) for name in names}
    share = np.abs(values["contamination"])
    out = []
    for low, high in pairwise(EDGES):
        some = (share >= low) & (share < high)
        flux, error, true, shift, off = (values[name][some] for name in names[1:])
        norm, weight = (true**2 / error**2).sum(), (1 / off**2).sum()
        ratio = (flux * true / error**2).sum() / norm if norm > 0 else np.nan
        out.append({
            "low": low, "high": high, "lines": int(some.sum()), "flux_ratio": ratio,
            "flux_ratio_err": 1 / np.sqrt(norm) if norm > 0 else np.nan,
            "shift": (shift / off**2).sum() / weight if weight > 0 else np.nan,
            "shift_err": 1 / np.sqrt(weight) if weight > 0 else np.nan,
        })  # fmt: skip
    return out
