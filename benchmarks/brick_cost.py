"""CPU seconds and memory of truth bricks with and without structure: one alone, neighbours, and bricks far apart.

    python benchmarks/brick_cost.py [--bricks 8] [--before FOLDER]

The workflow makes each brick in a process of its own, which pays the tables, too. Neighbours in one process, as
`csstsim chip` makes those that it lacks, share most haloes and maps; bricks far apart share none. Each figure is of a
process of its own. FOLDER is a checkout of an older version, whose bricks are made in the same run: 05630a61 is the
last one without structure. Exit code 1 if bricks take more than 1.5 times the CPU seconds of that version, or 0.8 GB. A
brick alone has no goal: it pays tables of more than structure that the older version lacks (dust, lines of galaxies).
"""

import argparse
import json
import os
import resource
import subprocess
import sys
import time
from pathlib import Path

from evidence.record import Record

FIRST, APART, LIMIT, MEMORY = 100000, 4096, 1.5, 0.8  # bricks; times; GB
SOURCE = Path(__file__).resolve().parents[1]


def made(structure, step, count, folder=SOURCE):
    """Return CPU seconds of the first brick, mean of the `count` further ones, and GB, in a process of its own."""
    words = [sys.executable, __file__, "--make", structure, str(step), "--bricks", str(count)]
    environment = os.environ | {"PYTHONPATH": str(Path(folder).resolve() / "src")}
    return json.loads(subprocess.run(words, check=True, stdout=subprocess.PIPE, text=True, env=environment).stdout)


def make(structure, step, count):
    """Make bricks and print what `made` returns."""
    try:
        from csstsim.campaign.sections import Lensing
    except ImportError:
        from csstsim.campaign.config import Lensing  # of the version without structure
    from csstsim.catalog.truth_bricks import make_brick
    from csstsim.instrument.camera import load_camera
    from csstsim.universe.parameters import load_universe

    universe, camera, times = load_universe(), load_camera(), []
    more = [] if structure == "before" else [structure]
    for k in range(count + 1):
        start = time.process_time()
        make_brick(1, FIRST + step * k, universe, camera, Lensing(), *more)
        times.append(time.process_time() - start)
    print(json.dumps([times[0], sum(times[1:]) / count, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6]))


def main() -> None:
    """Run what is asked for."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--bricks", type=int, default=8, help="further bricks of a process")
    parser.add_argument("--before", help="checkout of an older version without structure")
    parser.add_argument("--make", nargs=2, help=argparse.SUPPRESS)
    if "--make" in sys.argv:
        asked = parser.parse_args()
        make(asked.make[0], int(asked.make[1]), asked.bricks)
        return
    with Record(parser) as record:
        compare(record, parser)


def compare(record: Record, parser: argparse.ArgumentParser) -> None:
    """Make bricks in processes of their own, and record the cost."""
    asked = record.options
    if record.toy:
        asked.bricks = 1
    if asked.bricks < 1 or (asked.before and not (Path(asked.before) / "src" / "csstsim").is_dir()):
        parser.error("--bricks is at least 1; --before is a folder with src/csstsim")
    sources = {"haloes": SOURCE, "none": SOURCE} | ({"before": asked.before} if asked.before else {})
    for name, folder in () if record.toy else sources.items():
        made(name, 1, 1, folder)  # compiles
    for name, step in (("neighbours", 1), ("far apart", APART))[: 1 if record.toy else 2]:
        costs = {structure: made(structure, step, asked.bricks, folder) for structure, folder in sources.items()}
        for label, k in (("one alone", 0), (name, 1)) if step == 1 else ((name, 1),):
            key = label.replace(" ", "_")
            for structure, cost in costs.items():
                record.value(f"{key}_{structure}", cost[k], f"{label}, {structure}: a brick", unit="CPU-s")
            if asked.before:
                ratio = costs["haloes"][k] / costs["before"][k]
                most = None if label == "one alone" else LIMIT
                record.value(f"{key}_ratio", ratio, f"{label}: haloes over the older version", below=most)
        for structure, cost in costs.items():
            what = f"memory of a process of {asked.bricks + 1} {name}, {structure}"
            most = MEMORY if structure == "haloes" else None
            record.value(f"{name.replace(' ', '_')}_{structure}_gb", cost[2], what, unit="GB", below=most)


if __name__ == "__main__":
    main()
