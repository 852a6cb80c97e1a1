"""Numbers of galaxies, stars and quasars on an r-band chip at the centres of the five Cycle-9 fields, and the paper's.

    python benchmarks/c9_counts.py

One truth brick is made at each field's first exposure; its counts are scaled to the area of a chip.
"""

import argparse
import time

from evidence.record import Record

import healpy
import numpy as np

from csstsim.base.healpix import NSIDE
from csstsim.base.shipped import SHIPPED
from csstsim.campaign.sections import Lensing
from csstsim.campaign.survey_table import load_survey_table
from csstsim.catalog.truth_bricks import AREA_DEG2, make_brick
from csstsim.instrument.camera import load_camera
from csstsim.universe.dust.dust_map import galactic
from csstsim.universe.parameters import load_universe

SEED = 9
PAPER = (71_479, 5_159)
LIMITS = (24.0, 26.0)  # r, AB


def main(record: Record) -> None:
    """Make a brick at each field, and record its counts on a chip."""
    universe, camera = load_universe(SHIPPED / "universe"), load_camera(SHIPPED / "instrument")
    chip = camera.chips[9]
    share = chip.full_window.nx * chip.full_window.ny * (camera.telescope.pixel_scale / 3600) ** 2 / AREA_DEG2
    head = [
        "field",
        "l",
        "b",
        "galaxies",
        "stars",
        *(f"stars r < {m:g}" for m in LIMITS),
        "quasars",
        "A(V)",
        "CPU s a brick",
    ]
    lines, stars_of = [], []
    for field in range(1, 2 if record.toy else 6):
        table = load_survey_table(SHIPPED.parent / "survey_tables" / f"w{field}.csv", camera.orbit)
        first = next(iter(table.values()))
        pix = int(healpy.ang2pix(NSIDE, first.ra, first.dec, nest=True, lonlat=True))
        start = time.process_time()
        table = make_brick(SEED, pix, universe, camera, Lensing(), "none")
        cpu = time.process_time() - start
        lon, lat = (float(v) for v in galactic(first.ra, first.dec))
        stars, galaxies, quasars = (table.take(table["obj_type"] == kind) for kind in range(3))
        cells = [f"W{field}", f"{lon:.0f}", f"{lat:.0f}", f"{len(galaxies) * share:.0f}", f"{len(stars) * share:.0f}"]
        cells += [f"{(stars['mag_r'] < m).sum() * share:.0f}" for m in LIMITS]
        cells += [f"{len(quasars) * share:.0f}", f"{np.median(galaxies['av']):.2f}", f"{cpu:.1f}"]
        lines.append(cells)
        stars_of.append(len(stars) * share)
    lines.append(["paper", "", "", *map(str, PAPER), *[""] * 5])
    record.table("fields", head, lines)
    record.value("stars_min", round(min(stars_of), -1), "stars of an r image, the field with fewest")
    record.value("stars_max", round(max(stars_of), -1), "stars of an r image, the field with the most")


if __name__ == "__main__":
    with Record(argparse.ArgumentParser(description=__doc__.splitlines()[0])) as record:
        main(record)
