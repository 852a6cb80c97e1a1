"""The figure of a variant: what it measures less what its base does, against magnitude."""

from __future__ import annotations

from typing import TYPE_CHECKING, TypeAlias

import numpy as np
from matplotlib.figure import Figure

from csstsim.measure.bricks.validation.twins import binned, values
from csstsim.report.figures import png
from csstsim.report.style import BLUE, VERMILION

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from typing import Any

    from matplotlib.axes import Axes

    from csstsim.base.types import FloatArray
    from csstsim.measure.bricks.validation.twins import Mean

PANELS = {
    "magnitude [mag]": ("mag",),
    "position [px]": ("x", "y"),
    "ln size": ("size",),
    "ellipticity": ("e1", "e2"),
    "corrected shape": ("g1", "g2"),
    "electrons of spectra": ("spectrum",),
}
COLOURS = (BLUE, VERMILION)
COLUMNS = 3
SHOWN = 80.0  # percent of the objects are within a panel
KINDS = {"star": "o", "galaxy": "s", "spectrum": "D"}
# Number of the panel's quantity, kind, label; magnitude and difference of objects; magnitude and Mean of bins
Curve: TypeAlias = "tuple[int, str, str, FloatArray, FloatArray, FloatArray, list[Mean]]"


def twin_figure(objects: Sequence[Mapping[str, Any]]) -> bytes | None:
    """Return a PNG of the mean differences (validation.twins) in bins of magnitude; None if there are none."""
    drawn: dict[str, list[Curve]] = {}
    for title, names in PANELS.items():
        for place, name in enumerate(names):
            for kind in KINDS:
                at, each = values(objects, kind, name)
                if len(at):
                    label = f"{kind} {name}" if len(names) > 1 else kind
                    curve = place, kind, label, at, each, *binned(objects, kind, name)
                    drawn.setdefault(title, []).append(curve)
    if not drawn:
        return None
    rows = -(-len(drawn) // COLUMNS)
    figure = Figure(figsize=(11, 3.0 * rows), layout="constrained", dpi=100)
    panels = figure.subplots(rows, COLUMNS, squeeze=False).flat
    for axes, (title, curves) in zip(panels, drawn.items(), strict=False):
        _panel(axes, title, curves)
    for axes in figure.axes[len(drawn) :]:
        axes.set_visible(False)
    return png(figure)


def _panel(axes: Axes, title: str, curves: Sequence[Curve]) -> None:
    """Draw objects as dots, means of all in bins with their errors; far objects may lie beyond the panel."""
    axes.axhline(0.0, color="#999999", linewidth=0.8)
    most = []
    for place, kind, label, at, each, middle, means in curves:
        colour = COLOURS[place]
        shift = 0.06 * (place + (kind == "galaxy") - 0.5)
        axes.plot(at, each, ".", color=colour, markersize=3, alpha=0.35, label=None if len(means) else label)
        value, error = (np.array([getattr(one, key) for one in means]) for key in ("mean", "error"))
        most += [np.percentile(np.abs(each), SHOWN), *(np.abs(value) + error)]
        if len(means):
            axes.errorbar(
                middle + shift,
                value,
                error,
                fmt=KINDS[kind],
                color=colour,
                markersize=5,
                capsize=2,
                label=label,
                markerfacecolor="white" if kind == "galaxy" else colour,
            )
    if max(most) > 0:
        axes.set_ylim(-1.2 * max(most), 1.2 * max(most))
    axes.set(ylabel=f"{title}, variant - base")
    axes.set_xlabel("-2.5 lg electrons" if curves[0][1] == "spectrum" else "true magnitude [AB]")
    axes.ticklabel_format(axis="y", scilimits=(-3, 4), useMathText=True)
    axes.legend(fontsize=8)
