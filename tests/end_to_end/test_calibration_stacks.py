"""Bias, dark and LED-flat exposures through the program: their stacks give back what was configured."""

import numpy as np
import pytest
from click.testing import CliRunner
from mini_campaign import write_campaign

from csstsim.campaign import OpenCampaign
from csstsim.cli import main
from csstsim.io.level0 import read_level0
from csstsim.measure.calibrate import calibrate

FRAMES, DARK_S = 12, 20_000.0  # a long dark, for 400 e- in a pixel
SIGMA = 5.0


@pytest.fixture(scope="module")
def stacks(tmp_path_factory):
    """Return the campaign and {type: [Level0 files]} of one chip, 12 frames of each type."""
    folder = tmp_path_factory.mktemp("calibration")
    rows = [
        f"10{code}00000{n:03d},{kind},0,0,0,2027-11-20T02:{n:02d}:00,{exptime:g}"
        for code, kind, exptime in ((3, "BIAS", 0), (7, "DARK", DARK_S), (0, "FLAT", 150))
        for n in range(1, FRAMES + 1)
    ]
    path = write_campaign(folder, rows, select={"types": ["BIAS", "DARK", "FLAT"], "chips": [9]})
    run, files = OpenCampaign(path), {}
    for job in run.jobs:
        arguments = ["chip", str(path), "--obsid", job.pointing.obsid, "--chip", "9"]
        result = CliRunner().invoke(main, arguments, catch_exceptions=False)
        assert result.exit_code == 0, result.output
        files.setdefault(job.pointing.type, []).append(read_level0(run.paths.level0(job.pointing, 9)))
    return run, files


def channels(file, image):
    """Return {channel: active pixels} of a frame in the readout's shape."""
    return {block.channel: image[block.active].astype(float) for block in file.readout.blocks}


def test_bias_stack_gives_levels_and_read_noise(stacks):
    run, files = stacks
    detector, frames = run.camera.detector, [channels(f, f.frame()) for f in files["BIAS"]]
    gain, header = files["BIAS"][0].gain, files["BIAS"][0].header
    levels, counts = [], frames[0][1].size * FRAMES
    for channel in range(1, 17):
        pixels = np.stack([frame[channel] for frame in frames]) * gain[channel]
        noise2 = detector.read_noise**2 + gain[channel] ** 2 / 12  # and rounding to whole DN
        level = header[f"DETBIA{channel:02d}"] * gain[channel]
        assert abs(pixels.mean() - level) < SIGMA * np.sqrt(noise2 / counts)
        assert abs(pixels.var() / noise2 - 1) < SIGMA * np.sqrt(2 / counts)
        levels.append(level)
    assert len(set(levels)) == 16
    assert all(abs(level - detector.bias) <= detector.bias_spread + 1e-6 for level in levels)


def test_dark_stack_gives_the_dark_current(stacks):
    run, files = stacks
    detector = run.camera.detector
    images = [calibrate(f.frame(), f.readout, f.gain).electrons for f in files["DARK"]]
    expected = detector.dark * DARK_S
    variance = expected + detector.read_noise**2 + detector.gain**2 / 12
    count = images[0].size * FRAMES
    level = SIGMA * np.sqrt(
        variance / count + 16 * detector.read_noise**2 / (count * 0.06)
    )  # overscan: 71 columns of 1250
    assert abs(np.mean(images, dtype=float) - expected) < level
    spread = np.var(np.stack(images), axis=0, ddof=1, dtype=float).mean()
    assert abs(spread / variance - 1) < SIGMA * np.sqrt(2 / count) + 0.01  # gain differs by 2% between channels


def test_flat_stack_has_the_light_of_the_lamps_behind_its_filter(stacks):
    from csstsim.optics.led import load_leds

    run, files = stacks
    leds, param = load_leds(run.camera.leds), run.steps["FLAT"].steps[0].param
    lit = sum(
        t * leds[n].electrons(run.camera.filters["r"]) for n, t in zip(param.LED_TYPE, param.LED_TIME, strict=True)
    )
    images = np.stack([calibrate(f.frame(), f.readout, f.gain).electrons for f in files["FLAT"]]).astype(float)
    mean, variance = images.mean(), np.var(images, axis=0, ddof=1).mean()
    assert mean == pytest.approx(lit, rel=0.1)  # times the internal flat, 1 within some per cent
    assert variance == pytest.approx(mean + 25, rel=0.02)  # shot and read noise
    header = files["FLAT"][0].header0
    assert header["LEDTYPE"].split(",") == param.LED_TYPE and header["LEDGUESS"] == "880"
