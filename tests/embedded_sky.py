"""The shipped embedded universe for tests, loaded once; its band tables cost seconds and stay with it."""

from functools import cache

from csstsim.catalog.embedded import EmbeddedCatalog
from csstsim.config import SHIPPED, Lensing
from csstsim.instrument.camera import load_camera
from csstsim.universe.bricks import make_brick, write_brick
from csstsim.universe.numbers import load_universe

SEED = 7
UNIVERSE = SHIPPED / "universe"


@cache
def shipped():
    """Return (universe, camera)."""
    return load_universe(UNIVERSE), load_camera(SHIPPED / "instrument")


def key(lensing=None, seed=SEED):
    """What bricks are made for, as the catalogue and `write_brick` take it."""
    universe, camera = shipped()
    return {"seed": seed, "universe": universe, "camera": camera, "lensing": lensing or Lensing()}


@cache
def brick(pix, seed=SEED):
    return make_brick(pix=pix, **key(seed=seed))


def embedded_catalog(folder, region, lensing=None):
    """Write the bricks of `region` below `folder` and open them."""
    options = key(lensing)
    for pix in region.bricks:
        write_brick(folder / f"{pix}.parquet", pix, **options)
    return EmbeddedCatalog({"brick_file": lambda pix: folder / f"{pix}.parquet", **options}, region)
