"""Count the modules through which an exposure's obsid passes between the command line and the Level-0 file.

    python benchmarks/obsid_path.py [--campaign config/campaign.yaml] [--obsid 10100000004] [--chip 9]

`csstsim chip` runs in this process (output: results/obsid_path) and every call in csstsim is inspected. A module counts
if one of its functions receives, holds or returns the obsid, or an object that has it: Pointing, Exposure, Job, State,
Streams. The files' raw text does not count. Counted separately: the layers, which all receive the State by the paper's
contract, and the modules with the word obsid in their code.
"""

import argparse
import re
import sys
from collections import defaultdict
from pathlib import Path

import csstsim
from csstsim.command_line.main import main as command

SOURCE = Path(csstsim.__file__).parent
CARRIERS = {"Pointing", "Exposure", "Job", "State", "Streams"}
LONGEST = 200  # characters: more are the text of a file


def trace(obsid, run):
    """Return {module: what it held} for all modules that ran, including those that held nothing."""
    found = defaultdict(set)

    def held(value):
        values = value[:6] if isinstance(value, tuple | list) else (value,)
        for one in values:
            if isinstance(one, str) and obsid in one and len(one) < LONGEST:
                yield "obsid"
            elif type(one).__name__ in CARRIERS:
                yield type(one).__name__

    def look(frame, event, result):
        path = Path(frame.f_code.co_filename)
        if event in ("call", "return") and path.is_relative_to(SOURCE):
            seen = found[path.relative_to(SOURCE).as_posix()]
            if frame.f_code.co_name != "<module>":
                for value in (*frame.f_locals.values(), result):
                    seen.update(held(value))

    sys.setprofile(look)
    try:
        run()
    finally:
        sys.setprofile(None)
    return found


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--campaign", default="config/campaign.yaml")
    parser.add_argument("--obsid", default="10100000004")
    parser.add_argument("--chip", default="9")
    args = parser.parse_args()
    words = ["-q", "chip", args.campaign, "--obsid", args.obsid, "--chip", args.chip, "--output", "results/obsid_path"]
    found = trace(args.obsid, lambda: command(words, standalone_mode=False))
    passed = {module: what for module, what in found.items() if what}
    layers = [module for module in passed if module.startswith("layers/")]
    named = [module for module in found if re.search(r"\bobsid", (SOURCE / module).read_text(encoding="utf-8"))]
    for module, what in sorted(passed.items()):
        print(f"{module:40s} {', '.join(sorted(what))}")
    print(f"{len(found)} modules ran; the obsid passed through {len(passed)}, {len(layers)} of them layers")
    print(f"{len(named)} have the word: {', '.join(sorted(named))}")


if __name__ == "__main__":
    main()
