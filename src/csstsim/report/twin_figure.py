"""The figure of a variant: what it measures less what its base does, against magnitude."""

import numpy as np
from matplotlib.figure import Figure

from csstsim.bricks.twins import binned
from csstsim.report.figures import png
from csstsim.report.style import BLUE, VERMILION

PANELS = {
    "magnitude [mag]": ("mag",), "place [px]": ("x", "y"), "ln size": ("size",), "ellipticity": ("e1", "e2"),
    "corrected shape": ("g1", "g2"), "electrons of spectra": ("spectrum",),
}  # fmt: skip
COLOURS = BLUE, VERMILION
KINDS = {"star": "o", "galaxy": "s", "spectrum": "D"}


def twin_figure(objects):
    """Return a PNG of the mean differences of objects (bricks.twins) in bins of magnitude; None if there are none."""
    drawn = {}
    for title, names in PANELS.items():
        for place, name in enumerate(names):
            for kind in KINDS:
                at, means = binned(objects, kind, name)
                if len(means):
                    drawn.setdefault(title, []).append((place, name if len(names) > 1 else "", kind, at, means))
    if not drawn:
        return None
    rows = -(-len(drawn) // 3)
    figure = Figure(figsize=(11, 3.0 * rows), layout="constrained", dpi=100)
    panels = figure.subplots(rows, min(len(drawn), 3), squeeze=False).flat
    for axes, (title, curves) in zip(panels, drawn.items(), strict=False):
        axes.axhline(0.0, color="#999999", linewidth=0.8)
        for place, name, kind, at, means in curves:
            style = {"fmt": KINDS[kind], "color": COLOURS[place], "markersize": 4, "capsize": 2}
            open_ = {"markerfacecolor": "white"} if kind == "galaxy" else {}
            value, error = (np.array([getattr(one, key) for one in means]) for key in ("mean", "error"))
            shift = 0.06 * (place + (kind == "galaxy") - 0.5)
            axes.errorbar(at + shift, value, error, label=f"{kind} {name}".strip(), **style, **open_)
        axes.set(ylabel=f"{title}, variant - base")
        axes.set_xlabel("-2.5 lg electrons" if curves[0][2] == "spectrum" else "true magnitude [AB]")
        axes.ticklabel_format(axis="y", scilimits=(-3, 4), useMathText=True)
        axes.legend(fontsize=8)
    for axes in figure.axes[len(drawn) :]:
        axes.set_visible(False)
    return png(figure)
