"""The figure of scene_needs.py and the tables of docs/model_no_more.md."""

import matplotlib
import numpy as np

from csstsim.report.style import BLUE, GREEN, ORANGE, PURPLE

matplotlib.use("agg")
from matplotlib import pyplot as plt

KINDS = ("stars", "galaxies", "first orders")
FIELDS = (
    "chip", "filter", "size", "whole", "effect", "kind", "yaml", "cost", "rms", "largest", "light",
    *(f"{kind} {what}" for kind in KINDS for what in ("light", "size", "e")), *KINDS,
)  # fmt: skip
LOOKS = {  # of a kind of effect: colour, marker, name
    "off": (BLUE, "o", "in the default"), "noise": (ORANGE, "D", "noise, in the default"),
    "on": (GREEN, "s", "not in the default"), "draw": (PURPLE, "^", "way to draw"),
}  # fmt: skip
LEAST, SCATTER = 0.003, 0.4  # e-, below which a change is drawn at the edge; CPU s by which times of two runs differ


def by_chip(rows):
    """Return the rows of each chip."""
    return {chip: [row for row in rows if row["chip"] == chip] for chip in dict.fromkeys(row["chip"] for row in rows)}


def draw(rows, path):
    """Draw cost against change, one dot an effect, one panel a chip."""
    chips = by_chip(rows)
    figure, panels = plt.subplots(1, len(chips), figsize=(6.6 * len(chips), 7.4), layout="constrained", squeeze=False)
    for axes, (chip, mine) in zip(panels[0], chips.items(), strict=True):
        mine = [row for row in mine if np.isfinite(row["cost"])]
        axes.set(xscale="symlog", yscale="log", title=f"chip {chip}, {mine[0]['filter']}")
        axes.set_xscale("symlog", linthresh=SCATTER)
        costs, heights = [row["cost"] for row in mine], [max(row["rms"], LEAST) for row in mine]
        axes.axvspan(-SCATTER, SCATTER, color="0.93", label="two runs differ by this")
        for kind, (colour, marker, name) in LOOKS.items():
            some = [k for k, row in enumerate(mine) if row["kind"] == kind]
            axes.plot([costs[k] for k in some], [heights[k] for k in some], marker, color=colour, ms=6, label=name)
        axes.set_xlim(-1.4 * SCATTER, max(*costs, SCATTER) * 4)
        axes.set_ylim(LEAST / 2, max(heights) * 3)
        axes.set(xlabel="cost [CPU-seconds; left of 0: it saves]", ylabel="rms change of a pixel [electrons]")
        _labels(axes, mine, costs, heights)
        axes.grid(alpha=0.25)
    panels[0][0].legend(fontsize=8, loc="lower right")
    figure.savefig(path, dpi=90)
    print(path, path.stat().st_size // 1000, "kB")


def _labels(axes, rows, costs, heights):
    """Write each effect's name beside its dot, moved up or down until it covers no other name and no dot."""
    figure = axes.figure
    figure.canvas.draw()
    pixels = axes.transData.transform(np.column_stack([costs, heights]))
    taken = [(x - 4, x + 4, y - 4, y + 4) for x, y in pixels]  # the dots
    for k in np.argsort(pixels[:, 1]):
        text = rows[k]["effect"]
        width, tall = 5.4 * len(text) * figure.dpi / 100, 11.5 * figure.dpi / 100
        right = pixels[k, 0] + width + 10 < axes.bbox.x1
        x0 = pixels[k, 0] + 7 if right else pixels[k, 0] - 7 - width
        for step in sorted(range(-14, 15), key=abs):
            y = pixels[k, 1] + 0.75 * step * tall
            box = x0, x0 + width, y - tall / 2, y + tall / 2
            free = all(box[1] < o[0] or box[0] > o[1] or box[3] < o[2] or box[2] > o[3] for o in taken)
            if free and axes.bbox.y0 + tall / 2 < y < axes.bbox.y1 - tall / 2:
                break
        taken.append(box)
        colour, at = LOOKS[rows[k]["kind"]][0], ((7 if right else -7), y - pixels[k, 1])
        line = {"arrowstyle": "-", "lw": 0.5, "color": colour, "shrinkA": 0, "shrinkB": 2} if abs(step) > 1 else None
        axes.annotate(
            text, (costs[k], heights[k]), (at[0] * 72 / figure.dpi, at[1] * 72 / figure.dpi), fontsize=7.5,
            color=colour, textcoords="offset points", ha="left" if right else "right", va="center", arrowprops=line,
        )  # fmt: skip


def _number(value, digits=2):
    """Return a value for the table: empty for what is not defined, 0 below what matters."""
    if value is None or value == "" or not np.isfinite(value):
        return ""
    return "0" if abs(value) < 1e-4 else f"{value:,.0f}" if abs(value) >= 10 else f"{value:.{digits}g}"


def table(rows: list[dict]) -> tuple[list[str], list[list[str]]]:
    """Return the header and the rows of one chip's table."""
    names = [(kind, what) for kind in KINDS for what in ("light", "size", "e")]
    whats = [name for name in names if np.isfinite(rows[0].get(" ".join(name), np.nan))]
    units = {"light": "light [%]", "size": "size [%]", "e": "e"}
    head = ["effect", "line of YAML", "CPU-s", "rms [e-]", "largest [e-]", "total light [%]"]
    head += [f"{kind}: {units[what]}" for kind, what in whats]
    lines = []
    for row in rows:
        cost = f"{row['cost']:+.2f}" if np.isfinite(row["cost"]) else ""
        values = [_number(row[name]) for name in ("rms", "largest", "light", *map(" ".join, whats))]
        lines.append([row["effect"], f"`{row['yaml']}`", cost, *values])
    return head, lines
