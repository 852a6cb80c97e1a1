"""Inputs of the renderer from scie_obs: noise for the exposure time, and an upper bound on all losses."""

from dataclasses import replace

import numpy as np
import pytest
from mini_campaign import write_scene

from csstsim.base.rng import Streams
from csstsim.campaign.opened import OpenCampaign
from csstsim.instrument.chip import Window
from csstsim.layers import scie_obs
from csstsim.optics.throughput.response import response_map, response_maximum
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
@pytest.mark.parametrize("chip", [6, 9, 30])
def test_no_pixel_is_above_the_declared_maximum(camera, chip, flat):
    """Flat, shutter and pixels together, a million of them in the middle, and at the edges: below, but not far."""
    chip, how = camera.chips[chip], {"flat": flat, "shutter": True}
    filter_, rng = camera.filters[chip.filter], Streams(5, "1", chip.id, "scie_obs")
    maximum = response_maximum(chip, filter_, camera.leds, rng.camera, **how)
    ask = filter_, 150.0, camera.leds, rng.camera
    for window in (Window(4000, 5000, 4000, 5000), Window(0, 9216, 0, 40), Window(9190, 9216, 0, 9232)):
        seen = response_map(chip, window, *ask, prnu=rng.chip_key("prnu"), **how).max()
        assert (0.9 if window.x0 == 4000 else 0.0) * maximum < seen <= maximum
