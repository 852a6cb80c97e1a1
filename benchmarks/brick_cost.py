"""CPU seconds and memory of truth bricks with and without structure: one alone, neighbours, and bricks far apart.

    python benchmarks/brick_cost.py [--bricks 8]

The workflow makes each brick in a process of its own, which pays the tables, too. Neighbours in one process, as
`csstsim chip` makes those that it lacks, share most haloes and maps; bricks far apart share none. Each figure is of a
process of its own. Exit code 1 above 1.5 times, one alone or among neighbours, or above 0.8 GB.
"""

import argparse
import json
import resource
import subprocess
import sys
import time

FIRST, APART, LIMIT, MEMORY = 100000, 4096, 1.5, 0.8  # bricks; times; GB


def made(structure, step, count):
    """Return CPU seconds of the first brick, mean of the `count` further ones, and GB, in a process of its own."""
    words = [sys.executable, __file__, "--make", structure, str(step), "--bricks", str(count)]
    return json.loads(subprocess.run(words, check=True, stdout=subprocess.PIPE, text=True).stdout)


def make(structure, step, count):
    """Make bricks and print what `made` returns."""
    from csstsim.campaign.sections import Lensing
    from csstsim.catalog.truth_bricks import make_brick
    from csstsim.instrument.camera import load_camera
    from csstsim.universe.parameters import load_universe

    universe, camera, times = load_universe(), load_camera(), []
    for k in range(count + 1):
        start = time.process_time()
        make_brick(1, FIRST + step * k, universe, camera, Lensing(), structure)
        times.append(time.process_time() - start)
    print(json.dumps([times[0], sum(times[1:]) / count, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6]))


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--bricks", type=int, default=8, help="further bricks of a process")
    parser.add_argument("--make", nargs=2, help=argparse.SUPPRESS)
    asked = parser.parse_args()
    if asked.make:
        return make(asked.make[0], int(asked.make[1]), asked.bricks)
    made("haloes", 1, 1)  # compiles
    failed = False
    for name, step in (("neighbours", 1), ("far apart", APART)):
        none, haloes = (made(structure, step, asked.bricks) for structure in ("none", "haloes"))
        for label, k in (("one alone", 0), (name, 1)) if step == 1 else ((name, 1),):
            ratio = haloes[k] / none[k]
            failed |= step == 1 and ratio > LIMIT
            print(f"{label}: haloes {haloes[k]:.1f}, none {none[k]:.1f} CPU s a brick, ratio {ratio:.2f}", flush=True)
        failed |= haloes[2] > MEMORY
        print(f"memory of a process of {asked.bricks + 1} {name}: {haloes[2]:.2f} GB, none {none[2]:.2f}", flush=True)
    sys.exit(int(failed))


if __name__ == "__main__":
    main()
