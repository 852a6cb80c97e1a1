"""CPU seconds and memory of a truth brick with and without structure, one after the other in one process.

    python benchmarks/brick_cost.py [--bricks 2]

A process that makes one brick pays the tables (first line), too. Exit code 1 above 1.5 times or 0.8 GB.
"""

import argparse
import resource
import sys
import time

from csstsim.campaign.sections import Lensing
from csstsim.catalog.truth_bricks import make_brick
from csstsim.instrument.camera import load_camera
from csstsim.universe.parameters import load_universe

FIRST, LIMIT, MEMORY = 100000, 1.5, 0.8  # times; GB


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--bricks", type=int, default=2)
    count = parser.parse_args().bricks
    universe, camera = load_universe(), load_camera()
    cost, first = {}, {}
    for structure in ("none", "haloes"):
        times = []
        for pix in range(FIRST, FIRST + 4096 * (count + 1), 4096):  # far apart: nothing is shared
            start = time.process_time()
            make_brick(1, pix, universe, camera, Lensing(), structure)
            times.append(time.process_time() - start)
        first[structure], cost[structure] = times[0], sum(times[1:]) / count
        memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6
        print(
            f"{structure}: first {times[0]:.1f}, further {cost[structure]:.1f} CPU s a brick, {memory:.2f} GB",
            flush=True,
        )
    ratios = [part["haloes"] / part["none"] for part in (first, cost)]
    print(f"haloes over none: first {ratios[0]:.2f}, further {ratios[1]:.2f}")
    sys.exit(int(max(ratios) > LIMIT or memory > MEMORY))


if __name__ == "__main__":
    main()
