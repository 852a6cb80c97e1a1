"""A window of a chip in a Python loop: wall and CPU seconds per turn, and a check that turns are independent.

    python benchmarks/python_loop.py [--size 1000] [--turns 10]

Each turn draws ten objects of a table with all layers and a new seed, or their light alone (Simulation.light). PSF set
and compiled code are made before the clock starts.
"""

import argparse
import time

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


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--size", type=int, default=1000, help="side of the window [pixel]")
    parser.add_argument("--turns", type=int, default=10)
    arguments = parser.parse_args()
    sim = csstsim.Simulation().aim(RA, DEC, chip=CHIP, size=arguments.size).replace(catalog=objects())
    first = sim.chip(OBSID, CHIP)
    for name, make in (
        ("chip, one seed", lambda turn: sim.chip(OBSID, CHIP)),
        ("chip, a new seed each", lambda turn: sim.replace(seed=turn).chip(OBSID, CHIP)),
        ("light alone", lambda turn: sim.light(OBSID, CHIP)),
    ):
        wall, cpu = timed(arguments.turns, make)
        print(f"{name:<24} {wall:6.2f} s  {cpu:6.2f} CPU-s per turn")
    same = np.array_equal(first.image, sim.chip(OBSID, CHIP).image)
    print("the same bits after all of it" if same else "DIFFERENT from the first turn")
    return 0 if same else 1


if __name__ == "__main__":
    raise SystemExit(main())
