"""Stacks of bias, dark and LED-flat frames with every detector layer reproduce the configured numbers of each channel.

A small chip has 16 channels of 256 x 256 pixels in both halves. benchmarks/calibration_stacks.py does the same on a
real chip with ccdproc, for more quantities. Each channel is within 5 sigma, from the noise of its own pixels.
"""

import numpy as np
import pytest
import yaml
from scipy import ndimage
from support import stack_estimates as estimate
from support.mini_campaign import write_campaign

from csstsim.base.shipped import SHIPPED
from csstsim.campaign.opened import OpenCampaign
from csstsim.io.level0 import read_level0
from csstsim.measure.calibration.calibrate import overscan_level
from csstsim.stages import chip as chip_stage

pytestmark = pytest.mark.thorough

CHIP, SIDE, OVERSCAN = 9, 256, 71
GEOMETRY = {
    "nx": 8 * SIDE, "ny": 2 * SIDE, "channel_nx": SIDE, "channel_ny": SIDE, "prescan": 27, "overscan": OVERSCAN,
    "parallel_overscan": 84,
}  # fmt: skip
DARK = 150.0  # s
SECONDS = (3.0, 6.0, 10.0, 14.0, 19.0)  # of two lamps each, 2960 e- per second
KINDS = {"BIAS": ("bias", 0.0, 5), "DARK": ("dark", DARK, 5), "FLAT": ("led_flat", 40.0, 2 * len(SECONDS))}


def write_lists(folder, seconds):
    """Write the shipped list of each kind, lamps lit for so long and a polynomial a channel; return {kind: file}."""
    for name, *_ in KINDS.values():
        layers = yaml.safe_load((SHIPPED / "observations" / f"{name}.yaml").read_text())["layers"]
        for layer in layers:
            if "led_calib_model" in layer:
                layer["led_calib_model"] = {"LED_TYPE": ["590", "670"], "LED_TIME": [seconds, seconds]}
            if "nonlinearity" in layer:
                layer["nonlinearity"] = {"nonlinearity_16channel": True}
        (folder / f"{name}.yaml").write_text(yaml.safe_dump({"layers": layers}))
    return {kind: str(folder / f"{name}.yaml") for kind, (name, *_) in KINDS.items()}


def make_frames(folder):
    """Make the frames on disk; return the campaign and {kind: [Level0]}, flats two by two at rising levels."""
    table = [
        f"10{number:02d}00000{n:02d},{kind},0,0,0,2027-06-01T00:00:00,{exptime}"
        for number, (kind, (_, exptime, count)) in enumerate(KINDS.items())
        for n in range(count)
    ]
    lists, select = write_lists(folder, SECONDS[0]), {"types": list(KINDS), "chips": [CHIP]}
    path = write_campaign(folder, table, GEOMETRY, select=select, observations=lists)
    files = {kind: [] for kind in KINDS}
    for level, seconds in enumerate(SECONDS):
        write_lists(folder, seconds)
        campaign = OpenCampaign(path)
        flats = [job for job in campaign.jobs if job.pointing.type == "FLAT"][2 * level : 2 * level + 2]
        dim = [job for job in campaign.jobs if job.pointing.type != "FLAT"] if level == 0 else []
        for job in dim + flats:
            chip_stage.chip(campaign, job, log=lambda text: None)
            files[job.pointing.type].append(read_level0(campaign.paths.level0(job)))
    return campaign, files


def bad_columns(biases):
    """Return (nx,) columns that stand out of the biases next to the seam, in either half, and those beside them."""
    middle = np.median([file.assembled() for file in biases], axis=0)
    halves = middle[SIDE - 25 : SIDE].mean(axis=0), middle[SIDE : SIDE + 25].mean(axis=0)
    spoilt = np.any([half - ndimage.median_filter(half, 51) > 20 for half in halves], axis=0)
    return ndimage.binary_dilation(spoilt, np.ones(3, bool))


def reduce(channels, block, bad):
    """Return what one channel's frames {kind: [Channel]} give, in DN, each with its error; bad (nx,) of its columns."""
    scans = {
        kind: [overscan_level(c.serial_overscan, from_right=block.flip_x) for c in channels[kind]] for kind in KINDS
    }
    level, noise = np.mean(scans["BIAS"], axis=0)
    zero = noise**2 / (SIDE * (OVERSCAN - 4))  # variance of a frame's own
    raw = {kind: np.stack([c.active for c in channels[kind]]) for kind in KINDS}
    frames = {kind: raw[kind] - np.array(scans[kind])[:, :1, None] for kind in KINDS}
    dark, light = np.median(frames["DARK"], axis=0), frames["FLAT"].sum(axis=0)
    hot, dead = dark - np.median(dark) > 4 * noise, light < 0.8 * np.median(light)
    still = ndimage.binary_dilation(hot, estimate.GROW) | dead | bad
    clean = {kind: ~(estimate.struck(frames[kind], noise, still) | still) for kind in ("BIAS", "DARK")}
    values = {kind: frames[kind][clean[kind]] for kind in clean}
    active, errors = raw["BIAS"][clean["BIAS"]], [v.var() / v.size + zero / 5 for v in values.values()]
    return {
        "overscan": (level, np.sqrt(zero / 5)),
        "active": (active.mean(), active.std() / np.sqrt(active.size)),
        "noise": (np.sqrt(values["BIAS"].var() - 1 / 12), np.sqrt(values["BIAS"].var() / 2 / active.size)),
        "dark": (values["DARK"].mean() - values["BIAS"].mean(), np.sqrt(sum(errors))),
    } | reduce_light(frames["FLAT"], still, noise, zero)  # fmt: skip


def reduce_light(flats, still, noise, zero):
    """Return {"line": ((q, c), errors), "transfer": (levels, variances, numbers)} of flats (n, ny, nx), DN."""
    pairs = list(zip(flats[::2], flats[1::2], strict=True))
    kept = [~(still | estimate.struck_of_pair(*pair, still)) for pair in pairs]
    number = np.array([ok.sum() for ok in kept])
    means = np.array([np.mean([flat[ok] for flat in pair]) for pair, ok in zip(pairs, kept, strict=True)])
    halves = np.array([np.var((one - two)[ok]) / 2 for (one, two), ok in zip(pairs, kept, strict=True)])
    uneven = (pairs[-1][0][kept[-1]].var() - halves[-1]) / means[-1] ** 2
    errors = np.sqrt(halves / number / 2 + zero / 2)
    (q, c), covariance = estimate.linearity(SECONDS, means, errors, 1 + uneven)
    linear = estimate.straightened(means, q, c)
    slope = 1 + linear * (2 * q + 3 * c * linear)
    return {
        "line": ((q, c), np.sqrt(np.diag(covariance))),
        "transfer": (linear, (halves - noise**2) / slope**2, number),
    }


@pytest.fixture(scope="module")
def stacks(tmp_path_factory):
    """(detector, IMAGE header, {quantity: (found (16,), errors (16,)) in DN}, photon transfer)."""
    campaign, files = make_frames(tmp_path_factory.mktemp("stacks"))
    channels = [{kind: [] for kind in KINDS} for _ in range(16)]
    for kind, some in files.items():
        for file in some:
            for channel in file.channels():
                channels[channel.number - 1][kind].append(channel)
    bad, blocks = bad_columns(files["BIAS"]), files["BIAS"][0].readout.blocks
    found = [reduce(c, b, bad[b.image[1]]) for c, b in zip(channels, blocks, strict=True)]
    numbers = {name: np.array([f[name] for f in found]).T for name in ("overscan", "active", "noise", "dark")}
    numbers["quadratic"], numbers["cubic"] = np.array([f["line"] for f in found]).transpose(2, 1, 0)
    transfer = (np.stack(part, axis=1) for part in zip(*(f["transfer"] for f in found), strict=True))
    fitted, covariance = estimate.photon_transfer(*transfer)
    return campaign.camera.detector, files["BIAS"][0].header, numbers, (fitted, np.sqrt(np.diag(covariance)))


def configured(header, prefix):
    return np.array([header[f"{prefix}{n:02d}"] for n in range(1, 17)])


def within(found, errors, wanted):
    """Each channel, and the errors themselves: the rms of 16 numbers of variance 1 is within 0.5 and 1.7, 4 sigma."""
    pulls = (found - wanted) / errors
    assert np.abs(pulls).max() < 5, pulls
    assert 0.5 < np.sqrt(np.mean(pulls**2)) < 1.7, pulls


@pytest.mark.parametrize("region", ["overscan", "active"])
def test_bias(stacks, region):
    _, header, numbers, _ = stacks
    found, errors = numbers[region]
    within(found, errors, configured(header, "DETBIA"))
    assert errors.max() < 0.03 and np.ptp(found) > 10  # DN


def test_gain_and_brighter_fatter(stacks):
    detector, header, _, (fitted, errors) = stacks
    within(fitted[:16], errors[:16], configured(header, "GAIN"))
    assert errors[:16].max() < 0.006  # e-/DN; channels differ by up to 1% from 1.1
    push = detector.brighter_fatter
    wanted = push["scale"] * push["areas"][0][0]
    assert abs(fitted[16] - wanted) < 5 * errors[16] < 0.2 * abs(wanted)


def test_read_noise(stacks):
    _, header, numbers, (fitted, errors) = stacks
    (noise, error), gain = numbers["noise"], fitted[:16]
    within(noise * gain, np.hypot(error * gain, noise * errors[:16]), configured(header, "RON"))


def test_dark_current(stacks):
    detector, _, numbers, (fitted, errors) = stacks
    (dark, error), gain = numbers["dark"], fitted[:16]
    within(dark * gain / DARK, np.hypot(error * gain, dark * errors[:16]) / DARK, detector.dark)
    assert error.max() < 0.04  # DN, of 2.7


@pytest.mark.parametrize("name, prefix, power", [("quadratic", "NLQ", 1), ("cubic", "NLC", 2)])
def test_nonlinearity(stacks, name, prefix, power):
    _, header, numbers, (fitted, errors) = stacks
    (found, error), gain = numbers[name], fitted[:16]
    within(
        found / gain**power,
        np.hypot(error, power * found * errors[:16] / gain) / gain**power,
        configured(header, prefix),
    )
    assert error.max() < (2e-8 if power == 1 else 1e-12)
