"""Mean numbers of galaxies by redshift and mass on the sky with structure, against the mass functions.

    python benchmarks/mean_numbers.py [--bricks 64] [--structure haloes]

Bricks at random places are far apart, so their numbers are independent. Without structure the mean is that of the mass
functions in closed form; the table has the difference to it in percent. Its error is from the scatter among bricks,
which has Poisson's chance and that of structure (poorly known from fewer than 20 bricks). Only galaxies to i = 26 or so
are drawn (clustered_sky.DENSITY). Last come the published points from which the mass functions differ by more than
0.15 dex. The goal: differences are those of chance, no cell beyond 4 sigma and a reduced chi square of at most 2.
"""

import argparse
from itertools import pairwise
from pathlib import Path

from evidence.record import Record

import numpy as np
from clustered_sky import SEED, thin_universe

from csstsim.base.healpix import BRICKS
from csstsim.base.process.progress import progress
from csstsim.catalog.truth_bricks import AREA_DEG2, _clustered, _population, _streams
from csstsim.instrument.camera import load_camera
from csstsim.instrument.load import read_data
from csstsim.universe.galaxies.mass_function import TYPES, mass_function

PUBLISHED = Path(__file__).resolve().parents[1] / "tests" / "universe" / "published_galaxies.yaml"
REDSHIFTS = np.array([0.0, 0.2, 0.4, 0.6, 0.8, 1.0, 1.25, 1.5, 2.0, 2.5, 3.5, 7.0])
MASSES = np.array([8.0, 9.0, 9.5, 10.0, 10.5, 11.0, 12.2])  # log10 solar
LEAST = 20  # galaxies expected in all bricks; cells with fewer are left out
WORST, CHI2 = 4.0, 2.0
FAR = 0.15  # dex


def expected(grid):
    """Return (redshifts, masses) galaxies of a brick without structure."""
    density = grid.density.sum(axis=0) * AREA_DEG2  # a step of redshift or mass belongs to the bin of its middle
    z, log_mass = 0.5 * (grid.z[1:] + grid.z[:-1]), grid.log_mass + 0.5 * grid.step
    where = np.meshgrid(z, log_mass, indexing="ij")
    return np.histogram2d(*(v.ravel() for v in where), (REDSHIFTS, MASSES), weights=density.ravel())[0]


def found(clusters, grid, bricks):
    """Return (bricks, redshifts, masses) galaxies, binned by the same steps."""
    z_step, m_step = grid.z, grid.log_mass[0]
    middle = 0.5 * (grid.z[1:] + grid.z[:-1])
    out = []
    for pix in progress(bricks, "bricks"):
        sample = clusters.sample(pix, _streams(SEED, pix, "galaxies"), AREA_DEG2)
        row = np.clip(np.searchsorted(z_step, sample["z"], side="right") - 1, 0, len(middle) - 1)
        column = np.floor((sample["log_mass"] - m_step) / grid.step)
        log_mass = m_step + (column + 0.5) * grid.step
        out.append(np.histogram2d(middle[row], log_mass, (REDSHIFTS, MASSES))[0])
    return np.array(out)


def departures() -> tuple[int, list[tuple]]:
    """Return the number of published points and those that the mass functions miss by FAR or more.

    The latter are rows (name, z range, log mass, dex).
    """
    numbers = read_data(Path(__file__).resolve().parents[1] / "config" / "universe" / "galaxies.yaml")["mass_function"]
    out, entries = [], read_data(PUBLISHED)["mass_functions"]
    for entry in entries:
        log_mass, log_phi, _ = np.transpose(entry["points"])
        off = np.log10(sum(mass_function(log_mass, np.mean(entry["z"]), kind, numbers, 70.0) for kind in TYPES))
        out += [
            (entry["name"], entry["z"], m, d) for m, d in zip(log_mass, off - log_phi, strict=True) if abs(d) >= FAR
        ]
    return sum(len(entry["points"]) for entry in entries), out


def main() -> None:
    """Run what is asked for."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--bricks", type=int, default=64)
    parser.add_argument("--structure", default="haloes", choices=("haloes", "field"))
    with Record(parser) as record:
        compare(record)


def compare(record: Record) -> None:
    """Count galaxies in bricks, and record them over the mass functions."""
    args = record.options
    universe, camera = thin_universe(), load_camera()
    grid = _population(universe, camera).grid
    mean = expected(grid)
    bricks = np.random.default_rng(4).choice(BRICKS, 2 if record.toy else args.bricks, replace=False)
    counts = found(_clustered(SEED, universe, camera, args.structure), grid, bricks)
    error = counts.std(axis=0, ddof=1) / np.sqrt(len(counts))
    error = np.maximum(error, np.sqrt(mean / len(counts)))  # few galaxies: not less than Poisson's
    off = counts.mean(axis=0) - mean
    used = mean * len(counts) >= LEAST
    names = [f"{a:g}-{b:g}" for a, b in pairwise(MASSES)]
    lines = []
    every = np.concatenate([counts, counts.sum(axis=2, keepdims=True)], axis=2)
    total = np.concatenate([mean, mean.sum(axis=1, keepdims=True)], axis=1)
    spread = every.std(axis=0, ddof=1) / np.sqrt(len(counts))
    for k, low in enumerate(REDSHIFTS[:-1]):
        cells = [
            f"{100 * (n / m - 1):+.1f} ± {100 * s / m:.1f}" if m * len(counts) >= LEAST else ""
            for n, m, s in zip(every.mean(axis=0)[k], total[k], spread[k], strict=True)
        ]
        lines.append([f"{low:g}-{REDSHIFTS[k + 1]:g}", *cells])
    record.table("numbers", ["z \\ log mass", *names, "all"], lines)
    sigma = off[used] / error[used]
    each = counts.sum(axis=(1, 2)) / mean.sum()
    worst, chi2 = np.abs(sigma).max(), (sigma**2).mean()
    what = f"galaxies of {len(counts)} bricks over those of the mass functions"
    record.value("ratio", each.mean(), what, error=each.std(ddof=1) / np.sqrt(len(each)))
    record.value("cells", int(used.sum()), "cells of redshift and mass that are compared")
    record.value("chi2", chi2, "reduced chi square of the cells", below=CHI2)
    record.value("worst", worst, "largest departure of a cell", unit="sigma", below=WORST)
    points, off = departures()
    rows = [[name, f"{z[0]:g} to {z[1]:g}", f"{log_mass:g}", f"{dex:+.2f}"] for name, z, log_mass, dex in off]
    record.value("published_points", points, "published points of mass functions")
    record.value("departures", len(rows), f"published points that the mass functions miss by {FAR} dex or more")
    record.table("departures_by_point", ["published", "z", "log mass", "off [dex]"], rows)


if __name__ == "__main__":
    main()
