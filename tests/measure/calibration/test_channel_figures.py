"""Numbers of each readout channel, from a frame whose channels are known and differ."""

from types import SimpleNamespace

import numpy as np
import pytest
from support.even_response import EvenResponse

from csstsim.base.rng import stream
from csstsim.detector.channels import ReadoutFrame
from csstsim.measure.calibration.calibrate import Corrections, Electronics, calibrate
from csstsim.measure.calibration.channel_figures import SAMPLE, block_means, channel_figures
from csstsim.measure.detection.maps import BIN

READOUT = ReadoutFrame(
    window=(32, 256, 64, 192), nx=256, ny=256, channels_x=2, channels_y=2, channel_nx=128, channel_ny=128,
    prescan=3, overscan=24, parallel_overscan=4,
)  # fmt: skip
GAIN, BIAS, NOISE = 1.1, 454.5, 4.0  # e-/DN, DN, DN rms


def test_each_channel_has_its_own_figures():
    """Level and noise within 5 sigma of what was put in: 30 e- more a channel, a fraction of 0.8 counted."""
    rng = stream(4, "channels")
    raw = rng.normal(BIAS, NOISE, READOUT.shape)
    for block in READOUT.blocks:
        raw[block.active] += 0.8 * 30.0 * block.channel / GAIN
    gain = {block.channel: GAIN for block in READOUT.blocks}
    frame = np.rint(raw).astype(np.uint16)
    calibrated = calibrate(frame, READOUT, Electronics(gain), Corrections(response=EvenResponse(0.8, 224)))
    before, image = block_means(calibrated.electrons, READOUT), np.zeros((128, 224), np.float32)
    figures = channel_figures(calibrated, before, image, np.full((64, 112), 6.0, np.float32))
    assert sorted(part["channel"] for part in figures) == sorted(gain)
    covered = np.zeros((256, 256), int)
    sigma = GAIN * np.hypot(NOISE, 12**-0.5)
    for part in figures:
        x0, x1, y0, y1 = part["window"]
        covered[y0:y1, x0:x1] += 1
        n = (x1 - x0) * (y1 - y0) / SAMPLE**2
        error = 5 * sigma / 0.8 * np.hypot(n**-0.5, part["overscan"] ** -0.5)
        assert part["level"] == pytest.approx(30.0 * part["channel"], abs=error)
        assert part["read_noise"] == pytest.approx(sigma, rel=5 / np.sqrt(2 * part["overscan"]) + 0.01)
        assert part["bias"] == pytest.approx(BIAS, abs=5 * NOISE / np.sqrt(part["overscan"]))
        assert part["response"] == pytest.approx(0.8) and part["noise"] == 6.0
    assert (covered[64:192, 32:256] == 1).all() and covered.sum() == 128 * 224


def test_a_frame_without_a_readout_has_none():
    bare = SimpleNamespace(readout=None)
    assert channel_figures(bare, block_means(np.zeros((4, 4)), None), np.zeros((4, 4)), np.ones((4, 4))) == []


def test_figures_are_of_the_channels_own_pixels_and_of_what_was_subtracted():
    """Noise, background and response that rise from channel to channel, some of the background left in the image."""
    blocks = {block.channel: block.image for block in READOUT.blocks}
    shape = (128, 224)
    plane = {name: np.zeros(shape, np.float32) for name in ("noise", "before", "image", "share")}
    for n, where in blocks.items():
        plane["noise"][where], plane["before"][where] = 5.0 + n, 100.0 + 10 * n
        plane["image"][where], plane["share"][where] = 0.25 * n, 0.5 + n / 100
    response = SimpleNamespace(at=lambda row, column: plane["share"][row, column])
    calibrated = SimpleNamespace(
        readout=READOUT, response=response, bias={n: 400.0 + n for n in blocks}, read_noise={n: 4.0 + n for n in blocks}
    )
    before = block_means(plane["before"], READOUT)
    assert before == {n: 100.0 + 10 * n for n in blocks}
    noise = plane["noise"][::BIN, ::BIN]
    for part in channel_figures(calibrated, before, plane["image"], noise):
        n = part["channel"]
        assert (part["bias"], part["read_noise"], part["noise"]) == (400.0 + n, 4.0 + n, 5.0 + n)
        assert part["level"] == pytest.approx(100.0 + 9.75 * n) and part["response"] == pytest.approx(0.5 + n / 100)
        rows, columns = blocks[n]
        assert part["window"] == [32 + columns.start, 32 + columns.stop, 64 + rows.start, 64 + rows.stop]
        assert part["overscan"] == READOUT.overscan * (rows.stop - rows.start)
    calibrated.response = None
    assert {part["response"] for part in channel_figures(calibrated, before, plane["image"], noise)} == {1.0}
