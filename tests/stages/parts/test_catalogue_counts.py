"""Numbers of the catalogue's objects on a frame and a brick, against the truth of the frame and the universe's laws."""

import numpy as np
import pytest
from support.csst import BANDS
from support.mini_campaign import POINTINGS, write_campaign

from csstsim.base.rng import stream
from csstsim.campaign.opened import OpenCampaign
from csstsim.catalog.selection.positions import objects_near
from csstsim.catalog.table import GALAXY, QUASAR, STAR, ObjectTable
from csstsim.stages.parts.catalogue_counts import BrickObjects, brick_objects

COUNT = 3000


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    return OpenCampaign(write_campaign(tmp_path_factory.mktemp("counts"), POINTINGS[:1], catalog={"mag_limit": 24.0}))


@pytest.fixture(scope="module")
def brick(run):
    """A brick of objects about the frame's window, a third of each kind, of 22 to 26 mag; some are magnified."""
    job, rng = run.imaging_jobs[0], stream(3, "counts")
    pix = next(iter(run.merge_bricks))
    ra, dec = job.footprint()
    kind = np.arange(COUNT) % 3
    table = ObjectTable({
        "ra": rng.uniform(ra.min() - 0.002, ra.max() + 0.002, COUNT),
        "dec": rng.uniform(dec.min() - 0.002, dec.max() + 0.002, COUNT), "obj_type": kind,
        "kappa": np.where((kind == GALAXY) & (np.arange(COUNT) % 2 == 0), 0.2, 0.0), "gamma1": np.zeros(COUNT),
        "gamma2": np.zeros(COUNT), **{f"mag_{band}": rng.uniform(22.0, 26.0, COUNT) for band in BANDS},
    })  # fmt: skip
    path = run.paths.truth(pix)
    path.parent.mkdir(parents=True, exist_ok=True)
    table.write(path)
    return pix, table


def test_what_is_on_the_window_and_bright_enough_is_counted(run, brick):
    pix, table = brick
    job = run.imaging_jobs[0]
    rows, places = objects_near(
        table.with_columns(**dict.fromkeys(("pmra", "pmdec", "parallax", "rv"), np.zeros(COUNT))),
        job.wcs,
        job.observer,
        job.window,
        0.0,
        None,
    )
    window = job.window
    on = np.zeros(COUNT, bool)
    x, y = places["x"], places["y"]
    on[rows] = (abs(x - window.x0 - window.nx / 2 + 0.5) < window.nx / 2) & (
        abs(y - window.y0 - window.ny / 2 + 0.5) < window.ny / 2
    )
    mag = table[f"mag_{job.chip.filter}"] + 5 * np.log10(1 - table["kappa"])  # no shear: mu = 1 / (1 - kappa)^2
    wanted = {name: int((on & (mag <= 24.0) & (table["obj_type"] == k)).sum()) for name, k in
              (("galaxies", GALAXY), ("stars", STAR))}  # fmt: skip
    assert BrickObjects(run, pix).on_frame(job) == wanted and wanted["galaxies"] > wanted["stars"] > 50


def test_the_laws_are_those_of_the_universe(run, brick):
    pix, table = brick
    laws = BrickObjects(run, pix).laws()
    assert [laws[name][0] for name in ("galaxies", "stars")] == [COUNT // 3, COUNT // 3]
    assert (table["obj_type"] == QUASAR).sum() == COUNT // 3
    area = 3600 * 4 * 180**2 / np.pi / (12 * 256**2)  # arcmin2
    assert laws["galaxies"][1] == pytest.approx(run.universe.numbers["galaxies"]["density"] * area, rel=0.01)
    assert 200 < laws["stars"][1] < 20_000


def test_no_brick_no_counts(run):
    assert brick_objects(run, 0) is None
