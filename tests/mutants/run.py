"""Break the simulator on purpose, one fault at a time, and see whether the tests that mirror the module fail.

    python tests/mutants/run.py                    all folders; make mutants
    python tests/mutants/run.py --folder render    one folder (repeat it for more)
    python tests/mutants/run.py --match wings      entries with this text in the file's name or the fault
    python tests/mutants/run.py --drawn 30         mutations drawn by rules from the code, new ones each day
    python tests/mutants/run.py --check            only check that each entry's text is there once

Works on a copy of the tree in the scratch folder; the checkout is not changed. Prints a table by folder, then the
survivors. Results are kept in the scratch folder; known ones are not run again unless requested. Exit code 1 if less
than SHARE of a folder of the set is caught; what is drawn may change nothing, so its survivors are to be read.
"""

import argparse
import os
import sys
import tempfile
from collections import Counter
from datetime import UTC, datetime
from pathlib import Path

SHARE = 0.9  # of a folder's mutants: what tests must see
ROOT = Path(__file__).resolve().parents[2]


def main():
    """Parse, run, print."""
    sys.path.insert(0, str(Path(__file__).parent))
    from drawn import draw
    from entries import load

    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--folder", action="append", default=[], help="a folder of the set")
    parser.add_argument("--match", default="", help="part of an entry's file or fault")
    parser.add_argument("--check", action="store_true", help="look at the set only")
    which = parser.add_mutually_exclusive_group()
    which.add_argument(
        "--again", action="store_const", dest="which", const="all", help="also those whose result is known"
    )
    which.add_argument(
        "--survivors", action="store_const", dest="which", const="survivors", help="known survivors alone"
    )
    parser.add_argument("--drawn", type=int, metavar="N", help="N mutations drawn by rules, in place of the set")
    parser.add_argument("--seed", type=int, help="of what is drawn [default: the day]")
    parser.add_argument("--whole", action="store_true", help="by all tests of the folder, not those of the module")
    scratch = Path(os.environ.get("CSSTSIM_MUTANTS", Path(tempfile.gettempdir(), "csstsim_mutants")))
    parser.add_argument("--scratch", type=Path, default=scratch, help="folder for the copy, caches and results")
    args = parser.parse_args()
    if args.drawn:
        seed = datetime.now(UTC).toordinal() if args.seed is None else args.seed
        print(f"{args.drawn} mutations by seed {seed}")
        mutations = draw(seed, args.drawn, tuple(args.folder))
    else:
        mutations = [m for m in load(args.folder) if args.match in m.file + " " + m.what]
    faults = [(m, fault) for m in mutations if (fault := m.fault())]
    for mutation, fault in faults:
        print(f"{mutation.folder}: {mutation.file}: {mutation.what}: {fault}")
    if args.check or faults:
        print(f"{len(mutations)} mutations, {len(faults)} to be mended")
        return bool(faults)
    from trial import Bench

    bench = Bench(ROOT, args.scratch.resolve())
    bench.run(mutations, args.which or "new", args.whole)
    return table(mutations, bench.results) and not args.drawn


def table(mutations, results):
    """Print mutants, caught and share by folder, and the survivors; return whether a folder has too few caught."""
    known = [(m, results[m.name]) for m in mutations if m.name in results]
    every, caught = Counter(m.folder for m, _ in known), Counter(m.folder for m, r in known if r["caught"])
    print("\n| folder | mutants | caught | share |\n|---|---|---|---|")
    for folder in sorted(every):
        print(f"| {folder} | {every[folder]} | {caught[folder]} | {caught[folder] / every[folder]:.0%} |")
    total, seen = every.total(), caught.total()
    print(f"| all | {total} | {seen} | {seen / max(total, 1):.0%} |\n")
    for m, result in known:
        if not result["caught"]:
            print(f"survives: {m.file}: {m.what}. {m.survives or 'No test sees it'} ({' '.join(m.tests)})")
    return any(caught[folder] < SHARE * every[folder] for folder in every)


if __name__ == "__main__":
    sys.exit(main())
