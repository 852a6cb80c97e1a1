"""Do all subsets of the layers, options, fidelities and objects render the same flux with Poisson noise?

    python benchmarks/every_subset.py [--count 240]

Prints one line per subset as it is drawn, and records the largest departure of each kind in units of its error;
tests/support/light_subsets.py defines the departures. Half an hour.
"""

import argparse
import tempfile

from evidence.record import Record

import numpy as np
from support.light_subsets import departures, subsets

COUNT, LIMIT = 240, 5.0
TOY_COUNT, TOY_BAND = 3, "r"
HEADER = "departure", "subsets", "largest", "rms", "where it is largest"


def main(record: Record) -> None:
    """Draw the subsets; record the largest departure of each kind."""
    found = {}
    some = subsets(record.options.count)
    if record.toy:
        some = [subset for subset in some if subset.band == TOY_BAND and subset.fidelity != "reference"][:TOY_COUNT]
    with tempfile.TemporaryDirectory() as cache:
        for subset in some:
            values = departures(subset, cache)
            for name, value in values.items():
                found.setdefault(name, []).append((value, subset))
            print(subset, " ".join(f"{name} {value:+.2f}" for name, value in values.items()), sep=" | ", flush=True)
    rows = []
    for name, pairs in found.items():
        values = np.array([value for value, _ in pairs])
        worst = np.abs(values).argmax()
        rms = np.sqrt((values**2).mean())
        rows.append([name, len(values), f"{values[worst]:+.2f}", f"{rms:.2f}", pairs[worst][1]])
    record.table("departures", HEADER, rows)
    largest = max(abs(value) for pairs in found.values() for value, _ in pairs)
    record.value("subsets", len(some), "subsets rendered")
    record.value("largest", largest, "largest departure, in units of its error", below=LIMIT)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--count", type=int, default=COUNT, help="subsets")
    with Record(parser) as record:
        main(record)
