"""Cost of every layer after the objects on a whole chip, compared with numpy, scipy, GalSim, astropy and arcticpy.

    python benchmarks/readout.py

The first part of `csstsim bench --readout` (csstsim.studies.bench.readout.layers), at 40 and 4 electrons of sky. Its
second part, speed against accuracy of charge transfer, is in benchmarks/cti.py.
"""

import argparse

from evidence.record import Record

from csstsim.instrument.chip import Window
from csstsim.studies.bench.readout.arctic import INSTALLED
from csstsim.studies.bench.readout.layers import SKIES, TOTAL, layer_costs

TOY_WINDOW = Window(4096, 5120, 4104, 5128)  # contains the corner of four channels


def main(record: Record) -> None:
    """Record the seconds of each layer, and of those that do the same work."""
    costs = list(layer_costs(record.results / "readout", SKIES, TOY_WINDOW if record.toy else None))
    others, rows = costs[0][2], []
    for layer in costs[0][1]:
        peers = ", ".join(f"{name} {seconds:.1f}" for name, seconds in others.get(layer, {}).items())
        name = layer if " " in layer else f"`{layer}`"
        rows.append([name, *(f"{took[layer]:.2f}" for _, took, _ in costs), peers])
    header = ["layer", *(f"{sky:g} e- of sky, CPU s" for sky, _, _ in costs), f"others, {costs[0][0]:g} e-"]
    record.table("costs", header, rows)
    for sky, took, _ in costs:
        record.value(f"all_{sky:g}", took[TOTAL], f"readout and file, sky of {sky:g} e-", unit="CPU-s")
    if not INSTALLED:
        record.skip("arcticpy", "not installed")


if __name__ == "__main__":
    with Record(argparse.ArgumentParser(description=__doc__.splitlines()[0])) as record:
        main(record)
