"""Flat field and shutter of scie_obs: each switch multiplies the light by its map and touches nothing else."""

from dataclasses import replace

import numpy as np
import pytest
from support.mini_campaign import write_scene

from csstsim.base.rng import Streams
from csstsim.campaign.opened import OpenCampaign
from csstsim.instrument.chip import Window
from csstsim.layers import scie_obs
from csstsim.optics.throughput.flat import FlatField
from csstsim.optics.throughput.response import Response, response_map
from csstsim.simulation.state import State
from csstsim.stages import psf as psf_stage
from csstsim.stages import select as select_stage

STREAMS = Streams(5, "10100000001", 9, "scie_obs")
SWITCHES = [(False, True), (True, False), (True, True)]


@pytest.fixture(scope="module")
def draw(tmp_path_factory):
    """Return draw(flat, shutter) -> State after scie_obs, of a star and two galaxies; camera noise of one seed."""
    folder = tmp_path_factory.mktemp("losses")
    run = OpenCampaign(write_scene(folder, "Pair", [40.3, 90.1, 20.0], [50.2, 70.6, 110.0], mag=20.0))
    job = run.job("10100000001", 9)
    psf_stage.psf(run, 9)
    objects, psf = select_stage.selected(run, job.exposure), psf_stage.open_psf(run, job.chip)

    def made(flat, shutter):
        losses = job.exposure.losses._replace(flat=flat, shutter=shutter)
        state = State.blank(replace(job.exposure, losses=losses, fidelity="noise_free"), objects)
        state.psf = psf
        return scie_obs.apply(state, scie_obs.Param(), STREAMS)

    return made


@pytest.mark.parametrize(("flat", "shutter"), SWITCHES)
def test_objects_lose_what_the_map_says_and_nothing_else_changes(draw, flat, shutter):
    plain, state = draw(False, False), draw(flat, shutter)
    share = response_map(
        state.chip,
        state.window,
        state.filter,
        150.0,
        flat=FlatField(state.exposure.camera.leds, STREAMS.camera) if flat else None,
        shutter=shutter,
    )
    assert np.abs(share - 1).max() > 1e-3
    np.testing.assert_allclose(state.image, plain.image * share, rtol=1e-5)
    assert state.truth["drawn"].sum() == pytest.approx(state.image.sum(dtype=float), rel=1e-6)
    assert state.header.pop("objects_electrons") == pytest.approx(state.truth["drawn"].sum(), rel=1e-6)
    assert state.header == {name: value for name, value in plain.header.items() if name != "objects_electrons"}
    for name in plain.truth.names:
        if name not in ("drawn", "fraction", "ms"):
            np.testing.assert_array_equal(state.truth[name], plain.truth[name], err_msg=name)


def test_losses_are_made_once(draw):
    """Layers that ask one after another have the same map, until it is forgotten."""
    state = draw(True, True)
    made = state.response(STREAMS)
    assert state.response(STREAMS) is made
    state.forget()
    again = state.response(STREAMS)
    assert again is not made
    np.testing.assert_array_equal(again, made)


@pytest.mark.parametrize("master", [False, True])
@pytest.mark.parametrize(("flat", "shutter"), [*SWITCHES, (False, False)])
def test_single_pixels_and_rows_have_the_response_of_the_map(camera, flat, shutter, master):
    """Every bit: pixels in any order and twice, at the window's corners; a measured response is a factor more."""
    chip, window = camera.chips[9], Window(9000, 9216, 4600, 4700)
    streams = Streams(1, "", 9, "")
    ask = window, camera.filters["r"], 150.0
    field = FlatField(camera.leds, streams.camera) if flat else None
    how = {"flat": field, "shutter": shutter, "prnu": streams.chip_key("prnu")}
    wanted = response_map(chip, *ask, **how)
    own = np.random.default_rng(1).normal(1, 0.01, window.shape).astype(np.float32) if master else None
    if master:
        wanted = wanted * own
    response = Response(chip, *ask, **how, master=own)
    assert np.array_equal(response.rows(0, window.ny), wanted)
    assert np.array_equal(response.rows(17, 18), wanted[17:18])
    assert response.rows(5, 5).shape == (0, window.nx)
    row, column = np.array([99, 0, 0, 99, 50, 50]), np.array([0, 0, 215, 215, 101, 101])
    assert np.array_equal(response.at(row, column), wanted[row, column])
    assert response.at(row[:0], column[:0]).shape == (0,)
    for part in np.s_[17:60, 101:110], np.s_[0:1, 215:216], np.s_[5:5, 0:3]:
        assert np.array_equal(response.part(*part), wanted[part])
