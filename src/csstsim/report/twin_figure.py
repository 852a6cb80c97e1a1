"""The figure of a variant: what it measures less what its base does, against magnitude."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

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


class Curve(NamedTuple):
    """Differences of a quantity and kind: mag, difference (n,) of objects; middle (k,) [mag] and means of bins."""

    number: int  # of the quantity in its panel
    kind: str
    label: str
    mag: FloatArray
    difference: FloatArray
    middle: FloatArray
    means: list[Mean]


def twin_figure(objects: Sequence[Mapping[str, Any]]) -> bytes | None:
    """Return a PNG of the mean differences (validation.twins) in bins of magnitude; None if there are none."""
    drawn: dict[str, list[Curve]] = {}
    for title, names in PANELS.items():
        for number, name in enumerate(names):
            for kind in KINDS:
                mag, difference = values(objects, kind, name)
                if len(mag):
                    label = f"{kind} {name}" if len(names) > 1 else kind
                    curve = Curve(number, kind, label, mag, difference, *binned(objects, kind, name))
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
    """Draw objects as dots, means of all in bins with their errors; outliers may lie beyond the panel."""
    axes.axhline(0.0, color="#999999", linewidth=0.8)
    extents = []
    for number, kind, label, mag, difference, middle, means in curves:
        colour = COLOURS[number]
        shift = 0.06 * (number + (kind == "galaxy") - 0.5)
        axes.plot(mag, difference, ".", color=colour, markersize=3, alpha=0.35, label=None if len(means) else label)
        value, error = (np.array([getattr(one, key) for one in means]) for key in ("mean", "error"))
        extents += [np.percentile(np.abs(difference), SHOWN), *(np.abs(value) + error)]
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
    if max(extents) > 0:
        axes.set_ylim(-1.2 * max(extents), 1.2 * max(extents))
    axes.set(ylabel=f"{title}, variant - base")
    axes.set_xlabel("-2.5 lg electrons" if curves[0].kind == "spectrum" else "true magnitude [AB]")
    axes.ticklabel_format(axis="y", scilimits=(-3, 4), useMathText=True)
    axes.legend(fontsize=8)
