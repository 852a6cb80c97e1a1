"""The speed-accuracy chart: visible error against cost, with the Pareto front; presets and peers are marked.

A point is the median over objects; a thin bar extends from it to the 95th percentile. The chart shows the summaries of
runs (bench.summary), one column per filter, with common axes for imaging and dispersed light.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from matplotlib.figure import Figure
from matplotlib.transforms import Bbox

from csstsim.base.files.atomic import atomic_path
from csstsim.base.types import PathLike
from csstsim.studies.bench.summary import KINDS

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.text import Annotation

ON_NODES = "direct optics, on nodes"
ERROR_MIN = 1e-6  # smaller errors are shown as this
_LABEL_DISTANCE = 0.3, 0.13  # decades of cost and error: closer methods of one colour have a common label
_OFFSETS = [(x, y) for y in (6, -15, 20, -29, 34, -43) for x in (8, -8)]  # of a label from its point [pt], best first
_CSSTSIM_METHODS = ("reference", "photons", "stamps", "slabs")
_PRESET_METHODS = ("preview", "standard", "noise_free")
OURS = "#0b6e99"
PEERS = "#b5542d"
PRESET = "#1a7a3c"


class Point(NamedTuple):
    """A method's median CPU seconds and visible error over objects on nodes, and the error's 95th percentile.

    The median error is an upper `limit` if it is less than twice the error expected from chance alone.
    """

    cost: float
    error: float
    high: float
    limit: bool


def points(lines: Iterable[Mapping[str, Any]], kind: str) -> dict[str, Point]:
    """Return the Point of each method."""
    return {
        line["method"]: Point(
            1e-6 * line["cpu_us"],
            max(line["visible_median"], ERROR_MIN),
            max(line["visible_95"], ERROR_MIN),
            line["limit"],
        )
        for line in lines
        if (line["kind"], line["against"]) == (kind, ON_NODES) and np.isfinite(line["visible_median"])
    }


def pareto(methods: Mapping[str, Point]) -> list[str]:
    """Return the methods that no other beats in both cost and error, by rising cost."""
    front: list[str] = []
    lowest = np.inf
    for name, point in sorted(methods.items(), key=_cost_and_error):
        if point.error < lowest:
            front.append(name)
            lowest = point.error
    return front


def _cost_and_error(item: tuple[str, Point]) -> tuple[float, float]:
    _, point = item
    return point.cost, point.error


def draw_chart(path: PathLike, tables: Sequence[Sequence[Mapping[str, Any]]]) -> None:
    """Write the chart (PNG). tables: one list of bench.summary.summarise per filter."""
    kinds = [kind for kind in KINDS if any(line["kind"] == kind for lines in tables for line in lines)]
    figure = Figure(figsize=(2 + 5.2 * len(tables), 1 + 4 * len(kinds)), layout="constrained")
    axes = figure.subplots(len(kinds), len(tables), sharex=True, sharey="row", squeeze=False)
    all_points = [point for lines in tables for kind in kinds for point in points(lines, kind).values()]
    costs = np.array([point.cost for point in all_points] or [1.0])
    for row, kind in zip(axes, kinds, strict=True):
        of_kind = [point for lines in tables for point in points(lines, kind).values()]
        errors = np.array([(point.error, point.high) for point in of_kind] or [(1.0, 1.0)])
        for axis, lines in zip(row, tables, strict=True):
            on_nodes = [line for line in lines if (line["kind"], line["against"]) == (kind, ON_NODES)]
            objects = max((int(line["objects"]) for line in on_nodes), default=0)
            first, *_ = lines
            axis.set(xscale="log", yscale="log", title=f"{KINDS[kind]}, {first['filter']} ({objects} objects)")
            _panel(axis, points(lines, kind))
        left, *_ = row
        left.set_ylim(min(errors.min() / 3, 0.03), max(errors.max() * 3, 1.0))
    axes[0, 0].set_xlim(costs.min() / 8, costs.max() * 30)
    figure.supxlabel("CPU seconds per object (one core)")
    figure.supylabel("error against direct optics [the object's own noise]")
    figure.suptitle(
        "Medians of objects on nodes of the PSF set; bars end at the 95th percentile. Blue: methods, green: presets,\n"
        "red: peers; filled and joined: no method is both faster and better. Triangles: medians are upper limits, set\n"
        "by the number of electrons drawn. Grey: what the standard preset allows, a tenth of the object's own noise.",
        size=9.5,
    )
    figure.draw_without_rendering()  # computes the layout, on which the positions of labels depend
    for row, kind in zip(axes, kinds, strict=True):
        for axis, lines in zip(row, tables, strict=True):
            if methods := points(lines, kind):
                _label(axis, methods)
    with atomic_path(path) as temporary:
        figure.savefig(temporary, dpi=100)


def _panel(axis: Axes, methods: Mapping[str, Point]) -> None:
    """Draw the methods of one panel."""
    front = pareto(methods)
    axis.axhspan(1e-7, 0.1, color="0.95", zorder=0)
    axis.plot(*np.array([methods[name][:2] for name in front]).reshape(-1, 2).T, color="0.6", lw=1.2, zorder=1)
    for name, (cost, error, high, limit) in methods.items():
        colour = _colour(name)
        axis.plot([cost, cost], [error, high], "-_", color=colour, lw=0.9, ms=6, markevery=[1], alpha=0.7, zorder=2)
        marker = "v" if limit else {OURS: "o", PEERS: "s", PRESET: "*"}[colour]
        filled = colour if name in front else "white"
        size = 170 if marker == "*" else 75
        axis.scatter(cost, error, s=size, marker=marker, facecolor=filled, edgecolor=colour, lw=1.5, zorder=3)
    axis.grid(color="0.9", lw=0.5)


def _colour(method: str) -> str:
    return OURS if method.startswith(_CSSTSIM_METHODS) else PRESET if method in _PRESET_METHODS else PEERS


def _join_names(names: Sequence[str]) -> str:
    """Return the names in a line, a common stem of numbered ones written once: slabs 1, 2."""
    words = []
    for name in names:
        stem, _, number = name.rpartition(" ")
        repeated = any(other.rpartition(" ")[0] == stem for other in names[: names.index(name)])
        words.append(number if stem and number.isdigit() and repeated else name)
    return ", ".join(words)


class _Group(NamedTuple):
    """Methods with a common label, and its point: CPU seconds and visible error of the first of them."""

    names: list[str]
    cost: float
    error: float

    @property
    def colour(self) -> str:
        """The colour of all of them."""
        first, *_ = self.names
        return _colour(first)


def _groups(methods: Mapping[str, Point]) -> list[_Group]:
    """Return the groups of methods of one colour that lie close together."""
    groups: list[_Group] = []
    for name, point in sorted(methods.items(), key=lambda item: item[1].cost):
        for group in groups:
            distance = np.abs(np.log10([point.cost / group.cost, point.error / group.error])) < _LABEL_DISTANCE
            if distance.all() and _colour(name) == group.colour:
                group.names.append(name)
                break
        else:
            groups.append(_Group([name], point.cost, point.error))
    return groups


def _label(axis: Axes, methods: Mapping[str, Point]) -> None:
    """Write the names near the methods, each where it overlaps the fewest points, names and edges of the panel."""
    ends = axis.transData.transform(
        [(point.cost, end) for point in methods.values() for end in (point.error, point.high)]
    )
    occupied = [Bbox.from_bounds(x - 7, y - 7, 14, 14) for x, y in ends[::2]]
    bars = zip(ends[::2], ends[1::2], strict=True)
    occupied += [Bbox.from_extents(x - 1, y, x + 1, top) for (x, y), (_, top) in bars]
    for group in _groups(methods):
        candidates: list[tuple[int, int, Annotation, Bbox]] = []
        for x, y in _OFFSETS:
            style: dict[str, Any] = {"textcoords": "offset points", "color": group.colour, "size": 9}
            text = axis.annotate(
                _join_names(group.names), (group.cost, group.error), (x, y), ha="left" if x > 0 else "right", **style
            )
            box = text.get_window_extent()
            text.remove()
            outside = not (axis.bbox.contains(*box.min) and axis.bbox.contains(*box.max))
            candidates.append((box.count_overlaps(occupied) + 5 * outside, len(candidates), text, box))
        *_, text, box = min(candidates, key=lambda item: item[:2])
        axis.add_artist(text)
        occupied.append(box)
