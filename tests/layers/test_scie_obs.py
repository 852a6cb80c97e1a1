"""Inputs of the renderer from scie_obs: noise for the exposure time, and an upper bound on all losses."""

from dataclasses import replace

import numpy as np
import pytest
from support.csst import BANDS
from support.mini_campaign import write_scene
from support.readout_state import change_exposure, flat_state

from csstsim.base.errors import InputError
from csstsim.base.rng import Streams
from csstsim.campaign.opened import OpenCampaign
from csstsim.catalog.table import STAR, ObjectTable
from csstsim.instrument.chip import Window
from csstsim.layers import scie_obs
from csstsim.optics.throughput.flat import FlatField
from csstsim.optics.throughput.response import response_map, response_maximum
from csstsim.simulation.exposure import Losses
from csstsim.simulation.state import State
from csstsim.stages import psf as psf_stage
from csstsim.stages import select as select_stage

STREAMS = Streams(5, "10100000001", 9, "scie_obs")


def test_signal_to_noise_is_of_the_exposures_time(tmp_path):
    """A star of 27 mag lies far below the sky: ten times as long, S/N is the root of ten up, and read noise goes."""
    run = OpenCampaign(write_scene(tmp_path, "Pair", [40.3], [50.2], mag=27.0))
    job = run.job("10100000001", 9)
    psf_stage.psf(run, 9)
    objects, psf = select_stage.selected(run, job.exposure), psf_stage.open_psf(run, job.chip)
    snr = []
    for exptime in (150.0, 1500.0):
        pointing = replace(job.pointing, exptime=exptime)
        state = State.blank(replace(job.exposure, pointing=pointing, fidelity="noise_free"), objects)
        state.psf = psf
        truth = scie_obs.apply(state, scie_obs.Param(), STREAMS).truth
        snr.append(float(truth["snr"][0]))
    detector, filter_ = job.chip.detector, run.camera.filters["r"]
    sky = filter_.sky + detector.dark
    variance = [exptime * sky + detector.read_noise**2 for exptime in (150.0, 1500.0)]
    assert snr[0] < 5
    assert snr[1] / snr[0] == pytest.approx(10 * np.sqrt(variance[0] / variance[1]), rel=0.05)


@pytest.mark.parametrize("flat", [False, True])
@pytest.mark.parametrize("chip_id", [6, 9, 30])
def test_no_pixel_is_above_the_declared_maximum(camera, chip_id, flat):
    """Flat, shutter and pixels together, a million of them in the middle, and at the edges: below, but not far."""
    chip, rng = camera.chips[chip_id], Streams(5, "1", chip_id, "scie_obs")
    filter_, field = camera.filters[chip.filter], FlatField(camera.leds, rng.camera) if flat else None
    maximum = response_maximum(chip, filter_, field)
    for window in (Window(4000, 5000, 4000, 5000), Window(0, 9216, 0, 40), Window(9190, 9216, 0, 9232)):
        seen = response_map(chip, window, filter_, 150.0, flat=field, shutter=True, prnu=rng.chip_key("prnu")).max()
        assert (0.9 if window.x0 == 4000 else 0.0) * maximum < seen <= maximum


def prepared(camera, psf, **fields):
    """A window of chip 9 and 300 s, whose sky, dark current, read noise and time are all of their own size."""
    state = flat_state(camera, window=(4000, 4120, 4100, 4180), exptime=300.0, **fields)
    detector = replace(state.chip.detector, dark=0.5, read_noise=7.0)
    change_exposure(state, chip=replace(state.chip, detector=detector))
    state.psf = psf
    return state


@pytest.mark.parametrize("wings", [True, False])
@pytest.mark.parametrize("ghosts", [True, False])
def test_what_the_renderer_is_told(camera, psf_r, wings, ghosts):
    state = prepared(camera, psf_r, fidelity="preview")
    told = scie_obs._drawing(state, scie_obs.Param(wings=wings, ghosts=ghosts), STREAMS)
    assert told.variance == pytest.approx(300.0 * (camera.filters["r"].sky + 0.5) + 49.0)
    assert (told.exptime, told.fidelity, told.psf, told.wcs) == (300.0, "preview", psf_r, state.exposure.wcs)
    assert (told.wing is not None, told.ghosts is not None) == (wings, ghosts)
    assert told.key == STREAMS.exposure_key("photons")
    assert (told.observer, told.interval) == (state.exposure.spacecraft, state.exposure.interval)
    assert told.tables is state.tables


@pytest.mark.parametrize("losses", [Losses(), Losses(flat=True), Losses(shutter=True), Losses(True, True, True)])
def test_what_the_renderer_draws_on(camera, psf_r, losses):
    """The planes of the state, its window, its response and the largest response of any pixel of the chip."""
    state = prepared(camera, psf_r, losses=losses)
    state.counted = np.zeros(state.image.shape, np.int32)
    canvas = scie_obs._canvas(state, STREAMS)
    assert canvas.expected is state.image and canvas.counted is state.counted and canvas.window == state.window
    flat = FlatField(camera.leds, STREAMS.camera) if losses.flat else None
    assert canvas.maximum == response_maximum(state.chip, state.filter, flat)
    assert (canvas.response is None) == (losses == Losses())


def test_rows_of_the_truth_are_those_of_the_catalogue(camera, psf_r):
    """Three stars out of the order of their ids: rows, drawn electrons and the header."""
    state = prepared(camera, psf_r, fidelity="noise_free")
    state.image[:] = 2.0
    x, y, rate = np.array([4030.0, 4060.0, 4090.0]), np.full(3, 4140.0), np.array([5.0, 40.0, 10.0])
    ra, dec = state.exposure.wcs.pixel_to_world(x, y)
    columns = {"ra": ra, "dec": dec, "ra_orig": ra, "dec_orig": dec, "x": x, "y": y} | {
        f"flux{i}": rate for i in range(4)
    }
    state.catalog = ObjectTable.complete(
        columns | {"id": np.array([9, 2, 5]), "obj_type": np.full(3, STAR), "reach": np.full(3, 20),
                   "lost": np.full(3, 1e-4), "wing": np.zeros(3)},
        BANDS,
    )  # fmt: skip
    state = scie_obs.apply(state, scie_obs.Param(wings=False, ghosts=False), STREAMS)
    truth = state.truth
    assert truth["id"].tolist() == [9, 2, 5] and truth["x"].tolist() == [4030.0, 4060.0, 4090.0]
    assert truth["electrons"] == pytest.approx(rate * 4 * 300)
    light = state.image.astype(float) - 2.0
    for x, drawn in zip((30, 60, 90), truth["drawn"], strict=True):
        assert light[20:61, x - 14 : x + 15].sum() == pytest.approx(drawn, rel=0.02)
    assert state.header["objects_electrons"] == pytest.approx(truth["drawn"].sum(), rel=1e-5)
    assert state.orders is None


def test_numbers_are_checked_as_far_as_they_are_needed(camera, make_pointing):
    wrong = replace(camera, leds=camera.leds | {"flat": {}})
    with pytest.raises(InputError, match=r"leds\.yaml"):
        scie_obs.check(scie_obs.Param(), wrong, make_pointing())
    scie_obs.check(scie_obs.Param(flat_fielding=False), wrong, make_pointing())
    scattering = replace(camera, scatter=camera.scatter | {"reference": 0.5})
    with pytest.raises(InputError, match="not a wavelength"):
        scie_obs.check(scie_obs.Param(flat_fielding=False), scattering, make_pointing())


def test_what_a_list_leaves_out():
    usual = scie_obs.Param().model_dump()
    assert usual.pop("exptime") is None and set(usual.values()) == {True}
    assert set(usual) == {"flat_fielding", "shutter_effect", "field_dist", "wings", "ghosts"}
    with pytest.raises(ValueError, match="greater than 0"):
        scie_obs.Param(exptime=0.0)
