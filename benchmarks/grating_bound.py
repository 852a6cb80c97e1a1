"""Ratio of the bound of an object's electrons through a grating to the true number (catalog.light.grating_bound).

python benchmarks/grating_bound.py [--brick 300000]       (a minute of CPU)
"""

import argparse
import tempfile
from pathlib import Path
from types import SimpleNamespace

from evidence.record import Record

import numpy as np

from csstsim.base.shipped import SHIPPED
from csstsim.campaign.sections import Lensing
from csstsim.catalog.embedded import EmbeddedCatalog
from csstsim.catalog.light.grating_bound import band_coefficients
from csstsim.catalog.table import GALAXY, STAR, TYPES
from csstsim.catalog.truth_bricks import write_brick
from csstsim.instrument.camera import load_camera
from csstsim.universe.parameters import load_universe

TOY_ROWS = 500  # objects, at the size of seconds: every so many of the brick's


def main(record: Record) -> None:
    """Record the ratio for each grating and kind of object."""
    pix, camera = record.options.brick, load_camera(SHIPPED / "instrument")
    universe, lensing = load_universe(SHIPPED / "universe"), Lensing(field="none") if record.toy else Lensing()
    made_for = {"seed": 1, "universe": universe, "camera": camera, "lensing": lensing, "structure": "none"}
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "brick.parquet"
        write_brick(file, pix, **made_for)
        whole = SimpleNamespace(bricks=(pix,), contains=lambda ra, dec: np.ones(len(ra), bool))
        catalog = EmbeddedCatalog({"brick_file": lambda _: file, **made_for}, whole)
    count = len(catalog.table)
    rows = np.arange(0, count, max(count // TOY_ROWS, 1)) if record.toy else np.arange(count)
    table = catalog.table.take(rows)
    bands = tuple(band for band in camera.filters.values() if band.kind == "imaging")
    lines, all_ratios = [], []
    for filter in (f for f in camera.filters.values() if f.kind == "slitless"):
        bound = catalog.rate_bound(rows, filter, camera.telescope)
        true = catalog.load_fluxes(rows, filter, camera.telescope).sum(axis=1)
        lit = true > 0
        ratio = np.full(len(true), np.nan)
        ratio[lit] = bound[lit] / true[lit]
        all_ratios.append(ratio[lit])
        shares = ", ".join(
            f"{share:.2f} {band.name}" for band, share in band_coefficients(filter, bands) if share > 0.005
        )
        of_kind = [ratio[lit & (table["obj_type"] == kind)] for kind in range(len(TYPES))]
        for kind, some in enumerate(of_kind):
            if len(some):
                least, middle, most = np.percentile(some, [0, 50, 90])
                about = f"{filter.name} {TYPES[kind]}: {len(some)}"
                print(f"{about}, minimum {least:.2f}, median {middle:.2f}, 90% {most:.2f}")
        medians = (f"{np.median(of_kind[kind]):.2f}" if len(of_kind[kind]) else "" for kind in (STAR, GALAXY))
        lines.append([filter.name, shares, f"{np.nanmin(ratio):.2f}", *medians])
    head = ["", "bands", "minimum bound / electrons", "median, stars", "median, galaxies"]
    record.table("ratio", head, lines)
    for kind, name in ((STAR, "stars"), (GALAXY, "galaxies")):
        record.value(name, int((table["obj_type"] == kind).sum()), f"{name} of the brick")
    least = min(values.min() for values in all_ratios)
    record.value("least", least, "bound over electrons, minimum over objects and gratings", above=1)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--brick", type=int, default=300000)
    with Record(parser) as record:
        main(record)
