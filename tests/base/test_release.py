"""Campaign files of another layout and products of another release are refused, with advice."""

import json

import pyarrow.parquet as pq
import pytest
import yaml
from support.mini_campaign import write_campaign

from csstsim import __version__
from csstsim.base.errors import InputError
from csstsim.base.release import check_recipe, check_release, release
from csstsim.campaign.config import LAYOUTS, load_campaign
from csstsim.campaign.opened import OpenCampaign
from csstsim.catalog.truth_bricks import brick_meta
from csstsim.io.frames import save_frame
from csstsim.stages import calibrate as calibrate_stage
from csstsim.stages import level0 as level0_stage
from csstsim.stages import masters as masters_stage
from csstsim.stages import measure as measure_stage
from csstsim.stages import psf as psf_stage
from csstsim.stages import readout as readout_stage
from csstsim.stages import render as render_stage
from csstsim.stages import select as select_stage

OTHER = "made by another release of csstsim"


@pytest.mark.parametrize(
    ("version", "words"),
    [
        (0, ["older layout", "to change: ", LAYOUTS[1], "(got 0)"]),
        (max(LAYOUTS) + 1, ["newer csstsim", f"reads layout {max(LAYOUTS)}"]),
        (-1, ["reads layout"]), ("one", ["integer"]), (None, ["required key is missing"]), (True, ["not allowed here"]),
    ],
)  # fmt: skip
def test_layout_of_a_campaign_file(tmp_path, version, words):
    path = write_campaign(tmp_path)
    content = yaml.safe_load(path.read_text()) | {"schema_version": version, "key_of_another_layout": 1}
    if version is None:
        del content["schema_version"]
    path.write_text(yaml.safe_dump(content))
    with pytest.raises(InputError) as caught:
        load_campaign(path)
    assert all(word in str(caught.value) for word in ("campaign.yaml: schema_version: ", *words)), caught.value


def test_every_layout_says_what_to_change():
    assert list(LAYOUTS) == list(range(1, max(LAYOUTS) + 1)) and all(LAYOUTS.values())


def test_versions_of_one_release_go_together():
    assert release("1.2.3") == release("1.2.9") == "1.2" != release("1.3.0")
    check_release("x.fits", __version__)
    check_release("x.fits", release())
    for version in ("99.0.0", f"{release()}1.0", None, "", 7):
        with pytest.raises(InputError, match=rf"x\.fits: csstsim: {OTHER}.*remove it"):
            check_release("x.fits", version)


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """A campaign run from select to measure by another release."""
    import csstsim

    run = OpenCampaign(write_campaign(tmp_path_factory.mktemp("old"), catalog={
        "kind": "support.mini_campaign:Stars", "options": {"ra": [60.0], "dec": [-40.0], "mag": [18.0]}}))  # fmt: skip
    job = run.jobs[0]
    psf_stage.psf(run, job.chip.id)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("csstsim.campaign.recipes.release", lambda: "99.0")
        patch.setattr(csstsim, "__version__", "99.0.0")
        for stage in (select_stage.select, render_stage.render, readout_stage.readout, level0_stage.level0):
            stage(run, job)
    return run, job


@pytest.mark.parametrize(
    ("step", "file"),
    [
        (render_stage.render, "select.parquet"), (readout_stage.readout, "render.fits"),
        (level0_stage.level0, "readout.fits"),
        (calibrate_stage.calibrate, "L0_V01.fits"), (measure_stage.measure, "L0_V01.fits"),
        (level0_stage.truth_of, "L0_V01.truth.parquet"),
    ],
)  # fmt: skip
def test_a_stage_refuses_what_another_release_left(made, step, file):
    with pytest.raises(InputError, match=rf"{file}: csstsim: {OTHER}.*got '99\.0"):
        step(*made)


def test_a_frame_of_the_right_recipe_but_without_its_parts(made):
    from csstsim.io.frames import load_frame

    run, job = made
    path = run.paths.stage(*job.key, "render.fits")
    kept = path.read_bytes()
    planes, meta = load_frame(path)
    whole = meta | {"recipe": run.recipe(job, "render")}
    without_unit = {key: value for key, value in whole.items() if key != "unit"}
    for parts in (({}, whole), (planes, without_unit)):
        save_frame(path, *parts)
        with pytest.raises(InputError, match=r"render\.fits: damaged: it lacks the plane image"):
            readout_stage.readout(run, job)
    save_frame(path, planes, whole)
    readout_stage.readout(run, job)
    path.write_bytes(kept)


def test_psf_sets_bricks_and_masters(made, tmp_path, monkeypatch):
    run, job = made
    with monkeypatch.context() as patch:
        patch.setattr("csstsim.base.release.__version__", "99.0.0")
        patch.setattr("csstsim.base.release.release.__defaults__", ("99.0.0",))
        with pytest.raises(InputError, match=rf"chip_09\.h5: csstsim: {OTHER}.*'{__version__}'.*allowed: 99\.0"):
            psf_stage.open_psf(run, job.chip)
        there = brick_meta(1, 2, run.universe, run.camera, run.config.catalog.lensing)
    here = brick_meta(1, 2, run.universe, run.camera, run.config.catalog.lensing)
    assert there | {"csstsim": release()} == here != there
    record = masters_stage.masters_recipe(run, job.chip.id) | {"csstsim": "99.0.0", "offset": {}}
    save_frame(tmp_path / "masters.fits", {}, record)
    monkeypatch.setattr(OpenCampaign, "masters", lambda self, chip: tmp_path / "masters.fits")
    with pytest.raises(InputError, match=rf"masters\.fits: csstsim: {OTHER}"):
        calibrate_stage._by_masters(run, job, None)


def test_merged_and_validated_bricks_say_who_made_them(made):
    run, _ = made
    pix = next(iter(run.merge_bricks))
    with pytest.raises(InputError, match=OTHER):
        check_recipe("7.json", {"csstsim": "99.0.0", "recipe": "0"}, run.brick_recipe(pix))
    with pytest.raises(InputError, match="another campaign"):
        check_recipe("7.json", {"csstsim": __version__, "recipe": "0"}, run.brick_recipe(pix))


def test_the_record_is_in_the_files(made):
    run, job = made
    path = run.paths.level0_truth(job)
    assert json.loads(pq.read_schema(path).metadata[b"csstsim"])["recipe"]["csstsim"] == "99.0"
