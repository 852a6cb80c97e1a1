"""A window of a chip in a Python loop: wall and CPU seconds per turn, and a check that turns are independent.

    python benchmarks/python_loop.py [--size 1000] [--turns 10]

Each turn draws ten objects of a table with all layers and a new seed, or their light alone (Simulation.light). PSF set
and compiled code are made before the clock starts.
"""

import argparse
import time

from evidence.record import Record

import numpy as np
from astropy.table import Table

import csstsim

RA, DEC, OBSID, CHIP = 150.1, 2.2, "10100000001", 9


def objects(count=10):
    """Return stars and galaxies of 18 to 22 mag within half an arcmin of the field's centre."""
    rng = np.random.default_rng(1)
    step = rng.uniform(-0.5, 0.5, (2, count)) / 60.0
    return Table(
        {
            "ra": RA + step[0] / np.cos(np.radians(DEC)), "dec": DEC + step[1], "mag_r": rng.uniform(18.0, 22.0, count),
            "type": np.resize(["star", "galaxy"], count), "size": np.full(count, 0.5),
        }
    )  # fmt: skip


def timed(turns, make):
    """Return (wall s, CPU s) per turn of make(turn)."""
    wall, cpu = time.perf_counter(), time.process_time()
    for turn in range(turns):
        make(turn)
    return (time.perf_counter() - wall) / turns, (time.process_time() - cpu) / turns


def main() -> None:
    """Run what is asked for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--size", type=int, default=1000, help="side of the window [pixel]")
    parser.add_argument("--turns", type=int, default=10)
    with Record(parser) as record:
        loop(record)


def loop(record: Record) -> None:
    """Time each way, and compare the first turn with the last."""
    arguments, turns = record.options, 1 if record.toy else record.options.turns
    size = 200 if record.toy else arguments.size
    sim = csstsim.Simulation().aim(RA, DEC, chip=CHIP, size=size).replace(catalog=objects())
    first = sim.chip(OBSID, CHIP)
    for key, name, make in (
        ("chip", "chip, one seed", lambda turn: sim.chip(OBSID, CHIP)),
        ("new_seed", "chip, a new seed each", lambda turn: sim.replace(seed=turn).chip(OBSID, CHIP)),
        ("light", "the light alone", lambda turn: sim.light(OBSID, CHIP)),
    ):
        wall, cpu = timed(turns, make)
        record.value(key, wall, f"{name}: wall time of a turn", unit="s")
        record.value(f"{key}_cpu", cpu, f"{name}: CPU time of a turn", unit="CPU-s")
    same = np.array_equal(first.image, sim.chip(OBSID, CHIP).image)
    record.value("same", int(same), "the first turn's bits after all of them (1: the same)", above=1)


if __name__ == "__main__":
    main()
