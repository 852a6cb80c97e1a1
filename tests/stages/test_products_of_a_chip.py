"""What a chip that is made in memory leaves on disk: its files, the budget of its electrons, its owner's name."""

import json

import numpy as np
import pytest
import yaml
from support.mini_campaign import write_campaign

from csstsim.base.errors import InputError
from csstsim.base.shipped import SHIPPED
from csstsim.campaign.opened import OpenCampaign
from csstsim.catalog.table import ObjectTable
from csstsim.io.frames import load_frame
from csstsim.io.level0 import read_level0
from csstsim.io.output_owner import OWNER_FILE
from csstsim.io.truth import read_truth
from csstsim.stages.chip import chip
from csstsim.stages.level0 import level0
from csstsim.stages.readout import readout
from csstsim.stages.render import render

DARK = "10200000001,DARK,0,0,0,2027-11-20T02:00:00,300"
FLAT = "10200000002,FLAT,0,0,0,2027-11-20T03:00:00,150"
WINDOW = {"x0": 10, "x1": 70, "y0": 5, "y1": 45}


def opened(folder, row=DARK, layers=(), **changes):
    """A campaign of one exposure without a sky; layers: changes to the shipped list, {keyword: parameters}."""
    kind = row.split(",")[1]
    shipped = yaml.safe_load(
        (SHIPPED / "observations" / f"{'led_flat' if kind == 'FLAT' else 'dark'}.yaml").read_text()
    )
    mine = [
        {name: (param or {}) | dict(layers).get(name, {}) for name, param in one.items()} for one in shipped["layers"]
    ]
    mine = [{name: {}} for name in dict(layers) if "." in name] + mine
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "layers.yaml").write_text(yaml.safe_dump({"layers": mine}))
    given = {"observations": {kind: str(folder / "layers.yaml")}, "select": {"types": [kind], "chips": [9]}}
    run = OpenCampaign(write_campaign(folder, [row], **(given | changes)))
    return run, run.jobs[0]


def quiet(_):
    """Log nothing."""


def test_the_budget_of_electrons_is_that_of_the_windows_pixels(tmp_path):
    run, job = opened(tmp_path, window=WINDOW)
    chip(run, job, quiet)
    table = read_truth(run.paths.level0_truth(job))
    budget, header = table.meta["electrons"], read_level0(run.paths.level0(job)).header
    assert budget["dark"] == pytest.approx(300.0 * run.camera.detector.dark * 60 * 40)
    assert budget["light"] == 0.0 and budget["rays"] == header["CRCHARGE"]
    assert (table.meta["level0"], table.meta["full_well"]) == (
        run.paths.level0(job).name, run.camera.detector.full_well
    )  # fmt: skip
    owner = json.loads((run.paths.output / OWNER_FILE).read_text())
    assert owner["name"] == "mini"


def test_charge_of_a_layer_of_ones_own_makes_no_budget(tmp_path, monkeypatch):
    (tmp_path / "stickers").mkdir()
    (tmp_path / "stickers" / "blot.py").write_text(
        "from csstsim.layers.param import LayerParam as Param\n"
        'STAGE, UNITS = "readout", ("electron", "electron")\n'
        "def apply(state, param, rng):\n    state.image += 5\n    return state\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    run, job = opened(tmp_path, layers=[("stickers.blot", {})], window=WINDOW)
    chip(run, job, quiet)
    assert "electrons" not in read_truth(run.paths.level0_truth(job)).meta


def test_a_folder_of_another_campaign_keeps_its_files(tmp_path):
    run, job = opened(tmp_path, window=WINDOW)
    run.paths.output.mkdir()
    (run.paths.output / OWNER_FILE).write_text(json.dumps({"name": "theirs", "file": "../theirs.yaml"}))
    with pytest.raises(InputError, match="belongs to another campaign"):
        chip(run, job, quiet)
    assert [path.name for path in run.paths.output.iterdir() if path.name != "psf"] == [OWNER_FILE]


def test_rays_are_beside_the_file_where_the_list_asks_for_them(tmp_path):
    run, job = opened(tmp_path, layers={"cosmic_rays": {"save_cosmic_image": True}}.items(), window=WINDOW)
    chip(run, job, quiet)
    planes, meta = load_frame(run.paths.level0_cosmic(job))
    assert planes["cosmic"].shape == (40, 60) and meta["recipe"] == run.recipe(job, "readout")
    assert planes["cosmic"].sum() == read_level0(run.paths.level0(job)).header["CRCHARGE"]


def test_the_truth_as_text_has_the_names_of_the_campaigns_form(tmp_path):
    """C5.2: next to the file under its name, and as MSC_{obsid}_chip_{chip}_filt_{filter}."""
    run, job = opened(tmp_path, window=WINDOW, level0_names="C5.2", truth=["parquet", "cat"])
    chip(run, job, quiet)
    folder = run.paths.level0(job).parent
    texts = {path.name: path.read_text() for path in folder.glob("*.cat")}
    assert set(texts) == {f"{run.paths.level0(job).stem}.cat", "MSC_10200000001_chip_09_filt_r.cat"}
    assert len(set(texts.values())) == 1 and next(iter(texts.values())).startswith("# obj_ID ")


def test_objects_that_were_rendered_for_another_campaign_are_refused(tmp_path):
    """By stages on disk; the same by what is in memory: a lamp's light is the same bits."""
    run, job = opened(tmp_path, FLAT, window=WINDOW)
    render(run, job)
    readout(run, job)
    path = run.paths.stage(*job.key, "drawn.parquet")
    table, recipe = ObjectTable.read(path), run.recipe(job, "render")
    table.write(path, {"recipe": recipe | {"camera": "z" * 16}})
    with pytest.raises(InputError, match=r"drawn\.parquet"):
        level0(run, job)
    assert not run.paths.level0(job).exists()
    table.write(path, {"recipe": recipe})
    level0(run, job)
    pixels = read_level0(run.paths.level0(job)).frame()
    run.paths.level0(job).unlink()
    chip(run, job, quiet)
    assert np.array_equal(read_level0(run.paths.level0(job)).frame(), pixels) and np.ptp(pixels) > 1000


def test_orders_that_were_rendered_for_another_campaign_are_refused(tmp_path, monkeypatch):
    run, job = opened(tmp_path, FLAT, window=WINDOW)
    monkeypatch.setattr(type(run), "has_orders", lambda self, job: True)
    render(run, job)
    readout(run, job)
    path = run.paths.stage(*job.key, "orders.parquet")
    ObjectTable({"row": np.zeros(0, int)}).write(path, {"recipe": run.recipe(job, "select") | {"camera": "z" * 16}})
    with pytest.raises(InputError, match=r"orders\.parquet"):
        level0(run, job)
