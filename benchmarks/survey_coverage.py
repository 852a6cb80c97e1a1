"""How the shipped fields are covered: the part of each circle of 5 deg2 that each filter exposes once and twice.

python benchmarks/survey_coverage.py
"""

import argparse

from evidence.record import Record

import numpy as np
from make_tables import FIELDS, covered, wide_field

from csstsim.base.shipped import SHIPPED
from csstsim.instrument.camera import load_camera

SAMPLES, TOY_SAMPLES = 4000, 100  # points spread evenly over a circle


def main(record: Record) -> None:
    """Count the exposures of each point."""
    camera, twice, once, mean = load_camera(SHIPPED / "instrument"), {}, [], {}
    for name in list(FIELDS)[: 1 if record.toy else None]:
        ra, dec, *_ = FIELDS[name]
        exposures = wide_field(camera, name, "10199")
        for band, n in covered(camera, exposures, ra, dec, TOY_SAMPLES if record.toy else SAMPLES).items():
            once.append((n > 0).mean())
            twice.setdefault(band, []).append((n > 1).mean())
            mean.setdefault(band, []).append(n.mean())
    record.value(
        "once",
        min(once),
        "fraction of a field's circle that a filter exposes, minimum over fields and filters",
        above=0.999,
    )
    rows = [
        [band, f"{100 * min(part):.0f}% to {100 * max(part):.0f}%", f"{np.mean(mean[band]):.2f}"]
        for band, part in twice.items()
    ]
    record.table("twice", ["filter", "exposed twice or more, of the five fields", "mean exposures of a point"], rows)


if __name__ == "__main__":
    with Record(argparse.ArgumentParser(description=__doc__.splitlines()[0])) as record:
        main(record)
