"""The waterfall of the budget, and the chart of its accuracy against cost."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from csstsim.base.files.atomic import atomic_path
from csstsim.base.types import AnyArray, FloatArray, PathLike
from csstsim.report.style import BLUE, GREEN, GREY, MARKERS, ORANGE, PURPLE, SKY, VERMILION
from csstsim.studies.budget.shear.response import NAMES
from csstsim.studies.budget.shear.volume import GOALS, HOUR, sigma_m

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

LABELS = {"m1": "$m_1$", "m2": "$m_2$", "c1": "$c_1$", "c2": "$c_2$", "alpha": r"PSF leakage $\alpha$"}
UNITS = {"m1": 1e3, "m2": 1e3, "c1": 1e4, "c2": 1e4, "alpha": 1e2}
SHOWN = {1e3: "$10^{-3}$", 1e4: "$10^{-4}$", 1e2: "$10^{-2}$"}
COLOURS_OF_ESTIMATORS = {"hsm": BLUE, "own": ORANGE, "fpfs": GREEN, "metacal": PURPLE}
COLOURS_OF_KINDS = {"base": GREY, "bar": SKY, "sum": BLUE, "all": VERMILION, "rest": GREY}
AXIS_FACTOR = 6.0  # end of an axis, in units of the largest value; longer error bars are cut
LINEAR_MAX = 2.0  # in the unit of the axis: linear below, logarithmic above


class _Points(NamedTuple):
    """Values of an estimator with their errors, each (n,), along one axis, and their positions on the other."""

    position: AnyArray
    value: FloatArray
    error: FloatArray
    colour: str


def waterfall(path: PathLike, rows: Sequence[Mapping[str, Any]], sample: str, summed: Collection[str]) -> None:
    """Draw a sample's bars, one panel for each of NAMES: bars of the first estimator, points of the others.

    Axes include all values of all estimators; an error bar that continues beyond the axis ends in an arrow.
    summed: names of the effects of the sum, marked +.
    """
    from matplotlib.figure import Figure

    rows = [row for row in rows if row["sample"] == sample]
    kinds = list(dict.fromkeys(row["estimator"] for row in rows))
    first_kind, *_ = kinds
    first = [row for row in rows if row["estimator"] == first_kind]
    figure = Figure(figsize=(15, 0.33 * len(first) + 1.6), layout="constrained")
    axes = figure.subplots(1, len(NAMES), sharey=True)
    positions = np.arange(len(first))[::-1]
    for ax, name in zip(axes, NAMES, strict=True):
        unit = UNITS[name]
        shown: list[_Points] = []
        for number, kind in enumerate(kinds):
            of_kind = [row for row in rows if row["estimator"] == kind]
            value = np.array([row[name] for row in of_kind]) * unit
            error = np.nan_to_num(np.array([row[f"{name}_err"] for row in of_kind]) * unit)
            if number == 0:
                colours = [COLOURS_OF_KINDS[row["kind"]] for row in of_kind]
                shown.append(_Points(positions, value, error, "black"))
                ax.barh(positions, value, color=colours, height=0.62, xerr=error, error_kw={"lw": 1, "capsize": 2})
            else:
                heights = positions - 0.34 + 0.16 * (number - 1)
                shown.append(_Points(heights, value, error, COLOURS_OF_ESTIMATORS[kind]))
                style = {"ms": 3, "lw": 0.8, "color": COLOURS_OF_ESTIMATORS[kind]}
                ax.errorbar(value, heights, xerr=error, fmt=MARKERS[number], label=kind, **style)
        ax.axvline(0, color="black", lw=0.8)
        ax.set_xscale("symlog", linthresh=LINEAR_MAX, linscale=1.2)
        low, high = _limits(ax, shown)
        steps = (1, 3, 10) if max(-low, high) < 30 else (3, 30, 300)
        ticks = [tick for tick in (*(-step for step in steps[::-1]), 0, *steps) if low <= tick <= high]
        ax.set_xticks(ticks, [f"{tick:g}" for tick in ticks])
        ax.minorticks_off()
        ax.set_xlabel(f"linear to ±{LINEAR_MAX:g}, beyond logarithmic", fontsize=8)
        ax.grid(axis="x", alpha=0.3)
        ax.set_title(f"{LABELS[name]}  [{SHOWN[unit]}]", fontsize=10)
    labels = [f"{'+ ' if row['effect'] in summed else ''}{row['about']}" for row in first]
    left, *_, right = axes
    left.set_yticks(positions, labels, fontsize=8)
    if len(kinds) > 1:
        right.legend(fontsize=7, loc="lower right", title=f"bars: {first_kind}", title_fontsize=7)
    figure.suptitle(f"Shear of the sample “{sample}”: bias of the base, and what each effect adds", fontsize=11)
    _save(figure, path)


def _limits(ax: Axes, shown: Sequence[_Points]) -> tuple[float, float]:
    """Set and return an axis's limits, around all values of the points; mark error bars that are cut."""
    values = np.concatenate([points.value for points in shown])
    largest = np.abs(values[np.isfinite(values)]).max(initial=0.0)
    ends = np.array(ax.get_xlim()) * 1.5  # room for markers
    end_max = max(AXIS_FACTOR * largest, LINEAR_MAX)
    low, high = ax.set_xlim(*np.clip(ends, -end_max, end_max))
    for at, value, error, colour in shown:
        for end, side, mark in ((low, -1, "<"), (high, 1, ">")):
            cut = side * value + error > side * end
            if cut.any():
                [arrows] = ax.plot(np.full(cut.sum(), end), at[cut], mark, color=colour, ms=5, clip_on=False, zorder=5)
                arrows.set_in_layout(False)
    return low, high


def chart(path: PathLike, rows: Sequence[Mapping[str, Any]], sample: str) -> None:
    """Draw sigma(m) of each bar of a sample against CPU-hours, by the first estimator; points: the measured ones."""
    from matplotlib.figure import Figure

    rows = [row for row in rows if row["sample"] == sample and row["kind"] in ("base", "bar")]
    rows = [row for row in rows if row["estimator"] == rows[0]["estimator"] and sigma_m(row) > 0]
    figure = Figure(figsize=(10.5, 6), layout="constrained")
    axes = figure.subplots()
    hours = np.logspace(-4, 2, 7)
    palette = (BLUE, ORANGE, GREEN, VERMILION, PURPLE, SKY)
    for number, row in enumerate(sorted(rows, key=sigma_m, reverse=True)):
        spent = row["galaxies"] * row["seconds"] / HOUR
        colour = palette[number % len(palette)]
        mark = MARKERS[number % len(MARKERS)]
        axes.plot(hours, sigma_m(row) * np.sqrt(spent / hours), color=colour, lw=0.8, alpha=0.6)
        axes.plot(spent, sigma_m(row), mark, color=colour, ms=5, label=row["about"])
    for goal in GOALS:
        axes.axhline(goal, color=GREY, ls=":", lw=1)
        axes.text(hours[0], goal, f" {goal:g}", va="bottom", fontsize=8, color=GREY)
    axes.set(
        xscale="log",
        yscale="log",
        xlim=(hours[0], hours[-1]),
        ylim=(1e-6, 1e-2),
        xlabel="CPU-hours",
        ylabel=r"$\sigma(m)$ of the bar",
        title=f"What accuracy costs: sample “{sample}”; points are measured",
    )
    axes.legend(fontsize=8, loc="upper left", bbox_to_anchor=(1.01, 1.0), frameon=False)
    axes.grid(alpha=0.2)
    _save(figure, path)


def _save(figure: Figure, path: PathLike) -> None:
    with atomic_path(path) as temporary:
        figure.savefig(temporary, dpi=130, format="png")
