"""Star counts of the embedded Galaxy against published anchors, and figures.

    python benchmarks/star_counts.py [folder of the figures, docs/figures if not given]

Counts are expected values for V without extinction; the other figures show drawn bricks, at l = 90 deg unless stated.
"""

import argparse
import sys
import time
from functools import partial
from pathlib import Path

import healpy
import numpy as np
from matplotlib.figure import Figure

from csstsim.base.healpix import NSIDE
from csstsim.base.rng import stream
from csstsim.base.shipped import SHIPPED
from csstsim.catalog.truth_bricks import place
from csstsim.instrument.load import read_data
from csstsim.report.style import BLUE, GREEN, ORANGE, VERMILION
from csstsim.universe.stars.milky_way import equatorial
from csstsim.universe.stars.stars import draw_stars, expected_counts, galaxy

ANCHORS = {18: 9e2, 20: 2e3, 22: 4e3, 24: 8e3, 26: 1.5e4}  # deg-2 at the pole, round numbers
FACTORS = {90: 1, 49: None, 30: 3, 15: 10}  # {latitude: factor on the anchors}
COLOURS = (BLUE, ORANGE, GREEN, VERMILION)
LONGITUDES = np.arange(0, 360, 30)
KIEL = ((90, 15), (45, 20), (0, 30), (180, 30), (90, 60), (0, 60))  # l, b of the bricks shown


def report_counts(numbers):
    print("stars per deg2 brighter than V at l = 90 (ratio to the anchor) [mean over l]")
    print("   b " + "".join(f"{f'V < {v}':>25s}" for v in ANCHORS))
    for b, factor in FACTORS.items():
        cells = []
        for v, anchor in ANCHORS.items():
            counts = expected_counts(*equatorial(LONGITUDES, b), numbers, v)
            here = counts[LONGITUDES == 90][0]
            ratio = f"({here / (anchor * factor):4.2f})" if factor else ""
            cells.append(f"{here:9.0f} {ratio:6s} [{counts.mean():6.0f}]")
        print(f"{b:4d} " + "".join(cells))


def brick(numbers, longitude, b):
    pix = healpy.ang2pix(NSIDE, *map(float, equatorial(longitude, b)), nest=True, lonlat=True)
    start = time.process_time()
    stars = draw_stars(lambda name: stream(1, "brick", pix, name), pix, partial(place, pix), numbers)
    took = time.process_time() - start
    print(f"brick {pix} at l = {longitude}, b = {b}: {len(stars['ra'])} stars, {took:.2f} CPU s")
    return stars


def counts_figure(numbers, path):
    v = np.arange(13, 28.01, 0.5)
    page = Figure((6.5, 5), layout="constrained")
    axes = page.add_subplot()
    ra, dec = (np.array(part) for part in zip(*(equatorial(LONGITUDES, b) for b in FACTORS), strict=True))
    n = np.stack([expected_counts(ra, dec, numbers, m) for m in v], axis=2)
    for (b, factor), colour, counts in zip(FACTORS.items(), COLOURS, n, strict=True):
        axes.semilogy(v, counts[LONGITUDES == 90][0], color=colour, label=f"b = {b}, l = 90; all l shaded")
        axes.fill_between(v, counts.min(axis=0), counts.max(axis=0), color=colour, alpha=0.15, lw=0)
        if factor:
            axes.plot(list(ANCHORS), factor * np.array(list(ANCHORS.values())), "o", color=colour, mfc="none")
    axes.set(xlabel="V [mag], no extinction", ylabel="stars brighter than V [deg$^{-2}$]", title="Circles: anchors")
    axes.legend()
    page.savefig(path, dpi=90)


def kiel_figure(numbers, path):
    many = [brick(numbers, *spot) for spot in KIEL]
    teff, logg, feh = (np.concatenate([stars[name] for stars in many]) for name in ("teff", "logg", "feh"))
    order = np.random.default_rng(0).permutation(len(teff))
    page = Figure((7, 6), layout="constrained")
    axes = page.add_subplot()
    dots = axes.scatter(teff[order], logg[order], c=feh[order], s=1.5, cmap="viridis", vmin=-2.5, vmax=0.3)
    axes.set(xscale="log", xlim=(40000, 1800), ylim=(9, -0.5), xlabel="Teff [K]", ylabel="log g")
    ticks = [30000, 20000, 10000, 6000, 4000, 3000, 2000]
    axes.set_xticks(ticks, labels=map(str, ticks))
    axes.minorticks_off()
    page.colorbar(dots, label="[Fe/H]")
    page.savefig(path, dpi=90)


def temperature_figure(stars, path):
    page = Figure((11, 4), layout="constrained")
    bins = np.arange(3.26, 4.3, 0.02)
    for k, (title, low, high) in enumerate(
        (("m_bol < 19", -99, 19), ("19 < m_bol < 24", 19, 24), ("m_bol > 24", 24, 99))
    ):
        axes = page.add_subplot(1, 3, k + 1)
        for (b, s), colour in zip(stars.items(), COLOURS, strict=True):
            m_bol = 4.74 - 10 * np.log10(s["teff"] / 5772) - 5 * np.log10(10 * s["radius"] / s["distance"])
            some = (m_bol > low) & (m_bol <= high)
            axes.hist(np.log10(s["teff"][some]), bins, histtype="step", density=True, color=colour, label=f"b = {b}")
        axes.set(xlabel="log Teff [K]", title=title)
    axes.legend()
    page.savefig(path, dpi=90)


def main(folder="docs/figures"):
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    numbers = read_data(SHIPPED / "universe" / "stars.yaml")
    start = time.process_time()
    types = galaxy(numbers).types
    print(f"{sum(t.table.shape[1] for t in types)} types of stars, set up in {time.process_time() - start:.2f} CPU s")
    report_counts(numbers)
    counts_figure(numbers, folder / "star_counts.png")
    kiel_figure(numbers, folder / "star_kiel.png")
    temperature_figure({b: brick(numbers, 90, b) for b in FACTORS}, folder / "star_temperatures.png")


if __name__ == "__main__":
    argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter).parse_args()
    main(*sys.argv[1:])
