"""Star counts of the embedded Galaxy against Gaia's and deeper published ones, and figures.

    python benchmarks/star_counts.py

Counts are expected values behind the dust; a pair closer than 0.5 arcsec (HST: 0.1) is one source. Six of the twelve
directions had no part in the fit of the densities. The other figures show drawn bricks, at l = 90 deg unless stated.
The goal: counts to any limit of G up to 20 are within 10% of Gaia's in all directions but two.
"""

import argparse
import copy
import time
from functools import partial
from pathlib import Path

from evidence.record import Record

import healpy
import numpy as np
from astropy.table import Table
from fit_star_counts import TABLE, G, counts, places, steps
from matplotlib.figure import Figure
from star_count_model import StarCounts

from csstsim.base.healpix import NSIDE
from csstsim.base.rng import stream
from csstsim.base.shipped import SHIPPED
from csstsim.catalog.truth_bricks import random_positions
from csstsim.instrument.load import read_data
from csstsim.report.style import BLUE, GREEN, ORANGE, VERMILION
from csstsim.universe.dust.dust_map import galactic
from csstsim.universe.parameters import Universe, load_universe
from csstsim.universe.stars.milky_way import equatorial
from csstsim.universe.stars.stars import draw_stars, galaxy

LATITUDES = (90, 49, 30, 15)  # of the bricks shown
MOST, MOST_WRONG = 0.10, 2  # departure of counts to a limit of G; directions that may have more
FAINT = np.arange(11.5, 25.1, 0.5)  # limits of G of the curves
# Field, band, limit, stars, arcmin2, position (RA, Dec in deg), source
HUDF = "Hubble Ultra Deep Field, fitted"
DEEP = [
    ("279 deg², 49° < \\|b\\| < 64°", "sdss2010-g", 21.0, 580_000, 279 * 3600, None, "SDSS: Chen et al. 2001"),
    (HUDF, "sdss2010-i", 27.0, 25, 11.97, (53.16, -27.79), "Pirzkal et al. 2005"),
    ("PEARS, north", "sdss2010-z", 25.0, 95, 50.3, (189.2, 62.2), "Pirzkal et al. 2009: only stars with a spectrum"),
    ("PEARS, south", "sdss2010-z", 25.0, 108, 68.8, (53.1, -27.8), "the same"),
    (
        "Chandra Deep Field South", "bessell-R", 23.0, 1200, 1080, (53.1, -27.8),
        "Groenewegen et al. 2002: only stars seen in U",
    ),
]  # fmt: skip
ZERO = {"bessell-R": 0.21}  # AB - Vega
COLOURS = (BLUE, ORANGE, GREEN, VERMILION)
KIEL = ((90, 15), (45, 20), (0, 30), (180, 30), (90, 60), (0, 60))  # l, b of the bricks shown


def against_gaia(record: Record, model: StarCounts) -> None:
    """Record model / Gaia, and draw the twelve directions."""
    table = Table.read(TABLE, format="ascii.csv", comment="#")
    table = table[table["use"] != "fitted"]
    table = table[table["l"] == 180] if record.toy else table
    (limits, seen), (ra, dec) = counts(table), places(table)
    ours, curve = steps(model, ra, dec, limits), steps(model, ra, dec, list(FAINT))
    every = ours.cumsum(axis=1) / seen.cumsum(axis=1)
    page = Figure((11, 8), layout="constrained")
    width = np.diff(limits, prepend=limits[0] - 1)
    for axes, row, n, here, line in zip(page.subplots(3, 4, sharex=True, sharey=True).flat, table, seen, ours, curve,
                                        strict=False):  # fmt: skip
        fitted = row["use"] == "shown"
        axes.semilogy(FAINT[1:] - 0.25, 2 * line[1:], color=BLUE)
        axes.plot(
            (limits - 0.5 * width)[1:], (n / width)[1:], "o", ms=4, mfc="none", color=VERMILION if fitted else GREEN
        )
        title = f"l = {row['l']}, b = {row['b']}: {'fitted' if fitted else 'not fitted'}"
        axes.set_title(f"{title}, {100 * np.abs(here / n - 1)[1:].max():.0f}%", fontsize=9)
    page.supxlabel("G [mag]")
    page.supylabel("stars per deg$^2$ and mag")
    page.savefig(record.figure("star_counts.png"), dpi=80)
    names = [f"l = {row['l']}, b = {row['b']}, {'fitted' if row['use'] == 'shown' else 'not fitted'}" for row in table]
    header = ["stars brighter than G", *(f"{limit:g}" for limit in limits)]
    record.table("directions", header, [[n, *(f"{q:.2f}" for q in r)] for n, r in zip(names, every, strict=True)])
    kept = every[table["use"] == "tested"]
    ends = {"lowest of the six directions not fitted": kept.min(axis=0), "highest of them": kept.max(axis=0)}
    rows = [[f"model / Gaia, {name}", *(f"{q:.2f}" for q in ratio)] for name, ratio in ends.items()]
    record.table("gaia", header, rows)
    off = np.abs(every - 1).max(axis=1)
    record.value("largest", off.max(), "largest departure of counts to a limit of G from Gaia's, all directions")
    record.value("wrong", (off > MOST).sum(), f"directions with more than {MOST:.0%} of it", below=MOST_WRONG)
    single = np.abs(ours / seen - 1)[:, 1:].max()  # without the first, to which all brighter stars belong
    record.value("largest_step", single, "largest departure of a single step of a magnitude of G, all directions")
    about = {row["b"]: n.cumsum() for row, n in zip(table, seen, strict=True) if row["l"] == 180}
    north = (about[30] / about[-30]).max() - 1
    record.value(
        "north", north, "excess of Gaia's stars at l = 180, b = 30 over those at b = -30, largest to any limit"
    )


def deeper(record: Record, numbers: dict, universe: Universe) -> None:
    """Record counts of deeper surveys, and the stars of the HUDF were the halo of one power."""
    rows = []
    for name, band, limit, seen, area, spot, source in DEEP[1:2] if record.toy else DEEP:
        model = StarCounts(numbers, universe, band, ZERO.get(band, 0.0), beam=0.1)
        ra, dec = ([v] for v in spot) if spot else _stripes()
        ratio = model.brighter(ra, dec, [limit]).mean() * area / 3600 / seen
        rows.append([name, f"{band[-1]} < {limit:g}", f"{seen:,}", f"{ratio:.2f}", source])
        if name == HUDF:
            one = copy.deepcopy(numbers)
            one["laws"]["halo"][3] = one["laws"]["halo"][0]
            value = model.brighter(ra, dec, [limit], one).mean() * area / 3600 / seen
            record.value("one_power", value, "stars of the HUDF over those seen, with one power of the halo")
    record.table("deeper", ["field", "limit", "published", "model / published", "source"], rows)


def _stripes():
    """The equator where SDSS looked first, at 49 < |b| < 64 deg."""
    ra = np.concatenate([np.arange(145, 236, 3.0), np.arange(351, 416, 3.0) % 360])
    latitude = np.abs(galactic(ra, 0 * ra)[1])
    ra = ra[(latitude > 49) & (latitude < 64)]
    return ra, 0 * ra


def brick(numbers: dict, longitude: float, b: float) -> dict:
    """Return the stars of the brick at these Galactic coordinates [deg]."""
    pix = healpy.ang2pix(NSIDE, *map(float, equatorial(longitude, b)), nest=True, lonlat=True)
    return draw_stars(lambda name: stream(1, "brick", pix, name), pix, partial(random_positions, pix), numbers)


def kiel_figure(numbers: dict, path: Path, spots: tuple) -> None:
    many = [brick(numbers, *spot) for spot in spots]
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


def temperature_figure(stars: dict[int, dict], path: Path) -> None:
    page = Figure((11, 4), layout="constrained")
    bins = np.arange(3.26, 4.3, 0.02)
    for k, (title, low, high) in enumerate(
        (("m_bol < 19", -99, 19), ("19 < m_bol < 24", 19, 24), ("m_bol > 24", 24, 99))
    ):
        axes = page.add_subplot(1, 3, k + 1)
        for (b, s), colour in zip(stars.items(), COLOURS, strict=False):
            m_bol = 4.74 - 10 * np.log10(s["teff"] / 5772) - 5 * np.log10(10 * s["radius"] / s["distance"])
            some = (m_bol > low) & (m_bol <= high)
            axes.hist(np.log10(s["teff"][some]), bins, histtype="step", density=True, color=colour, label=f"b = {b}")
        axes.set(xlabel="log Teff [K]", title=title)
    axes.legend()
    page.savefig(path, dpi=90)


def main(record: Record) -> None:
    numbers = read_data(SHIPPED / "universe" / "stars.yaml")
    start = time.process_time()
    types = galaxy(numbers).types
    seconds = time.process_time() - start
    record.value("types", sum(t.table.shape[1] for t in types), "types of stars")
    record.value("set_up", seconds, "set-up of the types", unit="CPU-s")
    universe = load_universe()
    against_gaia(record, StarCounts(numbers, universe, *G))
    deeper(record, numbers, universe)
    kiel_figure(numbers, record.figure("star_kiel.png"), KIEL[-1:] if record.toy else KIEL)
    latitudes = LATITUDES[:1] if record.toy else LATITUDES
    temperature_figure({b: brick(numbers, 90, b) for b in latitudes}, record.figure("star_temperatures.png"))


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    with Record(parser) as record:
        main(record)
