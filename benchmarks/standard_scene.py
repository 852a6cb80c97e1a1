"""Builder of the standard scene: the chip on which every speed and accuracy is measured.

    python benchmarks/standard_scene.py                # writes results/standard_scene/objects.parquet
    csstsim chip config/standard_scene.yaml --obsid ... --chip 9      # draws it (obsid: in that file)
    python benchmarks/standard_scene.py --histogram > benchmarks/standard_scene.csv    # how the counts were made

71,479 galaxies and 5,159 stars (the paper's r-band chip), their numbers per half magnitude in r fixed by
standard_scene.csv. Objects are drawn from nine truth bricks, each bin's number from those of its brightness (again and
again where there are too few), and put uniformly on the chip of the campaign's exposure. Stars keep their motions:
their J2000 places are such that they stand on the chip at the epoch.
"""

import argparse
import csv
import sys
from pathlib import Path

import numpy as np

from csstsim.campaign import OpenCampaign
from csstsim.catalog.astrometry import at_j2000, icrs
from csstsim.catalog.table import GALAXY, STAR, ObjectTable
from csstsim.config import SHIPPED, Lensing
from csstsim.progress import progress
from csstsim.rng import stream
from csstsim.universe.bricks import make_brick
from csstsim.universe.numbers import load_universe

CAMPAIGN = SHIPPED / "standard_scene.yaml"
COUNTS = Path(__file__).with_suffix(".csv")
TOTAL = {"galaxies": 71_479, "stars": 5_159}
KIND = {"galaxies": GALAXY, "stars": STAR}
SEED, BRICK = 1, 561928  # the brick of that exposure; with its neighbours, for one has too few bright stars to count
STEP = 0.5  # mag


def source(camera):
    import healpy

    around = healpy.get_all_neighbours(256, BRICK, nest=True)
    universe = load_universe(SHIPPED / "universe")
    return ObjectTable.concat(
        make_brick(SEED, int(pix), universe, camera, Lensing()) for pix in progress([BRICK, *around], "truth bricks")
    )


def bins(table):
    return np.floor(table["mag_r"] / STEP).astype(int)


def histogram(table):
    """Return [(bin, galaxies, stars)]: the bricks' histogram scaled to the totals, rounded to keep the sums."""
    columns = {}
    for name, total in TOTAL.items():
        chosen = table.take(table["obj_type"] == KIND[name])
        found, counts = np.unique(bins(chosen), return_counts=True)
        edges = np.round(np.concatenate([[0.0], np.cumsum(counts)]) * total / counts.sum()).astype(int)
        columns[name] = dict(zip(found.tolist(), np.diff(edges).tolist(), strict=True))
    rows = range(min(map(min, columns.values())), max(map(max, columns.values())) + 1)
    return [(k, columns["galaxies"].get(k, 0), columns["stars"].get(k, 0)) for k in rows]


def read_counts():
    with open(COUNTS, newline="") as file:
        return [{name: float(value) for name, value in row.items()} for row in csv.DictReader(file)]


def draw(table, counts):
    """Return rows of `table`, so many of each kind and brightness."""
    rng, rows = stream(SEED, "standard scene", "rows"), []
    for name, kind in KIND.items():
        place = {k: np.flatnonzero((table["obj_type"] == kind) & (bins(table) == k)) for k in np.unique(bins(table))}
        for row in counts:
            wanted, there = int(row[name]), place.get(int(row["mag_r"] / STEP), np.zeros(0, int))
            if wanted:
                if not len(there):
                    sys.exit(f"the bricks have no {name} at r = {row['mag_r']}: make {COUNTS.name} anew")
                order = rng.permutation(there)
                rows.append(np.resize(order, wanted))
    return table.take(np.concatenate(rows))


def put(table, job):
    """Return the table spread over the job's window, with ids of its own."""
    rng, window, count = stream(SEED, "standard scene", "places"), job.window, len(table)
    x, y = rng.uniform(window.x0 - 0.5, window.x1 - 0.5, count), rng.uniform(window.y0 - 0.5, window.y1 - 0.5, count)
    star = table["obj_type"] == STAR
    motion = {name: np.where(star, table[name], 0.0) for name in ("pmra", "pmdec", "parallax", "rv")}
    ra, dec = at_j2000(*icrs(*job.wcs.pixel_to_world(x, y), job.observer), job.observer, **motion)
    return table.with_columns(ra=ra, dec=dec, id=np.arange(1, count + 1))


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--histogram", action="store_true", help="print the counts per bin of r, as CSV")
    parser.add_argument("--output", type=Path, default=Path("results/standard_scene/objects.parquet"))
    options = parser.parse_args()
    run = OpenCampaign(CAMPAIGN)
    table = source(run.camera)
    if options.histogram:
        print("mag_r,galaxies,stars", *(f"{k * STEP},{g},{s}" for k, g, s in histogram(table)), sep="\n")
        return
    scene = put(draw(table, read_counts()), run.jobs[0])
    options.output.parent.mkdir(parents=True, exist_ok=True)
    ObjectTable(scene).write(options.output, {"product": "standard scene", "seed": SEED, "brick": BRICK})
    print(f"{options.output}: {len(scene)} objects")


if __name__ == "__main__":
    main()
