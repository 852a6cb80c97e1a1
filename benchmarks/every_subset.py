"""Do all subsets of the light's layers, options, fidelities and objects draw the same light with Poisson noise?

    PYTHONPATH=tests:builders python benchmarks/every_subset.py [COUNT]

Prints one line per subset as it is drawn, then the largest departure of each kind in units of its error;
tests/light_subsets.py defines the departures. Exit code 1 if one is above LIMIT.
"""

import sys
import tempfile

import numpy as np
from light_subsets import departures, subsets

COUNT, LIMIT = 240, 5.0


def main(count):
    """Draw `count` subsets; print their departures and the largest of each kind."""
    found = {}
    with tempfile.TemporaryDirectory() as cache:
        for subset in subsets(count):
            values = departures(subset, cache)
            for name, value in values.items():
                found.setdefault(name, []).append((value, subset))
            print(subset, " ".join(f"{name} {value:+.2f}" for name, value in values.items()), sep=" | ", flush=True)
    print(f"\n| departure | subsets | largest | rms | where it is largest |\n|{'---|' * 5}")
    for name, pairs in found.items():
        values = np.array([value for value, _ in pairs])
        worst = np.abs(values).argmax()
        print(
            f"| {name} | {len(values)} | {values[worst]:+.2f} | {np.sqrt((values**2).mean()):.2f} | {pairs[worst][1]} |"
        )
    return int(max(abs(value) for pairs in found.values() for value, _ in pairs) > LIMIT)


if __name__ == "__main__":
    sys.exit(main(int(sys.argv[1]) if len(sys.argv) > 1 else COUNT))
