"""Ratio of the bound of an object's electrons through a grating to the true number (catalog.light.grating_bound).

python benchmarks/grating_bound.py [--brick 300000]       (a minute of CPU)
"""

import argparse
import tempfile
from pathlib import Path
from types import SimpleNamespace

import numpy as np

from csstsim.base.shipped import SHIPPED
from csstsim.campaign.sections import Lensing
from csstsim.catalog.embedded import EmbeddedCatalog
from csstsim.catalog.light.grating_bound import band_shares
from csstsim.catalog.table import TYPES
from csstsim.catalog.truth_bricks import write_brick
from csstsim.instrument.camera import load_camera
from csstsim.universe.parameters import load_universe


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--brick", type=int, default=300000)
    pix, camera = parser.parse_args().brick, load_camera(SHIPPED / "instrument")
    universe = load_universe(SHIPPED / "universe")
    made_for = {"seed": 1, "universe": universe, "camera": camera, "lensing": Lensing(), "structure": "none"}
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "brick.parquet"
        write_brick(file, pix, **made_for)
        whole = SimpleNamespace(bricks=(pix,), contains=lambda ra, dec: np.ones(len(ra), bool))
        catalog = EmbeddedCatalog({"brick_file": lambda _: file, **made_for}, whole)
    table, rows = catalog.table, np.arange(len(catalog.table))
    bands = tuple(band for band in camera.filters.values() if band.kind == "imaging")
    for filter in (f for f in camera.filters.values() if f.kind == "slitless"):
        bound = catalog.rate_bound(rows, filter, camera.telescope)
        true = catalog.load_fluxes(rows, filter, camera.telescope).sum(axis=1)
        print(filter.name, ", ".join(f"{share:.3f} {band.name}" for band, share in band_shares(filter, bands)))
        for kind, name in enumerate(TYPES):
            some = (table["obj_type"] == kind) & (true > 0)
            least, middle, most = np.percentile(bound[some] / true[some], [0, 50, 90])
            print(
                f"  {some.sum():7d} {name:7s} bound / electrons: least {least:.2f}, median {middle:.2f}, 90% {most:.2f}"
            )


if __name__ == "__main__":
    main()
