"""Star counts of the embedded Galaxy beside the anchors, and its figures: python benchmarks/star_counts.py [folder]

Counts are expectations for V without extinction; the bricks of the figures are drawn ones.
"""

import sys
import time
from functools import partial
from pathlib import Path

import healpy
import numpy as np
from matplotlib import pyplot as plt

from csstsim.config import SHIPPED
from csstsim.instrument.load import read_data
from csstsim.rng import stream
from csstsim.universe.bricks import AREA_DEG2, NSIDE, place
from csstsim.universe.milky_way import equatorial
from csstsim.universe.stars import draw_stars, expected_counts, galaxy

ANCHORS = {18: 9e2, 20: 2e3, 22: 4e3, 24: 8e3, 26: 1.5e4}  # deg-2 at the pole, round numbers
FACTORS = {90: 1, 49: None, 30: 3, 15: 10}
LONGITUDES = np.arange(0, 360, 30)


def main(folder="docs/figures"):
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    numbers = read_data(SHIPPED / "universe" / "stars.yaml")
    start = time.process_time()
    galaxy(numbers)
    print(f"set-up {time.process_time() - start:.2f} CPU-s")
    table(numbers)
    stars = {b: brick(numbers, 90, b) for b in FACTORS}
    counts_figure(numbers, folder / "star_counts.png")
    kiel_figure(numbers, folder / "star_kiel.png")
    temperature_figure(stars, folder / "star_temperatures.png")


def table(numbers):
    print("stars per deg2 brighter than V: l = 90 [mean over l]; (ratio to the anchor)")
    print("   b " + "".join(f"{f'V < {v}':>27s}" for v in ANCHORS))
    for b, factor in FACTORS.items():
        cells = []
        for v, anchor in ANCHORS.items():
            here = expected_counts(*equatorial(90, b), numbers, v)
            mean = expected_counts(*equatorial(LONGITUDES, b), numbers, v).mean()
            ratio = f"({here / (anchor * factor):4.2f})" if factor else ""
            cells.append(f"{here:11.0f} [{mean:7.0f}] {ratio:6s}")
        print(f"{b:4d} " + "".join(cells))


def brick(numbers, l, b):  # noqa: E741
    pix = healpy.ang2pix(NSIDE, *map(float, equatorial(l, b)), nest=True, lonlat=True)
    start = time.process_time()
    stars = draw_stars(lambda name: stream(1, "brick", pix, name), pix, partial(place, pix), numbers)
    took = time.process_time() - start
    print(f"brick {pix} at l = {l}, b = {b}: {len(stars['ra'])} stars, {took:.2f} CPU-s")
    return stars


def counts_figure(numbers, path):
    v = np.arange(13, 28.01, 0.5)
    _, ax = plt.subplots(figsize=(6, 4.5))
    for (b, factor), colour in zip(FACTORS.items(), ("C0", "C1", "C2", "C3"), strict=True):
        at = [equatorial(l, b) for l in LONGITUDES]
        n = np.array([[expected_counts(*place_, numbers, m) for m in v] for place_ in at])
        ax.semilogy(v, n[LONGITUDES == 90][0], colour, label=f"b = {b}, l = 90 (all l shaded)")
        ax.fill_between(v, n.min(axis=0), n.max(axis=0), color=colour, alpha=0.15, lw=0)
        if factor:
            ax.plot(list(ANCHORS), factor * np.array(list(ANCHORS.values())), "o", color=colour, mfc="none")
    ax.set(xlabel="V [mag], no extinction", ylabel="stars brighter than V [deg$^{-2}$]")
    ax.set_title("Lines: the Galaxy's model; circles: anchors", fontsize=10)
    ax.legend(fontsize=8)
    ax.figure.tight_layout()
    ax.figure.savefig(path, dpi=130)


def kiel_figure(numbers, path):
    many = [brick(numbers, l, b) for l, b in ((90, 15), (45, 20), (0, 30), (180, 30), (90, 60), (0, 60))]
    teff, logg, feh = (np.concatenate([s[name] for s in many]) for name in ("teff", "logg", "feh"))
    order = np.argsort(-feh)
    _, ax = plt.subplots(figsize=(6.5, 6))
    dots = ax.scatter(
        teff[order], logg[order], c=feh[order], s=1.5, cmap="viridis", vmin=-2.5, vmax=0.3, rasterized=True
    )
    ax.set(xscale="log", xlim=(40000, 1800), ylim=(9, -0.5), xlabel="Teff [K]", ylabel="log g")
    ax.set_xticks(
        [30000, 20000, 10000, 6000, 4000, 3000, 2000],
        labels=["30000", "20000", "10000", "6000", "4000", "3000", "2000"],
    )
    ax.minorticks_off()
    ax.figure.colorbar(dots, label="[Fe/H]")
    ax.figure.tight_layout()
    ax.figure.savefig(path, dpi=130)


def temperature_figure(stars, path):
    _, axes = plt.subplots(1, 2, figsize=(10, 4))
    for b, s in stars.items():
        v = 5 * np.log10(s["distance"] / 10) - 5 * np.log10(s["radius"]) - 10 * np.log10(s["teff"] / 5772) + 4.74
        for ax, keep in zip(axes, (v < 19, v >= 19), strict=True):
            ax.hist(
                np.log10(s["teff"][keep]), np.arange(3.2, 4.5, 0.02), histtype="step", density=True, label=f"b = {b}"
            )
    for ax, title in zip(axes, ("bolometric magnitude < 19", "fainter"), strict=True):
        ax.set(xlabel="log Teff [K]", title=title)
        ax.legend(fontsize=8)
    axes[0].figure.tight_layout()
    axes[0].figure.savefig(path, dpi=130)


if __name__ == "__main__":
    main(*sys.argv[1:])
