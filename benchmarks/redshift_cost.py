"""The picture of redshifts.py: what more galaxies, and neighbours subtracted, give and cost.

The left panel has the error of completeness and purity, which falls with the root of the number of galaxies. The right
one has their values, by magnitude, for several sets of spectra.
"""

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

COLORS = "#2a6f97", "#d1495b", "#edae49", "#66a182"
COUNTS = np.array([300.0, 1000.0, 3000.0, 1e4, 3e4, 1e5])


def draw(path: Path, results: dict[str, dict[str, Any]], galaxy: float, band: str) -> None:
    """Draw scores {label: those of budget.redshift.scores}, with the CPU seconds of a galaxy."""
    drawn = Figure(figsize=(11, 4.2), layout="constrained")
    cost, values = drawn.subplots(1, 2)
    first = next(iter(results.values()))["all"]
    share = max(first["good"], 1) / first["objects"]
    for name, color, of in (("completeness", COLORS[0], 1.0), ("purity", COLORS[1], share)):
        error = np.sqrt(first[name] * (1 - first[name]) / (COUNTS * of))
        cost.loglog(COUNTS * galaxy / 3600, error, "o-", color=color, label=name, ms=4)
        for n, e in zip(COUNTS, error, strict=True):
            if name == "purity":
                where = n * galaxy / 3600, e
                cost.annotate(f"{n:.0g}".replace("e+0", "e"), where, (0, 6), textcoords="offset points", fontsize=8)
    done = first["objects"] * galaxy / 3600
    cost.axvline(done, color="0.6", lw=0.8)
    cost.annotate(
        "done", (done, 0.98), xycoords=("data", "axes fraction"), fontsize=8, rotation=90, va="top", ha="right"
    )
    cost.set(xlabel="CPU-hours", ylabel="statistical error", title="numbers: galaxies")
    cost.legend()
    for (label, one), color in zip(results.items(), COLORS, strict=False):
        classes = one["magnitude"]
        middle = [(part["low"] + part["high"]) / 2 for part in classes]
        for name, style in (("completeness", "o-"), ("purity", "s:")):
            y, off = (np.array([part[key] for part in classes], float) for key in (name, f"{name}_err"))
            values.errorbar(
                middle, y, off, fmt=style, color=color, ms=4, capsize=2, lw=1,
                label=f"{label}: {name}" if name == "completeness" else None,
            )  # fmt: skip
    values.set(
        xlabel=f"{band} [AB]",
        ylim=(0, 1.05),
        title="full: completeness, dotted: purity",
    )
    values.legend(fontsize=8)
    drawn.savefig(path, dpi=110)
