"""Star counts of the embedded Galaxy against Gaia's and deeper published ones, and figures.

    PYTHONPATH=builders python benchmarks/star_counts.py [folder of the figures, docs/figures if not given]

Counts are expected values behind the dust; a pair closer than 0.5 arcsec (HST: 0.1) is one source. Six of the twelve
directions had no part in the fit of the densities. The other figures show drawn bricks, at l = 90 deg unless stated.
Exit code 1 if the counts to any limit of G up to 20 are more than 10% from Gaia's in more than two directions.
"""

import argparse
import sys
import time
from functools import partial
from pathlib import Path

import healpy
import numpy as np
from astropy.table import Table
from fit_star_counts import TABLE, G, counts, places, steps
from matplotlib.figure import Figure
from star_count_model import StarCounts

from csstsim.base.healpix import NSIDE
from csstsim.base.rng import stream
from csstsim.base.shipped import SHIPPED
from csstsim.catalog.truth_bricks import place
from csstsim.instrument.load import read_data
from csstsim.report.style import BLUE, GREEN, ORANGE, VERMILION
from csstsim.universe.dust.dust_map import galactic
from csstsim.universe.parameters import load_universe
from csstsim.universe.stars.milky_way import equatorial
from csstsim.universe.stars.stars import draw_stars, galaxy

LATITUDES = (90, 49, 30, 15)  # of the bricks shown
MOST = 0.10  # departure of counts to a limit of G
FAINT = np.arange(11.5, 25.1, 0.5)  # limits of G of the curves
# Field, band, limit, stars, arcmin2, place (RA, Dec in deg), source
DEEP = [
    ("279 deg2, 49 < |b| < 64", "sdss2010-g", 21.0, 580_000, 279 * 3600, None, "SDSS: Chen et al. 2001, ApJ 553, 184"),
    ("HUDF", "sdss2010-i", 27.0, 25, 11.97, (53.16, -27.79), "HST: Pirzkal et al. 2005, ApJ 622, 319 (fitted)"),
    (
        "PEARS-N",
        "sdss2010-z",
        25.0,
        95,
        50.3,
        (189.2, 62.2),
        "HST: Pirzkal et al. 2009, ApJ 695, 1591; with spectra only",
    ),
    ("PEARS-S", "sdss2010-z", 25.0, 108, 68.8, (53.1, -27.8), "the same"),
    (
        "CDFS",
        "bessell-R",
        23.0,
        1200,
        1080,
        (53.1, -27.8),
        "Groenewegen et al. 2002, A&A 392, 741; seen in U to R only",
    ),
]
ZERO = {"bessell-R": 0.21}  # AB - Vega
COLOURS = (BLUE, ORANGE, GREEN, VERMILION)
KIEL = ((90, 15), (45, 20), (0, 30), (180, 30), (90, 60), (0, 60))  # l, b of the bricks shown


def against_gaia(model, path):
    """Print model / Gaia, draw the twelve directions, and return how many are more than MOST off."""
    table = Table.read(TABLE, format="ascii.csv", comment="#")
    table = table[table["use"] != "fitted"]
    (limits, seen), (ra, dec) = counts(table), places(table)
    ours, curve = steps(model, ra, dec, limits), steps(model, ra, dec, list(FAINT))
    every = ours.cumsum(axis=1) / seen.cumsum(axis=1)
    print("model / Gaia of the stars brighter than G\n   l   b        " + " ".join(f"{g:5.1f}" for g in limits))
    page = Figure((11, 8), layout="constrained")
    width = np.diff(limits, prepend=limits[0] - 1)
    for axes, row, n, here, line, ratio in zip(page.subplots(3, 4, sharex=True, sharey=True).flat, table, seen, ours,
                                               curve, every, strict=True):  # fmt: skip
        fitted = row["use"] == "shown"
        print(f"{row['l']:4d} {row['b']:3d} {'fitted' if fitted else 'kept':7s}" + " ".join(f"{q:5.2f}" for q in ratio))
        axes.semilogy(FAINT[1:] - 0.25, 2 * line[1:], color=BLUE)
        axes.plot(
            (limits - 0.5 * width)[1:], (n / width)[1:], "o", ms=4, mfc="none", color=VERMILION if fitted else GREEN
        )
        title = f"l = {row['l']}, b = {row['b']}: {'fitted' if fitted else 'not fitted'}"
        axes.set_title(f"{title}, {100 * np.abs(here / n - 1)[1:].max():.0f}%", fontsize=9)
    page.supxlabel("G [mag]")
    page.supylabel("stars per deg$^2$ and mag")
    page.savefig(path, dpi=80)
    wrong = np.abs(every - 1).max(axis=1) > MOST
    for use in ("shown", "tested"):
        kept = ours[table["use"] == use] / seen[table["use"] == use]
        print(f"rms of single steps, {use}:", np.sqrt((np.log(kept) ** 2).mean(axis=0)).round(3))
    return int(wrong.sum())


def deeper(numbers, universe):
    print("| field | limit | published | model | ratio | source |\n|---|---|---|---|---|---|")
    for name, band, limit, seen, area, place_, source in DEEP:
        model = StarCounts(numbers, universe, band, ZERO.get(band, 0.0), beam=0.1)
        ra, dec = ([v] for v in place_) if place_ else _stripes()
        ours = model.brighter(ra, dec, [limit]).mean() * area / 3600
        print(f"| {name} | {band[-1]} < {limit:g} | {seen} | {ours:.0f} | {ours / seen:.2f} | {source} |", flush=True)


def _stripes():
    """The equator where SDSS looked first, at 49 < |b| < 64 deg."""
    ra = np.concatenate([np.arange(145, 236, 3.0), np.arange(351, 416, 3.0) % 360])
    latitude = np.abs(galactic(ra, 0 * ra)[1])
    ra = ra[(latitude > 49) & (latitude < 64)]
    return ra, 0 * ra


def brick(numbers, longitude, b):
    pix = healpy.ang2pix(NSIDE, *map(float, equatorial(longitude, b)), nest=True, lonlat=True)
    start = time.process_time()
    stars = draw_stars(lambda name: stream(1, "brick", pix, name), pix, partial(place, pix), numbers)
    took = time.process_time() - start
    print(f"brick {pix} at l = {longitude}, b = {b}: {len(stars['ra'])} stars, {took:.2f} CPU s")
    return stars


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
    universe = load_universe()
    wrong = against_gaia(StarCounts(numbers, universe, *G), folder / "star_counts.png")
    deeper(numbers, universe)
    kiel_figure(numbers, folder / "star_kiel.png")
    temperature_figure({b: brick(numbers, 90, b) for b in LATITUDES}, folder / "star_temperatures.png")
    return wrong > 2


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", nargs="?", default="docs/figures")
    sys.exit(main(parser.parse_args().folder))
