"""PRNU, cosmic rays and defects from the list of layers to the file, in one process and in several."""

from dataclasses import replace

import numpy as np
import pytest
import yaml
from support.mini_campaign import POINTINGS, write_scene

from csstsim.base.rng import Streams
from csstsim.base.shipped import SHIPPED
from csstsim.campaign.opened import OpenCampaign
from csstsim.io.frames import load_frame
from csstsim.io.level0 import read_level0
from csstsim.render.psf_table import read_tables
from csstsim.simulation.state import State
from csstsim.stages import chip as chip_stage
from csstsim.stages import level0 as level0_stage
from csstsim.stages import psf as psf_stage
from csstsim.stages import readout as readout_stage
from csstsim.stages import select as select_stage

pytestmark = pytest.mark.thorough

OBSID, CHIP = POINTINGS[0].split(",")[0], 9


def scene(folder, kind, mag=17.0):
    """Write a campaign of two stars whose exposures have every effect of the pixels."""
    folder.mkdir()
    name = "science" if kind == "SCIE" else "bias"
    layers = yaml.safe_load((SHIPPED / "observations" / f"{name}.yaml").read_text())["layers"]
    known = {keyword: param for entry in layers for keyword, param in entry.items()}
    light = [{key: known[key]} for key in ("scie_obs", "sky_background") if key in known]
    effects = [
        {"PRNU_effect": {}}, {"cosmic_rays": {"save_cosmic_image": True}}, {"poisson_and_dark": {}},
        {"detector_defects": {}},
    ]  # fmt: skip
    effects = effects[not light :]
    end = [{key: known[key]} for key in known if key in ("prescan_overscan", "bias", "readout_noise", "gain")]
    path = folder / "list.yaml"
    path.write_text(yaml.safe_dump({"layers": [*light, *effects, *end, {"quantization_and_output": {}}]}))
    number = 0 if kind == "SCIE" else 2
    return OpenCampaign(
        write_scene(
            folder, "Stars", [40.2, 90.0], [50.3, 80.1], mag, pointing=POINTINGS[number],
            select={"types": [kind], "chips": [CHIP]}, observations={kind: str(path)},
        )
    )  # fmt: skip


def rays_of(run, job):
    planes, meta = load_frame(run.paths.level0_cosmic(job))
    assert meta["recipe"] == run.recipe(job, "readout")
    return planes["cosmic"]


def test_the_files_say_what_was_done(tmp_path):
    run = scene(tmp_path / "one", "SCIE")
    [job] = run.jobs
    chip_stage.chip(run, job, log=lambda text: None)
    header, rays = read_level0(run.paths.level0(job), verify=True).header, rays_of(run, job)
    assert rays.shape == job.window.shape and rays.dtype == np.int32
    assert header["CRCHARGE"] == rays.sum() and header["CRCOUNT"] == (rays >= 5).sum()
    assert header["PRNURMS"] == run.camera.detector.prnu
    assert header["DEFLEVEL"] == pytest.approx(
        150 * (run.camera.filters["r"].sky + 0.02), rel=0.2
    )  # wings of the stars
    assert header["NHOT"] + header["NDEAD"] == round(5e-5 * 128 * 128) and 2 <= header["NBADCOL"] <= 10


def test_a_bias_in_one_process_and_in_two(tmp_path):
    one, two = scene(tmp_path / "one", "BIAS"), scene(tmp_path / "two", "BIAS")
    [job], [same] = one.jobs, two.jobs
    chip_stage.chip(one, job, log=lambda text: None)
    readout_stage.readout(two, same)
    level0_stage.level0(two, same)
    files = [read_level0(run.paths.level0(job)) for run in (one, two)]
    assert np.array_equal(*(file.frame() for file in files))
    assert np.array_equal(rays_of(one, job), rays_of(two, same))
    for key in ("NHOT", "NDEAD", "NBADCOL", "DEFLEVEL", "CRTRACKS", "CRCOUNT", "CRCHARGE"):
        assert files[0].header[key] == files[1].header[key]
    assert "PRNURMS" not in files[0].header


def test_photons_keep_their_numbers_without_prnu(tmp_path):
    """The same photons arrive: those lost or kept by the pixels' response alone differ, 0.8 x rms of them, under 2%.

    Noise of other photons would change 1 / sqrt(count), and the chance of a pixel to be the same at all.
    """
    run = scene(tmp_path / "scene", "SCIE", mag=23.0)
    [job] = run.jobs
    psf_stage.psf(run, CHIP)
    objects, psf, found = select_stage.selected(run, job.exposure), psf_stage.open_psf(run, job.chip), []
    [step, *_] = run.steps["SCIE"].stage("render")
    for prnu in (True, False):
        assert job.exposure.losses.prnu
        state = State.blank(replace(job.exposure, losses=job.exposure.losses._replace(prnu=prnu)), objects)
        state.psf, state.tables = psf, read_tables(run.paths.psf_tables(CHIP), psf)
        found.append(step.module.apply(state, step.param, Streams(3, OBSID, CHIP, step.name)))
    one, other = found
    changed, total = np.abs(one.counted - other.counted).sum(dtype=int), other.counted.sum(dtype=int)
    assert 0 < changed < 0.02 * total and total > 1000
    for name in ("electrons", "method", "error", "stamp", "flags"):
        assert np.array_equal(one.truth[name], other.truth[name])
