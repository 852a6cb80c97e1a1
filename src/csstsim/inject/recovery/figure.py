"""The figure of recovered objects: completeness, magnitude, position and shape against magnitude, size and density."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from csstsim.base.files.atomic import atomic_path
from csstsim.inject.recovery.bins import AGAINST, binned
from csstsim.report.style import BLUE, VERMILION

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from csstsim.base.types import FloatArray, PathLike
    from csstsim.catalog.table import ObjectTable
    from csstsim.inject.recovery.bins import Bin

ROWS = {
    "completeness": "found",
    "d_mag": "magnitude,\nmeasured - true",
    "d_x": "position x, y [px],\nmeasured - true",
    "d_g1": "shape g1, g2,\nmeasured - true",
}
PAIR = {"d_x": "d_y", "d_g1": "d_g2"}


def draw(table: ObjectTable, path: PathLike) -> None:
    """Draw a recovered table (recovered.recovered) into a PNG."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    figure, panels = plt.subplots(len(ROWS), len(AGAINST), figsize=(11, 10), sharex="col", layout="constrained")
    for column, (against, label) in enumerate(AGAINST.items()):
        bins = binned(table, against)
        at = np.array([one.centre for one in bins])
        for row, (name, title) in enumerate(ROWS.items()):
            axes = panels[row, column]
            if name == "completeness":
                _completeness(axes, at, bins)
            else:
                _objects(axes, table, against, name, bins)
                _values(axes, at, bins, name)
            axes.set(ylabel=title if not column else "", xlabel=label if row == len(ROWS) - 1 else "")
    for axes in panels[1:, 0]:
        axes.legend(fontsize=8, loc="lower left", ncols=2)
    with atomic_path(path) as temporary:
        figure.savefig(temporary, dpi=110, format="png")
    plt.close(figure)


def _completeness(axes: Axes, at: FloatArray, bins: list[Bin]) -> None:
    found, low, high = np.transpose([one.completeness for one in bins])
    axes.errorbar(at, found, [found - low, high - found], fmt="o", color=BLUE, markersize=4)
    axes.set_ylim(-0.05, 1.05)


def _objects(axes: Axes, table: ObjectTable, against: str, name: str, bins: list[Bin]) -> None:
    """Plot the objects of bins with too few for a mean, one by one."""
    values = np.asarray(table[against], float)
    for key, colour in ((name, BLUE), (PAIR.get(name), VERMILION)):
        few = [one for one in bins if key is not None and not np.isfinite(one.numbers[key].mean)]
        rows = table["clean"] & np.any([(values >= one.low) & (values < one.high) for one in few] or [False], axis=0)  # type: ignore[list-item]  # for all
        if key is not None and rows.any():
            axes.plot(values[rows], table[key][rows], ".", color=colour, markersize=4, label=f"one object{_axis(key)}")


def _values(axes: Axes, at: FloatArray, bins: list[Bin], name: str) -> None:
    """Plot means with errors, and the scatter as bars behind them; the two axes of a pair have different colours."""
    axes.axhline(0.0, color="#999999", linewidth=0.8)
    largest = 0.0
    for key, colour, shift in ((name, BLUE, 0.0), (PAIR.get(name), VERMILION, 0.012)):
        if key is None or not bins:
            continue
        numbers = [one.numbers[key] for one in bins]
        mean, error, scatter = np.transpose([(one.mean, one.mean_error, one.scatter) for one in numbers])
        position = at + shift * np.ptp(at)
        axes.errorbar(position, mean, scatter, fmt="none", ecolor=colour, alpha=0.25, linewidth=5, label="scatter")
        axes.errorbar(position, mean, error, fmt="o", color=colour, markersize=4, label=f"mean{_axis(key)}")
        good = np.isfinite(mean)
        largest = max([largest, *(np.abs(mean) + scatter)[good]])
    if largest > 0:
        axes.set_ylim(-1.2 * largest, 1.2 * largest)


def _axis(key: str) -> str:
    return f" of {key.removeprefix('d_')}" if key in PAIR or key in PAIR.values() else ""
