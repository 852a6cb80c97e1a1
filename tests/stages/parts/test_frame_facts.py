"""A campaign's expected values of a frame, and its file's, against a run of its layers."""

from types import SimpleNamespace

import numpy as np
import pytest
import yaml
from support.mini_campaign import POINTINGS, write_campaign

from csstsim.campaign.opened import OpenCampaign
from csstsim.io.level0 import read_level0
from csstsim.layers import sky_background
from csstsim.optics.geometry.sip import sip_header
from csstsim.simulation.sim_steps import SimSteps
from csstsim.simulation.state import State
from csstsim.stages import chip as chip_stage
from csstsim.stages.parts.frame_facts import frame_facts

MAG_LIMIT = 12.0  # no object: sky and detector alone


@pytest.fixture(scope="module", params=[False, True], ids=["linear", "sip"])
def made(request, tmp_path_factory):
    """(campaign, job) of an empty sky that was made, its header's WCS linear or with the distortion in it."""
    folder = tmp_path_factory.mktemp("facts")
    names = ("poisson_and_dark", "prescan_overscan", "bias", "readout_noise", "gain")
    layers = [{"scie_obs": {"field_dist": True}}, {"sky_background": {}}, *({name: {}} for name in names)]
    layers = yaml.safe_dump({"layers": [*layers, {"quantization_and_output": {"sip": request.param}}]})
    (folder / "layers.yaml").write_text(layers)
    file = write_campaign(
        folder, POINTINGS[:1], observations={"SCIE": str(folder / "layers.yaml")}, catalog={"mag_limit": MAG_LIMIT}
    )
    run = OpenCampaign(file)
    (job,) = run.jobs
    chip_stage.chip(run, job, log=lambda *_: None)
    return run, job


def test_the_header_says_what_the_campaign_has(made):
    facts = frame_facts(*made)
    assert facts.header["exptime"] == facts.exptime == 150.0
    assert facts.header["gain"] == pytest.approx(facts.gain) and len(facts.gain) == 16
    assert set(facts.header["read_noise"].values()) == {facts.read_noise}
    assert len(set(facts.gain.values())) == 16


def test_the_headers_wcs_is_where_light_falls(made):
    """Within 1e-3 px of the chip's WCS, distortion in the header or next to it."""
    run, job = made
    x, y = np.meshgrid(np.linspace(0, job.window.x1 - 1, 7), np.linspace(0, job.window.y1 - 1, 7))
    ra, dec = frame_facts(run, job).wcs.pixel_to_world(x.ravel(), y.ravel())
    true_ra, true_dec = job.wcs.pixel_to_world(x.ravel(), y.ravel())
    away = np.hypot((ra - true_ra) * np.cos(np.radians(true_dec)), dec - true_dec) * 3600 / 0.074
    assert job.wcs.distortion and away.max() < 1e-3
    sip = sip_header(job.wcs)["CTYPE1"]
    stated = read_level0(run.paths.level0(job)).header["CTYPE1"]
    assert (stated == sip) == (frame_facts(run, job).wcs.distortion is None)


def test_level_and_noise_are_those_of_the_pixels(made):
    """Mean and rms of the electrons of an empty frame, within 5 sigma; a fraction of the light is counted."""
    run, job = made
    facts, file = frame_facts(run, job), read_level0(run.paths.level0(job))
    raw, image = file.frame(), np.zeros(job.window.shape)
    for block in file.readout.blocks:
        bias = facts.header["bias"][block.channel]
        image[block.image] = (raw[block.active] - bias) * facts.gain[block.channel]
    fraction = counted_fraction(run, job)
    expected, n = facts.level(fraction) * fraction, image.size
    assert image.mean() == pytest.approx(expected, abs=5 * image.std() / np.sqrt(n))
    assert image.std() == pytest.approx(facts.noise(fraction, 1) * fraction, rel=5 / np.sqrt(2 * n))


def counted_fraction(run, job):
    """Return the mean fraction of the sky that a job's chip counts, from the layer itself."""
    state, step = State.blank(job.exposure), run.steps["SCIE"].step("sky_background")
    streams = run.streams(job, "sky_background")
    lit = sky_background.apply(state, step.param, streams).image.mean(dtype=float)
    return lit / (state.filter.sky * job.pointing.exptime)


def test_a_layer_of_ones_own_leaves_the_sky_unknown(made):
    run, job = made
    steps = run.steps["SCIE"]
    own = type("Own", (), {"shipped": False, "step": steps.step})()
    run.steps["SCIE"] = own
    try:
        assert frame_facts(run, job).sky is None
    finally:
        run.steps["SCIE"] = steps


def test_what_is_expected_follows_the_list_of_layers(made):
    """Dark current, read noise, sky and a gain for each channel of a list that has them, none of one that has not."""
    run, job = made
    detector, steps = run.camera.detector, run.steps["SCIE"]
    objects = SimpleNamespace(on_frame=lambda one: {"stars": 3} if one is job else {})
    full = frame_facts(run, job, objects)
    assert (full.dark, full.read_noise) == (pytest.approx(150.0 * detector.dark), detector.read_noise)
    assert full.sky == pytest.approx(150.0 * run.camera.filters[job.chip.filter].sky)
    assert (
        full.full_well == detector.full_well and full.expected == {"stars": 3} and frame_facts(run, job).expected == {}
    )
    bare = [{"prescan_overscan": {}}, {"gain": {"gain_16channel": False}}, {"quantization_and_output": {}}]
    run.steps["SCIE"] = SimSteps("bare.yaml", "SCIE", bare)
    try:
        facts = frame_facts(run, job)
    finally:
        run.steps["SCIE"] = steps
    assert (facts.sky, facts.dark, facts.read_noise) == (0.0, 0.0, 0.0)
    assert len(facts.gain) == 16 and len(set(facts.gain.values())) == 1
    assert abs(facts.gain[1] / detector.gain - 1) <= detector.gain_spread
