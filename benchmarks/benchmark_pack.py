"""A catalogue from a pack's README alone: python benchmarks/benchmark_pack.py PACK [--output DIR].

PACK is made by `csstsim release pack`. The columns and the command of source-extractor are read from the README's own
blocks, and run in the folder that a stranger gets; so is the command that scores the catalogue. Needs
`apt-get install source-extractor`. Prints the score and the time. Exit code 1 if a star of S/N above 10 in ten is not
found, or the magnitudes of points are off by more than 0.15.
"""

import argparse
import json
import re
import shutil
import subprocess
import sys
import time
from pathlib import Path

LEAST, MOST = 0.9, 0.15  # of points of S/N above 10; mag, of Kron magnitudes without a correction


def blocks(text):
    """Return the indented blocks of a README, without their indent."""
    found = re.findall(r"(?:^ {4}.*\n)+", text, flags=re.M)
    return [re.sub(r"^ {4}", "", block, flags=re.M).strip() for block in found]


def follow(pack, output):
    """Do what the README says; return the score and seconds."""
    begin = time.monotonic()
    public = Path(pack) / "public"
    columns, command, score = blocks((public / "README.md").read_text())
    work = Path(output)
    work.mkdir(parents=True, exist_ok=True)
    (work / "first.param").write_text(columns + "\n")
    (work / "calibrated").unlink(missing_ok=True)
    (work / "calibrated").symlink_to((public / "calibrated").resolve())
    (work / "truth").unlink(missing_ok=True)
    (work / "truth").symlink_to((Path(pack) / "truth").resolve())
    for line in (command, score):
        if not shutil.which(line.split()[0]):
            sys.exit(f"{line.split()[0]} is not installed")
        subprocess.run(["bash", "-c", line], cwd=work, check=True)
    return json.loads((work / "score" / "score.json").read_text()), time.monotonic() - begin


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("pack")
    parser.add_argument("--output", default="results/benchmark_pack")
    given = parser.parse_args()
    made, seconds = follow(given.pack, given.output)
    points = made["completeness"]["points"]
    off = made["photometry"][made["band"]]["points"]["mean"]
    print(f"{seconds:.0f} s; points found {points['completeness']:.3f} of {points['n']}, magnitudes {off:+.3f}")
    sys.exit(not (points["completeness"] >= LEAST and abs(off) <= MOST))


if __name__ == "__main__":
    main()
