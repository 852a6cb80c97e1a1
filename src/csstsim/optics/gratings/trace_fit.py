"""Fit traces to sampled trajectories: equations 1 to 4 of the paper, as aXe coefficients.

For each order, by linear least squares over all positions and wavelengths,

    y = a0 + a1 x,   lambda = alpha0 + alpha1 L,   L = x sqrt(1 + a1^2)

with x, y relative to the direct image at m, n, and each coefficient quadratic in m, n. For an order that is almost a
point (the zeroth), lambda(L) is degenerate. The fit is then x = l0(m, n) + l1 lambda with a single l1, at least a
thousandth of a pixel over the band, and the trace has no slope.
"""

import csv
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from csstsim.base.errors import InputError
from csstsim.base.files.atomic import atomic_path
from csstsim.base.process.one_thread import one_thread
from csstsim.base.types import FloatArray, PathLike
from csstsim.instrument.axe import BEAMS, axe_text, field_terms, read_axe, sensitivity_file

_SHORT = 5.0  # px, of an order's length, below which it is an image rather than a spectrum
_LEAST = 1e-3  # px over the band
_MOST = 1e6  # px or angstrom: larger values in a sample are errors
PAPER = 0.2  # px, worst residual of the working orders (paper, section 4.2)
COLUMNS = ("order", "m", "n", "wavelength", "x", "y")


def fit_traces(samples: Mapping[int, ArrayLike]) -> dict[int, dict[str, Any]]:
    """Return {order: coefficients as in instrument.axe, with "extent"} fitted to samples {order: (k, 5)}.

    Rows of samples: m, n [0-based px], lambda [angstrom], x, y [px] that this light reaches. Raises ValueError if the
    positions do not determine a quadratic, or an order has fewer than two wavelengths.
    """
    return {order: _fit(np.asarray(rows, float), order) for order, rows in samples.items()}


def _fit(rows: FloatArray, order: int) -> dict[str, Any]:
    m, n, wave, x, y = rows.T
    if np.ptp(wave) == 0:
        raise ValueError(f"order {order:+d}: two wavelengths are needed")
    dx = x - m
    dy = y - n
    terms = field_terms(m, n)
    scale = np.abs(terms).max(axis=0)
    terms = terms / np.where(scale > 0, scale, 1.0)

    def solve(columns: FloatArray, values: FloatArray) -> FloatArray:
        found, _, rank, _ = np.linalg.lstsq(columns, values)
        if rank < columns.shape[1]:
            raise ValueError(f"order {order:+d}: the samples do not determine the coefficients")
        return found

    zero = np.zeros(6)
    each = np.unique(rows[:, :2], axis=0, return_inverse=True)[1].ravel()
    length = np.bincount(each, dx) / np.bincount(each)
    if np.abs(dx - length[each]).max() < _SHORT / 2:
        found = solve(np.column_stack([terms, wave]), dx)
        band = wave.max() - wave.min()
        slope = found[6] if abs(found[6]) * band >= _LEAST else _LEAST / band
        l0 = solve(terms, dx - slope * wave) / scale
        alpha1 = np.array([1.0 / slope, *zero[1:]])
        a0 = solve(terms, dy) / scale
        a1 = zero
        alpha0 = -l0 / slope
    else:
        both = solve(np.column_stack([terms, terms * dx[:, None]]), dy)
        a0 = both[:6] / scale
        a1 = both[6:] / scale
        path = dx * np.sqrt(1.0 + (field_terms(m, n) @ a1) ** 2)
        both = solve(np.column_stack([terms, terms * path[:, None]]), wave)
        alpha0 = both[:6] / scale
        alpha1 = both[6:] / scale
    fitted = {"xoff": zero, "yoff": zero, "a0": a0, "a1": a1, "alpha0": alpha0, "alpha1": alpha1}
    both = np.concatenate([dx, _along(fitted, m, n, wave)[0]])
    return fitted | {"extent": (float(np.floor(both.min())), float(np.ceil(both.max())))}


def residuals(fitted: Mapping[str, Any], rows: ArrayLike) -> FloatArray:
    """Return (k,) distances [px] between the fitted and the sampled positions of one order."""
    m, n, wave, x, y = np.asarray(rows, float).T
    dx, dy = _along(fitted, m, n, wave)
    return np.hypot(m + dx - x, n + dy - y)


def _along(fitted: Mapping[str, Any], m: FloatArray, n: FloatArray, wave: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return dx, dy [px] of light of wavelength `wave` from its direct image at m, n."""
    a0, a1, alpha0, alpha1 = (field_terms(m, n) @ fitted[name] for name in ("a0", "a1", "alpha0", "alpha1"))
    dx = (wave - alpha0) / (alpha1 * np.sqrt(1.0 + a1 * a1))
    return dx, a0 + a1 * dx


def read_trajectories(path: PathLike) -> dict[int, FloatArray]:
    """Return {order: (k, 5)} of a CSV table with the columns COLUMNS. Raises InputError."""
    try:
        with open(path, newline="", encoding="utf-8-sig") as file:
            reader = csv.DictReader(file)
            names = reader.fieldnames or []
            rows = list(reader)
    except (OSError, UnicodeDecodeError, csv.Error) as exc:
        raise InputError(f"cannot be read: {getattr(exc, 'strerror', None) or exc}", file=path) from None
    for name in COLUMNS:
        if names.count(name) != 1:
            raise InputError("needs one such column", file=path, key=name, value=names, allowed=", ".join(COLUMNS))
    if not rows:
        raise InputError("no samples", file=path)
    out: dict[int, list[list[float]]] = {}
    for number, row in enumerate(rows, 2):
        try:
            order, *values = int(row["order"]), *(float(row[name]) for name in COLUMNS[1:])
        except (TypeError, ValueError):
            raise InputError(
                "not numbers", file=path, key=f"row {number}", value=list(row.values()), allowed=", ".join(COLUMNS)
            ) from None
        if order not in BEAMS.values() or not (np.abs(values) < _MOST).all() or values[2] <= 0:
            raise InputError(
                "out of range",
                file=path,
                key=f"row {number}",
                value=[order, *values],
                allowed=f"orders {sorted(BEAMS.values())}, others below {_MOST:.0f}",
            )
        out.setdefault(order, []).append(values)
    return {order: np.array(rows) for order, rows in sorted(out.items())}


@one_thread
def fit_file(samples: PathLike, output: PathLike, stem: str | None = None) -> dict[int, FloatArray]:
    """Fit the trajectories of a CSV file, write a .conf; return {order: (k,) residuals [px] of the written file}.

    samples: path for `read_trajectories`; stem: start of the names of the sensitivity files listed in the .conf
    (axe.sensitivity_file), by default that of `output`. Raises InputError.
    """
    output = Path(output)
    rows = read_trajectories(samples)
    if output.suffix != ".conf":
        raise InputError("must end in .conf", file=output)
    stem = stem or output.stem
    if not re.fullmatch(r"[\w.+-]+", stem):
        raise InputError("must be a name", key="sensitivity", value=stem, allowed="letters, digits, _ . + -")
    if 1 not in rows:
        raise InputError("the first order is missing", file=samples, key="order", value=list(rows))
    try:
        fitted = fit_traces(rows)
    except ValueError as exc:
        raise InputError(str(exc), file=samples) from None
    for order, one in fitted.items():
        one["sensitivity"] = sensitivity_file(stem, order)
    about = [f"Grating {output.stem}, fitted to {Path(samples).name}", "Pixels count from 0"]
    with atomic_path(output) as temporary:
        temporary.write_text(axe_text(fitted, about), encoding="utf-8")
        written = read_axe(temporary)
    return {order: residuals(written[order], rows[order]) for order in rows}


def fit_report(worst: Mapping[int, FloatArray]) -> list[str]:
    """Return the lines of a report on the fit; `worst`: the residuals returned by `fit_file`."""
    lines = ["order  samples  rms [px]  worst [px]"]
    for order, px in worst.items():
        over = f"  above the {PAPER} px of the paper" if order in (0, 1) and px.max() > PAPER else ""
        lines.append(f"{order:+5d}  {len(px):7d}  {np.sqrt(np.mean(px**2)):8.4f}  {px.max():10.4f}{over}")
    return lines
