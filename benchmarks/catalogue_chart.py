"""Chart of benchmarks/catalogue_codes.py: completeness, false sources and errors of each code against its CPU time."""

from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from csstsim.base.files.atomic import atomic_path
from csstsim.studies.bench.chart import OURS, PEERS

MARKERS = "osD^vPX"  # one a code
# Title, label of the axis, whether it is logarithmic, rows: (how a row's name begins, whether it is of galaxies)
PANELS = (
    (
        "isolated objects of S/N > 5: more is better", "found [%]", False,
        (("points, S/N > 5 ", False), ("galaxies, S/N > 5 ", True)),
    ),
    (
        "detections of claimed S/N > 5: fewer is better", "without a true object", True,
        (("false, claimed S/N > 5", None),),
    ),
    (
        "magnitude, S/N > 20: nearer to 0 is better", "median of measured - true [mag]", False,
        (("stars: magnitude bias", False), ("galaxies: magnitude bias", True)),
    ),
    (
        "position, S/N > 20: less is better", "median error [mas]", True,
        (("stars: position error", False), ("galaxies: position error", True)),
    ),
)  # fmt: skip


def draw(path, columns):
    """Write the chart (PNG). columns: {code: {"cost", "scores"}}, csstsim first."""
    figure = Figure(figsize=(10, 7.6), layout="constrained")
    axes = figure.subplots(2, 2, sharex=True)
    style = {code: (MARKERS[k % len(MARKERS)], PEERS if k else OURS) for k, code in enumerate(columns)}
    for axis, (title, label, logarithmic, rows) in zip(axes.ravel(), PANELS, strict=True):
        for code, column in columns.items():
            marker, colour = style[code]
            for start, galaxy in rows:
                value = next((row["value"] for name, row in column["scores"].items() if name.startswith(start)), None)
                if value is not None:
                    face = "white" if galaxy else colour
                    where = column["cost"]["cpu"], value or int(logarithmic)  # a count of 0 stands at 1
                    axis.scatter(*where, s=80, c=face, marker=marker, edgecolors=colour, lw=1.5, zorder=3)
        axis.set(xscale="log", title=title, ylabel=label)
        if logarithmic:
            axis.set_yscale("log")
            _decades(axis.yaxis, [float(dot.get_offsets()[0, 1]) for dot in axis.collections])
        axis.grid(color="0.9", lw=0.5, which="both")
    axes[1, 0].axhline(0.0, color="0.6", lw=1.0)
    _decades(axes[0, 0].xaxis, [column["cost"]["cpu"] for column in columns.values()])
    figure.supxlabel("CPU seconds for the calibrated chip (one core)")
    names = [_mark(marker, colour, colour, code) for code, (marker, colour) in style.items()]
    kinds = [_mark("o", "0.3", "0.3", "point sources, or all"), _mark("o", "0.3", "white", "galaxies")]
    figure.legend(handles=names + kinds, loc="outside upper center", ncols=5, frameon=False)
    with atomic_path(path) as temporary:
        figure.savefig(temporary, dpi=100, format="png")


def _decades(axis, values):
    """Give a logarithmic axis limits about its values, and ticks at 1, 2, 5 of each decade."""
    low, high = min(values) / 1.6, max(values) * 1.6
    ticks = [d * 10.0**k for k in range(-3, 6) for d in (1, 2, 5) if low < d * 10.0**k < high]
    axis.set_ticks(ticks, [f"{tick:g}" for tick in ticks])
    axis.set_ticks([], minor=True)
    axis.axes.set(**{f"{axis.axis_name}lim": (low, high)})


def _mark(marker, colour, face, label):
    return Line2D([], [], ls="", marker=marker, color=colour, markerfacecolor=face, ms=8, mew=1.5, label=label)
