"""What is said of the objects selected, and who owns an entry of a catalogue."""

from types import SimpleNamespace

import numpy as np
import pytest
from support.mini_campaign import POINTINGS, write_campaign

from csstsim.base.errors import InputError
from csstsim.campaign.opened import OpenCampaign
from csstsim.catalog.table import STAR, ObjectTable
from csstsim.instrument.chip import Window
from csstsim.stages.parts.contamination import owners
from csstsim.stages.parts.report_pictures import _caption, by_exposure, middle
from csstsim.stages.select import _changing, check_catalog, log_selected


@pytest.mark.parametrize(("count", "words"), [(0, "0 objects reach"), (1, "1 object reaches"), (3, "3 objects reach")])
def test_how_many_objects_reach_the_window_and_why_others_do_not(camera, count, words):
    logged = []
    table = ObjectTable.complete({"obj_type": np.full(count, STAR)}, camera.bands)
    table.meta["dropped"] = {"outside": 7, "faint": 5}
    log_selected(table, logged.append)
    assert logged == [f"{words} the window; left out: 7 outside it, 5 fainter than mag_limit"]


def test_an_entry_is_of_the_nearest_object_alone():
    """The second object is nearer to entry 1 than the first; the third is out of reach along y only."""
    x, y = np.array([10.0, 12.5, 40.0, np.nan, 50.0]), np.array([20.0, 20.0, 30.0, 5.0, 60.0])
    known_x, known_y = np.array([50.4, 12.0, 40.0]), np.array([60.3, 20.0, 33.5])
    assert owners(x, y, known_x, known_y, 3.0).tolist() == [-1, 1, -1, -1, 0]
    assert owners(x, y, known_x, known_y, 3.6).tolist() == [-1, 1, 2, -1, 0]
    assert owners(x[:0], y[:0], known_x, known_y, 3.0).tolist() == []


def test_the_middle_of_a_window_is_cut_along_each_side():
    assert middle(Window(10, 110, 200, 230), 40) == Window(40, 80, 200, 230)
    assert middle(Window(0, 31, 5, 100), 50) == Window(0, 31, 27, 77)


def test_jobs_are_sorted_by_exposure_in_their_order():
    jobs = [SimpleNamespace(obsid=obsid, n=n) for n, obsid in enumerate("babca")]
    found = by_exposure(SimpleNamespace(jobs=jobs))
    assert [[job.n for job in some] for some in found] == [[0, 2], [1, 4], [3]]


def test_the_caption_has_bands_frames_and_sides():
    grid = SimpleNamespace(shape=(400, 800), scale=0.15)
    logged = _caption({"g": [1, 2], "r": [1, 2], "i": [1, 2]}, grid)
    assert logged.startswith(
        "g, r, i as blue, green and red: 6 exposures, 2.0' x 1.0'. North is up, east to the left; "
    )
    assert logged.endswith("saturated pixels white.")
    logged = _caption({"r": [1]}, grid)
    assert logged.startswith("r in grey: 1 exposure, 2.0' x 1.0'") and logged.endswith(
        "Cosmic rays remain in bands of one exposure."
    )


@pytest.mark.parametrize(("keys", "moving"), [
    ({"asteroids": True}, True), ({"satellites": True}, True), ({"variable_stars": True}, False), ({}, False),
])  # fmt: skip
def test_moving_objects_are_those_of_the_campaigns_seed_and_of_the_exposure(tmp_path, monkeypatch, keys, moving):
    """Of either kind alone; variable stars need none of them."""
    run = OpenCampaign(write_campaign(tmp_path, POINTINGS[:1], catalog=keys, seed=77))
    exposure = run.jobs[0].exposure
    monkeypatch.setattr("csstsim.catalog.changing.visitors.visitors", lambda *given: given)
    made = _changing(run, exposure)
    assert made.pop("varying") == tuple(keys)
    where = exposure.pointing, exposure.observer, exposure.interval
    assert made == ({"visitors": (tuple(keys), 77, run.universe, run.camera, *where)} if moving else {})


def test_a_catalogue_is_tried_until_a_chip_has_objects(tmp_path):
    """The first exposure looks elsewhere, the second sees the star of the table."""
    rows = POINTINGS[0].replace("60.15,-40.0", "70.15,-40.0"), POINTINGS[1]
    star = OpenCampaign(write_campaign(tmp_path, rows)).job("10100000002", 9)
    ra, dec = (float(v.mean()) for v in star.footprint())
    catalog = {"kind": "csstsim.catalog.own_table:TableCatalog"}
    options = {"columns": {"ra": [ra], "dec": [dec], "mag_r": [20.0]}}
    run = OpenCampaign(write_campaign(tmp_path, rows, catalog=catalog | {"options": options}))
    assert [job.obsid for job in run.imaging_jobs] == ["10100000001", "10100000002"]
    logged = []
    check_catalog(run, logged.append)
    assert logged[-1] == "1 of them is near what chip 9 sees in exposure 10100000002"
    options["columns"]["dec"] = [-dec]
    run = OpenCampaign(write_campaign(tmp_path, POINTINGS[:1], catalog=catalog | {"options": options}))
    with pytest.raises(InputError, match="no object of the catalogue reaches any chip"):
        check_catalog(run, logged.append)
