"""Count the modules through which an exposure's obsid passes between the command line and the Level-0 file.

    python benchmarks/obsid_path.py [--campaign config/campaign.yaml] [--obsid 10100000004] [--chip 9]

`csstsim chip` runs in this process (output: results/obsid_path) and every call in csstsim is inspected. A module counts
if one of its functions receives, holds or returns the obsid: as a text that contains it, or in an object or a container
from which it is reached in a few steps, attribute by attribute and item by item. Three things do not count: the raw
text of files, the path of a file, and the opened campaign, which has the whole survey table. Counted separately: the
layers, and the modules with the word obsid in their code.
"""

import argparse
import functools
import re
import sys
from collections import defaultdict
from pathlib import Path

from evidence.record import Record

from support.mini_campaign import write_campaign
from toy_sky import toy_sky

import csstsim
from csstsim.campaign.opened import OpenCampaign
from csstsim.command_line.main import main as command

SOURCE = Path(csstsim.__file__).parent
LONGEST = 300  # characters: more are the text of a file
DEPTH = 4  # steps from a value to the obsid
ITEMS = 64  # of a container, the first
SKIPPED = OpenCampaign, type, Path


def reaches(value, obsid, depth=DEPTH):
    """Whether the obsid is in a value, or in one of its attributes or items, at most `depth` steps away."""
    if isinstance(value, str):
        return obsid in value and len(value) < LONGEST
    if depth == 0 or isinstance(value, SKIPPED):
        return False
    return any(reaches(part, obsid, depth - 1) for part in parts(value))


def parts(value):
    """Return the items of a container, or the attributes of an object of csstsim; of a partial, its arguments."""
    if isinstance(value, dict):
        return [part for item in list(value.items())[:ITEMS] for part in item]
    if isinstance(value, tuple | list | set | frozenset):
        return list(value)[:ITEMS]
    if isinstance(value, functools.partial):
        return [value.args, value.keywords]
    if type(value).__module__.startswith("csstsim."):
        return [getattr(value, name) for name in getattr(type(value), "__slots__", ()) if hasattr(value, name)] + [
            *getattr(value, "__dict__", {}).values()
        ]
    return []


@functools.cache
def module_of(file):
    """Return the path of a module of csstsim within the package; of another file None."""
    path = Path(file)
    return path.relative_to(SOURCE).as_posix() if path.is_relative_to(SOURCE) else None


def trace(obsid, run):
    """Return {module: types of what it held that has the obsid} for all modules that ran."""
    found = defaultdict(set)

    def look(frame, event, result):
        if event in ("call", "return") and (module := module_of(frame.f_code.co_filename)):
            seen = found[module]
            if frame.f_code.co_name != "<module>":
                values = *frame.f_locals.values(), result
                seen.update(type(value).__name__ for value in values if reaches(value, obsid))

    sys.setprofile(look)
    try:
        run()
    finally:
        sys.setprofile(None)
    return found


def main() -> None:
    """Run what is asked for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--campaign", default="config/campaign.yaml")
    parser.add_argument("--obsid", default="10100000004")
    parser.add_argument("--chip", default="9")
    with Record(parser) as record:
        count(record)


def count(record: Record) -> None:
    """Follow the obsid, and record through how many modules it passes; at toy size, of a chip of 128 px."""
    args, output = record.options, record.results / "obsid_path"
    if record.toy:
        output.mkdir(parents=True, exist_ok=True)
        args.campaign, args.obsid = (
            str(write_campaign(output, **toy_sky(output, 60.15, -40.0, 20))),
            "10100000001",
        )
    words = ["-q", "chip", args.campaign, "--obsid", args.obsid, "--chip", args.chip, "--output", str(output / "out")]
    sys.argv[1:] = words  # as a shell gives them
    found = trace(args.obsid, lambda: command(standalone_mode=False))
    passed = {module: what for module, what in found.items() if what}
    layers = [module for module in passed if module.startswith("layers/")]
    named = [module for module in found if re.search(r"\bobsid", (SOURCE / module).read_text(encoding="utf-8"))]
    for module, what in sorted(passed.items()):
        print(f"{module:40s} {', '.join(sorted(what))}")
    record.value("modules", len(found), "modules that ran")
    record.value("passed", len(passed), "modules through which the obsid passed")
    record.value("layers", len(layers), "of them layers")
    record.value("named", len(named), "modules that have the word in their code")


if __name__ == "__main__":
    main()
