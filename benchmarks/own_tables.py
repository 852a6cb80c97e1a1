"""Cost of a user's own table against the embedded sky: the same objects, at the same positions, with the same light.

    python benchmarks/own_tables.py [--stars 100000] [--galaxies 20000] [--size 400]

Stars and galaxies of a truth brick, repeated as needed, are spread over a window of an r chip: once as rows of the
embedded universe, once as a table of ra, dec, seven magnitudes, sizes and shapes. Stars are drawn by `standard`,
galaxies by `noise_free`. Brick, PSF set and compiled code are made before. Exit code 1 if a table costs more than 1.5
times the embedded sky, or gives other light.
"""

import argparse
import tempfile
import time
from functools import partial
from pathlib import Path

import numpy as np
from astropy.table import Table

import csstsim
from csstsim.catalog.table import GALAXY, STAR, ObjectTable
from csstsim.stages.chip import light

RA, DEC, OBSID, CHIP = 150.1, 2.2, "10100000001", 9
MOST = 1.5  # CPU seconds of a table over those of the embedded sky
LIGHT = 0.01  # of the sum; single objects agree to 1e-4, as their spectra differ but their magnitudes do not


def brick(sim):
    """Return the truth brick of the simulation's field, made if it does not exist."""
    job = sim._run.job(OBSID, CHIP)
    light(sim._run, job, say=str)
    return ObjectTable.read(sim._run.paths.truth(sim._run.truth_bricks(job)[0]))


def dealt(truth, kind, count, size, rng):
    """Return `count` rows of one type that are brighter than r = 28, over the window."""
    some = np.flatnonzero((truth["obj_type"] == kind) & (truth["mag_r"] < 28.0) & (truth["kappa"] < 0.5))
    half = size / 2 * 0.074 / 3600.0
    step = rng.uniform(-half, half, (2, count))
    return truth.take(rng.choice(some, count)).with_columns(
        id=np.arange(1, count + 1), ra=RA + step[0] / np.cos(np.radians(DEC)), dec=DEC + step[1],
        **{name: np.zeros(count, np.float32) for name in ("pmra", "pmdec", "parallax", "rv")},
    )  # fmt: skip


def as_table(rows):
    """Return the user's astropy Table of the same objects."""
    shape = "size_disk", "size_bulge", "bulge_frac", "e1", "e2", "kappa", "gamma1", "gamma2"
    names = (
        "ra",
        "dec",
        *(name for name in rows if name.startswith("mag_")),
        *(shape if rows["obj_type"][0] == GALAXY else ()),
    )
    table = Table({name: rows[name] for name in names})
    table["type"] = ["galaxy" if kind == GALAXY else "star" for kind in rows["obj_type"]]
    for name in (name for name in names if name.startswith("mag_")):  # the faintest allowed in a table
        table[name] = np.clip(table[name], -3.0, 90.0)
    return table


def costs(make):
    """Return ([CPU seconds: open, select, render], electrons drawn) of the Simulation that `make` gives."""
    start = time.process_time()
    sim = make()
    opened = time.process_time() - start
    state = light(sim._run, sim._run.job(OBSID, CHIP), say=str)
    return [opened, *(cpu for _, _, cpu in state.header["stages"])], float(state.truth["drawn"].sum())


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--stars", type=int, default=100_000)
    parser.add_argument("--galaxies", type=int, default=20_000)
    parser.add_argument("--size", type=int, default=400, help="side of the window [pixel]")
    arguments = parser.parse_args()
    sim = csstsim.Simulation().replace(catalog={"kind": "embedded"}).aim(RA, DEC, chip=CHIP, size=arguments.size)
    truth, rng, bad = brick(sim), np.random.default_rng(1), False
    print(f"{'CPU seconds':<26} {'open':>7} {'select':>7} {'render':>7} {'all':>7}")
    with tempfile.TemporaryDirectory() as folder:
        for kind, count, fidelity in ((STAR, arguments.stars, "standard"), (GALAXY, arguments.galaxies, "noise_free")):
            found = {}
            for number in (min(count, 200), count):  # the first compiles
                rows, file = dealt(truth, kind, number, arguments.size, rng), Path(folder) / f"{kind}.parquet"
                rows.write(file)
                scene = {"kind": "csstsim.catalog.embedded:SceneCatalog", "options": {"file": str(file)}}
                table = as_table(rows)
                for name, catalog in (("embedded", scene), ("table", table)):
                    found[name] = costs(partial(sim.replace, catalog=catalog, fidelity=fidelity))
            what = f"{count} {'stars' if kind == STAR else 'galaxies'}"
            for name, (seconds, _) in found.items():
                print(f"{what + ', ' + name:<26} " + " ".join(f"{s:7.2f}" for s in (*seconds, sum(seconds))))
            ratio = sum(found["table"][0]) / sum(found["embedded"][0])
            same = abs(found["table"][1] / found["embedded"][1] - 1)
            print(f"{'':<26} table over embedded {ratio:.2f}, light differs by {same:.1e}")
            bad |= ratio > MOST or same > LIGHT
    return int(bad)


if __name__ == "__main__":
    raise SystemExit(main())
