"""Panels of a brick's figure of all bands together: local density, the stellar locus, effects of charge transfer.

Each function draws into `axes` and returns whether there was anything to draw. `result` and `arrays` are those of
validation.validate.validate_brick.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from csstsim.base.shipped import SHIPPED
from csstsim.report.style import BLACK, GREEN, MIN_SOURCES, ORANGE, legend

if TYPE_CHECKING:
    from collections.abc import Mapping
    from typing import Any

    from matplotlib.axes import Axes

    from csstsim.base.types import FloatArray

ROWS = 8  # bins of the number of rows to the amplifier
BRIGHT = 20.0, 500.0  # S/N of the stars that are binned by rows to the amplifier
LOCUS = SHIPPED / "curves" / "sdss_locus.csv"


def density(axes: Axes, result: Mapping[str, Any], arrays: Mapping[str, Any]) -> bool:
    """Draw completeness and purity of the merged catalogue against local density (validation.density)."""
    part = result["density"]
    edges = np.array(part["edges"])
    middle = np.append(0.5 * (edges[:-1] + edges[1:]), 1.25 * edges[-1])  # the last bin has no end
    for all_, selected, tint, marker, label in (
        ("objects", "found", BLACK, "o", "completeness, objects of S/N > 20"),
        ("sources", "real", ORANGE, "s", "purity of sources"),
    ):
        n = np.array(part[all_], float)
        k = np.array(part[selected], float)
        good = n >= MIN_SOURCES
        if good.any():
            fraction = k[good] / n[good]
            error = np.sqrt((k[good] + 1) * (n[good] - k[good] + 1) / (n[good] + 2) ** 2 / (n[good] + 3))  # Laplace
            axes.errorbar(middle[good], fraction, error, color=tint, marker=marker, ms=3, lw=1.2, label=label)
    axes.set(ylim=(0.5, 1.02), xlabel="objects around [arcmin$^{-2}$]", ylabel="fraction")
    axes.set_title("Merged catalogue by local density (not evaluated)", fontsize=10)
    return legend(axes, loc="lower left")


def locus(axes: Axes, result: Mapping[str, Any], arrays: Mapping[str, Any]) -> bool:
    """Draw stars' true and measured g-r and r-i over the published stellar locus, which is in SDSS's bands."""
    colour = arrays["locus"]
    axes.set_title("Stars at S/N > 20 in g, r, i", fontsize=10)
    if not colour["bands"]:
        return False
    _, g_r, r_i, _ = np.loadtxt(LOCUS, delimiter=",", skiprows=2).T
    for name, marker, tint in (("input", "o", BLACK), ("output", "+", GREEN)):
        label = "true" if name == "input" else "measured"
        axes.plot(*colour[name], marker, ls="", color=tint, ms=5, mfc="none", mew=0.8, label=label)
    axes.plot(g_r, r_i, "-", color="#888888", lw=4, alpha=0.5, label="SDSS locus (Covey et al. 2007)", zorder=0)
    axes.set(xlim=(-0.6, 2.0), ylim=(-0.4, 2.2), xlabel="g - r [AB mag]", ylabel="r - i [AB mag]")
    return legend(axes, loc="upper left") and len(colour["output"][0]) >= MIN_SOURCES


def rows(axes: Axes, result: Mapping[str, Any], arrays: Mapping[str, Any]) -> bool:
    """Draw stars' position and flux residuals against the number of rows to the amplifier."""
    parts: dict[str, list[FloatArray]] = {name: [] for name in ("snr", "transfers", "deferred_mas", "light")}
    for table in arrays["trials"].values():
        good = (table["sound"] > 0) & ~table["galaxy"].astype(bool)
        good &= (table["snr"] > BRIGHT[0]) & (table["snr"] < BRIGHT[1])
        for name in parts:
            parts[name].append(table[name][good])
    stars = {name: np.concatenate(values) if values else np.zeros(0) for name, values in parts.items()}
    edges = np.linspace(0, max(stars["transfers"].max(initial=0.0), 1.0), ROWS + 1)
    which = np.digitize(stars["transfers"], edges[1:-1])
    for name, unit, tint, label in (
        ("deferred_mas", 1.0, BLACK, "position, away from the amplifier [mas]"),
        ("light", 100.0, ORANGE, "flux, out / in - 1 [%]"),
    ):
        off = stars[name] - (1.0 if name == "light" else 0.0)
        bins = [off[which == k] for k in range(ROWS)]
        good = [k for k in range(ROWS) if len(bins[k]) >= MIN_SOURCES]
        if good:
            y = [unit * np.median(bins[k]) for k in good]
            error = [unit * 1.2533 * np.std(bins[k]) / np.sqrt(len(bins[k])) for k in good]
            axes.errorbar(0.5 * (edges[1:] + edges[:-1])[good], y, error, color=tint, marker="o", ms=4, label=label)
    axes.axhline(0.0, color="#666666", lw=0.8)
    axes.set(ylim=(-6, 6), xlabel="rows to the amplifier", ylabel="out - in, median")
    axes.set_title("Stars of S/N 20 to 500, all bands", fontsize=10)
    return legend(axes, loc="upper left")


PANELS = locus, density, rows
