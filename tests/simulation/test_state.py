"""The state of a job: its planes, electrons and response."""

from dataclasses import replace

import numpy as np
import pytest
from support.readout_state import flat_state

from csstsim.base.rng import Streams
from csstsim.optics.throughput import shutter
from csstsim.simulation.exposure import Losses
from csstsim.simulation.state import State


def test_electrons_are_expected_and_counted(camera):
    """A million pixels of 0.1 electron: single precision would lose a hundred of them."""
    state = flat_state(camera, 0.1, window=(0, 1000, 0, 1000))
    assert abs(state.electrons() - 1e6 * float(np.float32(0.1))) < 1e-3
    state.counted = np.full(state.image.shape, 3, np.int32)
    assert abs(state.electrons() - 1e6 * (3 + float(np.float32(0.1)))) < 1e-3


def test_counted_electrons_are_a_plane_to_whoever_asks(camera):
    """Rays come as lists of pixels, into a plane or none; what a layer sees or takes is their sum."""
    pixel, electrons = np.array([3, 4, 90]), np.array([7, 1, 2], np.int32)
    for before in (None, 5):
        state = flat_state(camera, window=(0, 20, 0, 10))
        wanted = np.full(state.image.shape, before or 0, np.int32)
        wanted.reshape(-1)[pixel] += [7, 2, 2]
        state.counted = None if before is None else np.full(state.image.shape, before, np.int32)
        state.add_counted(pixel, electrons)
        state.add_counted(pixel[1:2], electrons[:1] // 7)
        assert state.electrons() == wanted.sum() and np.array_equal(state.counted, wanted)
        assert state.counted is state.counted
        assert state.take_counted() is not None and state.counted is None


def test_a_blank_state_has_planes_of_the_window(camera):
    exposure = flat_state(camera, window=(100, 130, 40, 52)).exposure
    dark, masked = State.blank(exposure), State.blank(replace(exposure, mask=True), "objects")
    assert dark.image.shape == (12, 30) and dark.image.dtype == np.float32 and not dark.image.any()
    assert dark.mask is dark.counted is dark.catalog is dark.truth is dark.cosmic_rays is None and dark.header == {}
    assert masked.mask.shape == (12, 30) and masked.mask.dtype == np.uint8 and not masked.mask.any()
    assert masked.catalog == "objects" and masked.unit == "electron"


def test_what_a_layer_asks_of_the_exposure(camera):
    state = flat_state(camera, window=(100, 130, 40, 52), chip=29)
    assert state.chip is camera.chips[29] and state.filter is camera.filters[camera.chips[29].filter]
    assert state.telescope is camera.telescope and state.window == state.exposure.window
    assert state.pointing is state.exposure.pointing and state.wcs is state.exposure.wcs


@pytest.mark.parametrize("losses", [Losses(), Losses(flat=True), Losses(shutter=True), Losses(prnu=True)])
def test_the_response_has_the_losses_of_the_exposure_alone(camera, losses):
    """Of the shutter, the share of the exposure time that columns lose; of pixels, a scatter without a shape."""
    state = flat_state(camera, window=(0, 900, 0, 30), losses=losses, exptime=10.0)
    found = state.response(Streams(5, "10100000001", 9, "sky"))
    if losses == Losses():
        assert found is None
        return
    found = np.broadcast_to(found, (30, 900))
    if losses.shutter:
        wanted = 1 - shutter.lost(state.chip, np.arange(900)) / 10.0
        assert np.allclose(found, wanted, rtol=1e-5) and np.ptp(wanted) > 1e-4
    elif losses.flat:
        assert (found != 1).mean() > 0.9 and np.std(np.diff(found, axis=1)) < 0.002
    else:
        assert found.mean() == pytest.approx(1, abs=0.001) and 0.002 < found.std() < 0.05
        assert np.std(found.mean(axis=0)) < found.std() / 3


def test_the_response_is_made_once_and_can_be_forgotten(camera):
    state = flat_state(camera, window=(0, 20, 0, 10), losses=Losses(prnu=True))
    rng = Streams(5, "10100000001", 9, "sky")
    first = state.response(rng)
    assert state.response(Streams(6, "10100000002", 9, "other")) is first
    state.forget()
    assert np.array_equal(state.response(rng), first) and state.response(rng) is not first
    state.forget()
    assert not np.array_equal(state.response(Streams(6, "10100000001", 9, "sky")), first)
    state.forget()
    of_another_exposure = state.response(Streams(5, "10100000077", 9, "sky"))
    assert np.array_equal(of_another_exposure, first)  # pixels are those of the chip
