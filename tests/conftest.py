"""Fixtures shared by many tests: the shipped camera, a pointing, a small PSF set."""

import gc
import os

# Before numpy is loaded: two threads in each of two workers wait for each other, at several times the CPU time.
# What many threads make is the same: tests/base/process/test_one_thread.py
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from pathlib import Path

import pytest
from delivery.small_delivery import delivery
from support.readout_state import small_camera

from csstsim.base.shipped import SHIPPED
from csstsim.campaign.opened import OpenCampaign
from csstsim.catalog.astrometry.ephemeris import observer
from csstsim.instrument.camera import load_camera
from csstsim.instrument.pointing import Pointing
from csstsim.optics.psf.psf_file import PsfSet
from csstsim.optics.psf.psf_set import PsfSampling, make_psf
from csstsim.optics.scatter.scattered_light import scattered_light
from csstsim.render.psf_table import make_table

TESTS = Path(__file__).resolve().parent
ROOT = TESTS.parent
# Of the processes that tests start, as pytest's own (pyproject.toml)
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
os.environ["PYTHONPATH"] = os.pathsep.join(str(ROOT / name) for name in ("src", "tests", "builders"))

# Folders and files whose tests share a finished campaign: one worker makes it
FINISHED = "compare", "delivery", "release", "test_products.py", "test_table_schema.py"
# Folders and files in the order in which they are begun, the others last. While one worker compiles the chain for the
# finished campaign, the other has a minute of tests that need little compiled; short ones come last, so that both end
# together
LITTLE_COMPILED = (
    "fuzz", "universe", "instrument", "profiles", "mutants", "doctor", "docs", "test_extended.py", "test_recipe.py",
    "test_survey_table.py", "test_unsupported_shapes.py",
)  # fmt: skip
BEGUN = FINISHED, LITTLE_COMPILED, ("end_to_end", "workflow")


@pytest.hookimpl(wrapper=True)
def pytest_collection():
    """Nothing that collection makes is garbage; to search it takes a third of the time."""
    gc.disable()
    try:
        return (yield)
    finally:
        gc.freeze()
        gc.enable()


def pytest_collection_modifyitems(items):
    def turn(item):
        names = set(item.path.relative_to(TESTS).parts)
        return next((i for i, group in enumerate(BEGUN) if names.intersection(group)), len(BEGUN))

    items.sort(key=turn)


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config, log):
    """Tests of a file go to one worker, for what they share, and so do those of FINISHED."""
    from xdist.scheduler import LoadScopeScheduling

    class ByFile(LoadScopeScheduling):
        def _split_scope(self, nodeid):
            file = Path(nodeid.split("::")[0])
            return "finished" if set(file.parts) & set(FINISHED) else str(file)

    return ByFile(config, log)


@pytest.fixture(scope="session")
def sound(tmp_path_factory):
    """(campaign file, its output folder) of a finished campaign; nothing is to be changed in it."""
    file = delivery(tmp_path_factory.mktemp("delivery"))
    return file, OpenCampaign(file).paths.output


@pytest.fixture(scope="session")
def camera():
    return load_camera(SHIPPED / "instrument")


@pytest.fixture(scope="session")
def small(tmp_path_factory):
    """A camera of small chips (mini.mini_camera), in a folder of its own."""
    return small_camera(tmp_path_factory.mktemp("mini"))


@pytest.fixture(scope="session")
def make_pointing():
    """Return a science pointing; keywords change its fields."""

    def make(**fields):
        values = {
            "type": "SCIE", "ra": 60.0, "dec": -40.0, "pa": -113.4333,
            "time": "2027-06-26T20:35:58", "exptime": 150.0,
            "sat_position": (6778.0, 0.0, 0.0), "sat_velocity": (0.0, 7.0, 3.0),
        }  # fmt: skip
        return Pointing(**(values | fields))

    return make


@pytest.fixture(scope="session")
def observe():
    """Return the Observer of a Pointing."""
    return lambda pointing: observer(pointing.mjd, pointing.sat_position, pointing.sat_velocity)


@pytest.fixture(scope="session")
def psf_r(camera, tmp_path_factory):
    """A 2 x 2-node PSF set of chip 9 (r band), with its halo."""
    path = tmp_path_factory.mktemp("psf") / "chip_09.h5"
    chip = camera.chips[9]
    scattered = scattered_light(camera, camera.filters["r"])
    make_psf(
        path, chip, camera.filters["r"], camera.psf, PsfSampling(2), camera_digest=camera.digest,
        scattered=scattered,
    )  # fmt: skip
    return PsfSet(path, chip=9)


@pytest.fixture(scope="session")
def psf_tables(psf_r):
    """The tables from which photons are drawn, of psf_r."""
    return make_table(psf_r)
