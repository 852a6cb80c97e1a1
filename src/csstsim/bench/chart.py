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
OURS, PEERS, PRESET = "#0b6e99", "#b5542d", "#1a7a3c"


def points(rows, kind, low, high):
    """Return {method: (CPU seconds, visible error, whether that is an upper limit)}: medians over objects on nodes."""
    found = {}
    for method in dict.fromkeys(row["method"] for row in rows):
        mine = [
            row for row in rows
            if (row["method"], row["kind"]) == (method, kind) and low <= row["electrons"] < high
            and row["at_node"] and row["drawn"] > 0
        ]  # fmt: skip
        if mine:
            seen, chance = (np.array([row[f"visible_{w}"] for row in mine]) for w in ("direct", "chance"))
            error = float(np.median(np.maximum(seen, chance)))
            cost = float(np.median([row["cpu_s"] for row in mine]))
            found[method] = cost, max(error, 1e-6), bool(np.median(chance) > np.median(seen))
    return found


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
    figure = Figure(figsize=(11, 8.2), layout="constrained")
    kinds = {method.name: method for method in methods}
    names = list(kinds)
    for axis, (title, *limits) in zip(figure.subplots(2, 2).flat, PANELS, strict=True):
        found = points(rows, *limits)
        front = pareto(found)
        axis.set(xscale="log", yscale="log", title=title)
        axis.axhspan(1e-7, 0.1, color="0.95", zorder=0)
        axis.plot(*np.array([found[name][:2] for name in front]).reshape(-1, 2).T, color="0.6", lw=1.2, zorder=1)
        for name, (cost, error, limit) in found.items():
            method = kinds[name]
            colour = PEERS if method.peer else PRESET if method.preset else OURS
            marker = "v" if limit else "s" if method.peer else "*" if method.preset else "o"
            filled = colour if name in front else "white"
            size = 170 if marker == "*" else 75
            axis.scatter(cost, error, s=size, marker=marker, facecolor=filled, edgecolor=colour, lw=1.5, zorder=3)
            axis.annotate(
                str(names.index(name) + 1), (cost, error), (7, 5), textcoords="offset points", color=colour, size=10
            )
        if found:
            costs, seen = np.array([found[name][:2] for name in found]).T
            axis.set_xlim(costs.min() / 4, costs.max() * 4)
            axis.set_ylim(min(seen.min() / 3, 0.03), max(seen.max() * 3, 1.0))
        axis.grid(color="0.9", lw=0.5)
    figure.supxlabel("CPU seconds an object (one core)")
    figure.supylabel("error against direct optics [the object's own noise]")
    middle = len(names) // 2 + 1
    numbered = [f"{i} {name}" for i, name in enumerate(names, 1)]
    lines = ["     ".join(part) for part in (numbered[:middle], numbered[middle:])]
    key = "Blue: methods, green: presets, red: peers. Filled: nothing is both faster and better; v: upper limit"
    figure.suptitle("\n".join([*lines, f"{note}. {key}"]), size=9.5)
    with atomic_path(path) as temporary:
        figure.savefig(temporary, dpi=110)
