"""The shipped embedded universe for tests, loaded once, because its band tables take seconds."""

import shutil
import tempfile
from functools import cache
from pathlib import Path

import yaml

from csstsim.base.shipped import SHIPPED
from csstsim.campaign.sections import Lensing
from csstsim.catalog.embedded import EmbeddedCatalog
from csstsim.catalog.truth_bricks import make_brick, write_brick
from csstsim.instrument.camera import load_camera
from csstsim.universe.parameters import load_universe

SEED = 7
DENSITY = 30.0  # galaxies per arcmin2, instead of 552: a brick in a second


@cache
def universe_folder():
    """Return a copy of the shipped universe with few galaxies; it goes with the process."""
    folder = tempfile.TemporaryDirectory()
    copy = Path(shutil.copytree(SHIPPED / "universe", Path(folder.name) / "universe"))
    galaxies = yaml.safe_load((copy / "galaxies.yaml").read_text())
    galaxies["density"]["value"] = DENSITY
    (copy / "galaxies.yaml").write_text(yaml.safe_dump(galaxies))
    universe_folder.kept = folder
    return copy


@cache
def shipped():
    """Return (universe, camera)."""
    return load_universe(universe_folder()), load_camera(SHIPPED / "instrument")


def key(lensing=None, seed=SEED, structure="none"):
    """What bricks are made for, as the catalogue and `write_brick` take it."""
    universe, camera = shipped()
    made_for = {"seed": seed, "universe": universe, "camera": camera, "structure": structure}
    return made_for | {"lensing": lensing or Lensing()}


@cache
def brick(pix, seed=SEED, structure="none"):
    return make_brick(pix=pix, **key(seed=seed, structure=structure))


def embedded_catalog(folder, region, lensing=None):
    """Write the bricks of `region` below `folder` and open them."""
    options = key(lensing)
    for pix in region.bricks:
        write_brick(folder / f"{pix}.parquet", pix, **options)
    return EmbeddedCatalog({"brick_file": lambda pix: folder / f"{pix}.parquet", **options}, region)
