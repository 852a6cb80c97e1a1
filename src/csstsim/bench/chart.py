"""The speed-accuracy chart: cost against visible error, the Pareto front drawn, presets and peers marked."""

import numpy as np
from matplotlib.figure import Figure

from csstsim.atomic import atomic_path

FAINT, MIDDLE, BRIGHT = 1e2, 1e4, 1e6  # electrons
PANELS = (
    ("stars, 10$^2$ to 10$^4$ e$^-$", "star", FAINT, MIDDLE),
    ("stars, 10$^4$ to 10$^6$ e$^-$", "star", MIDDLE, BRIGHT),
    ("galaxies, 10$^2$ to 10$^4$ e$^-$", "galaxy", FAINT, MIDDLE),
    ("galaxies, 10$^4$ to 10$^6$ e$^-$", "galaxy", MIDDLE, BRIGHT),
)
_NEAR, _LONG = (0.25, 0.12), 1.6  # decades: of cost and error, where methods share a label; of cost, how long one is
OURS, PEERS, PRESET = "#0b6e99", "#b5542d", "#1a7a3c"


def points(rows, kind, low, high):
    """Return {method: (CPU seconds, visible error, whether that is an upper limit)}: medians over objects on nodes.

    A limit: what is seen is less than twice what chance alone would show.
    """
    found = {}
    for method in dict.fromkeys(row["method"] for row in rows):
        if mine := _chosen(rows, method, kind, low, high):
            seen, chance = (np.array([row[f"visible_{w}"] for row in mine]) for w in ("direct", "chance"))
            error = float(np.median(np.maximum(seen, chance)))
            cost = float(np.median([row["cpu_s"] for row in mine]))
            found[method] = cost, max(error, 1e-6), bool(np.median(seen) < 2 * np.median(chance))
    return found


def _chosen(rows, method, kind, low, high):
    return [
        row for row in rows
        if (row["method"], row["kind"]) == (method, kind) and low <= row["electrons"] < high
        and row["at_node"] and row["drawn"] > 0
    ]  # fmt: skip


def pareto(found):
    """Return the methods no other beats in both cost and error, by rising cost."""
    front, best = [], np.inf
    for name, (_, error, _) in sorted(found.items(), key=lambda item: item[1][:2]):
        if error < best:
            front.append(name)
            best = error
    return front


def draw_chart(path, rows, methods, note):
    """Write the chart (PNG). `methods`: the bench.methods.Method whose rows these are; `note`: a line below it."""
    figure = Figure(figsize=(12, 9), layout="constrained")
    kinds = {method.name: method for method in methods}
    every = [point for _, *limits in PANELS for point in points(rows, *limits).values()]
    for axis, (title, *limits) in zip(figure.subplots(2, 2, sharex=True).flat, PANELS, strict=True):
        found = points(rows, *limits)
        front = pareto(found)
        number = max((len(_chosen(rows, name, *limits)) for name in found), default=0)
        axis.set(xscale="log", yscale="log", title=f"{title} ({number} objects)")
        axis.axhspan(1e-7, 0.1, color="0.95", zorder=0)
        axis.plot(*np.array([found[name][:2] for name in front]).reshape(-1, 2).T, color="0.6", lw=1.2, zorder=1)
        for name, (cost, error, limit) in found.items():
            method = kinds[name]
            marker = "v" if limit else "s" if method.peer else "*" if method.preset else "o"
            filled = _colour(method) if name in front else "white"
            size = 170 if marker == "*" else 75
            axis.scatter(
                cost, error, s=size, marker=marker, facecolor=filled, edgecolor=_colour(method), lw=1.5, zorder=3
            )
        for names, place, free in _labels(found):
            how = {"textcoords": "offset points", "color": _colour(kinds[names[0]]), "size": 9}
            axis.annotate(", ".join(names), place, (8 if free else -9, 6), ha="left" if free else "right", **how)
        if found:
            costs, seen = (np.array([point[i] for point in every]) for i in (0, 1))
            axis.set_xlim(costs.min() / 50, costs.max() * 100)
            seen = np.array([point[1] for point in found.values()])
            axis.set_ylim(min(seen.min() / 3, 0.03), max(seen.max() * 3, 1.0))
        axis.grid(color="0.9", lw=0.5)
    figure.supxlabel("CPU seconds an object (one core)")
    figure.supylabel("error against direct optics [the object's own noise]")
    figure.suptitle(
        f"{note}. Medians of objects on nodes of the PSF set. Blue: methods, green: presets, red: peers; filled and "
        "joined: nothing is both faster and better.\nTriangles: upper limits, set by the number of electrons drawn. "
        "Grey: what the standard preset allows, a tenth of the object's own noise.", size=9.5,
    )  # fmt: skip
    with atomic_path(path) as temporary:
        figure.savefig(temporary, dpi=110)


def _colour(method):
    return PEERS if method.peer else PRESET if method.preset else OURS


def _labels(found):
    """Return [(names, place, free)]: methods that share a place in the chart share a label; it stands to the left where
    it would run into the next one's, not `free`."""
    groups = []
    for name, (cost, error, _) in sorted(found.items(), key=lambda item: item[1][0]):
        for names, place in groups:
            if abs(np.log10(cost / place[0])) < _NEAR[0] and abs(np.log10(error / place[1])) < _NEAR[1]:
                names.append(name)
                break
        else:
            groups.append(([name], (cost, error)))
    places = np.log10([place for _, place in groups])
    free = [
        not ((places[:, 0] > x) & (places[:, 0] < x + _LONG) & (np.abs(places[:, 1] - y) < _NEAR[1])).any()
        for x, y in places
    ]
    return [(*group, room) for group, room in zip(groups, free, strict=True)]
