"""The figure of a budget of redshifts: measured against true, completeness and purity, bias of lines."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from csstsim.base.types import FloatArray
from csstsim.report.figures import png

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from csstsim.catalog.table import ObjectTable

GOOD = "#2a6f97"
OTHER = "#c9c9c9"


def figure(result: Mapping[str, Any], answer: Mapping[int, tuple[float, bool]], objects: ObjectTable) -> bytes:
    """Return the bytes of a PNG.

    result: of report.budget, before it is written; answer: {id: (z, good)}; objects: report.objects_of.
    """
    from matplotlib.figure import Figure

    png_figure = Figure(figsize=(12, 7.4), layout="constrained", dpi=110)
    axes = png_figure.subplots(2, 3)
    _measured(axes[0, 0], answer, objects, result["right"])
    for ax, name, unit in (
        (axes[0, 1], "magnitude", f"{result['band']} [AB]"),
        (axes[0, 2], "redshift", "z"),
        (axes[1, 0], "size", "half-light radius [arcsec]"),
        (axes[1, 1], "contamination", "light of others / own"),
    ):
        _fractions(ax, result[name], unit)
    _lines(axes[1, 2], result["lines"])
    return png(png_figure)


def _measured(ax: Axes, answer: Mapping[int, tuple[float, bool]], objects: ObjectTable, right: float) -> None:
    true = dict(zip(objects["id"].tolist(), objects["z"].tolist(), strict=True))
    for good, color, size in ((False, OTHER, 3), (True, GOOD, 5)):
        rows = [(true[k], z) for k, (z, is_good) in answer.items() if k in true and is_good == good]
        label = f"{'good' if good else 'not good'}: {len(rows)}"
        x, y = np.array(rows).reshape(-1, 2).T
        ax.scatter(x, y, s=size, color=color, label=label, linewidths=0)
    top = 1.1 * max([2e-3, *(z for k, (z, _) in answer.items() if k in true)])
    ax.plot([0, top], [0, top], color="k", lw=0.5)
    ax.set(xlim=(0, top), ylim=(0, top), xlabel="true redshift", ylabel="fitted redshift")
    ax.set_title(f"right: within {right:g} (1 + z)", fontsize=9)
    ax.legend(fontsize=8, markerscale=2)


def _fractions(ax: Axes, classes: Sequence[Mapping[str, Any]], unit: str) -> None:
    positions = np.arange(len(classes))
    for name, color, shift in (("completeness", GOOD, -0.1), ("purity", "#d1495b", 0.1)):
        values = _column(classes, name)
        errors = _column(classes, f"{name}_err")
        ax.errorbar(positions + shift, values, errors, fmt="o", color=color, label=name, capsize=2, ms=4)
    for k, class_ in enumerate(classes):
        ax.annotate(str(class_["objects"]), (k, 1.04), ha="center", fontsize=7, color="0.4")
    labels = [_label(class_) for class_ in classes]
    ax.set_xticks(positions, labels, fontsize=8)
    ax.set(xlim=_limits(classes), ylim=(0, 1.12), xlabel=unit)
    ax.legend(fontsize=8, loc="lower right", bbox_to_anchor=(1, 1), ncols=2, frameon=False, borderaxespad=0.2)


def _column(classes: Sequence[Mapping[str, Any]], name: str) -> FloatArray:
    return np.array([class_[name] for class_ in classes], float)


def _limits(classes: Sequence[Mapping[str, Any]]) -> tuple[float, float]:
    """Return the limits of an axis with class k at k: half a class on each side, also for no class."""
    return -0.5, max(len(classes), 1) - 0.5


def _label(class_: Mapping[str, Any]) -> str:
    return f"{class_['low']:g} to\n{class_['high']:g}" if np.isfinite(class_["high"]) else f"> {class_['low']:g}"


def _lines(ax: Axes, classes: Sequence[Mapping[str, Any]]) -> None:
    classes = [class_ for class_ in classes if class_["lines"]]
    positions = np.arange(len(classes))
    values = _column(classes, "ratio")
    errors = _column(classes, "ratio_err")
    ax.errorbar(positions, 100 * (values - 1), 100 * errors, fmt="o", color=GOOD, capsize=2, ms=4)
    ax.axhspan(-2, 2, color=GOOD, alpha=0.1, lw=0)
    ax.set_ylabel("flux of lines over true - 1 [%]", color=GOOD)
    other = ax.twinx()
    shift = _column(classes, "shift")
    shift_err = _column(classes, "shift_err")
    other.errorbar(positions + 0.15, shift, shift_err, fmt="s", color="#d1495b", capsize=2, ms=4)
    other.set_ylabel("shift of lines [px]", color="#d1495b")
    for axis, middle, half in ((ax, 100 * (values - 1), 100 * errors), (other, shift, shift_err)):
        largest = max([*(np.abs(middle) + half), 1e-3]) * 1.2
        axis.set_ylim(-largest, largest)
    ax.axhline(0, color="k", lw=0.5)
    ax.set_xlim(_limits(classes))  # of both: they share it
    ax.set_xticks(positions, [f"{_label(class_)}\n({class_['lines']})" for class_ in classes], fontsize=8)
    ax.set_xlabel("light of others / own, at the line")
