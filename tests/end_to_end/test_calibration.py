"""Bias, dark and LED-flat exposures from table to Level-0 file; the flat of a science frame is removed."""

import numpy as np
import pytest
import yaml
from click.testing import CliRunner
from support.commands import done
from support.mini_campaign import write_campaign, write_scene
from support.readout_state import plain_list

from csstsim.base.rng import Streams
from csstsim.base.shipped import SHIPPED
from csstsim.campaign.opened import OpenCampaign
from csstsim.catalog.table import ObjectTable
from csstsim.command_line.main import main
from csstsim.instrument.filter import GRID
from csstsim.io.level0 import read_level0
from csstsim.measure.calibration.calibrate import Electronics, calibrate
from csstsim.optics.throughput.flat import FlatField
from csstsim.optics.throughput.led import load_leds
from csstsim.optics.throughput.response import response_map

pytestmark = pytest.mark.thorough

CHIP = 9
TABLE = [
    *(f"1030000000{i},BIAS,0,0,0,2027-06-01T00:0{i}:00,0" for i in range(1, 4)),
    *(f"1070000000{i},DARK,0,0,0,2027-06-01T00:1{i}:00,150" for i in range(1, 4)),
    "10000000001,FLAT,0,0,0,2027-06-01T00:20:00,150",
]


def _calibration(folder):
    """Return the campaign of the table, its lists without effects that a mean and a variance do not describe."""
    lists = {}
    for kind, name in (("BIAS", "bias"), ("DARK", "dark"), ("FLAT", "led_flat")):
        lists[kind] = str(folder / f"{name}.yaml")
        (folder / f"{name}.yaml").write_text(yaml.safe_dump({"layers": plain_list(name)}))
    select = {"types": ["BIAS", "DARK", "FLAT"], "chips": [CHIP]}
    return OpenCampaign(write_campaign(folder, TABLE, select=select, observations=lists))


@pytest.fixture(scope="module")
def frames(tmp_path_factory):
    """(campaign, {type: [Level0, ...]}) of every exposure of the table on one chip."""
    folder = tmp_path_factory.mktemp("calibration")
    campaign = _calibration(folder)
    found = {}
    for job in campaign.jobs:
        done("chip", campaign.file, "--obsid", job.obsid, "--chip", CHIP)
        file = read_level0(campaign.paths.level0(job), verify=True)
        found.setdefault(job.pointing.type, []).append(file)
    return campaign, found


def stack(files, channel):
    """Return the active pixels of one channel in all files, (files, n), DN."""
    return np.stack([next(c for c in f.channels() if c.number == channel).active.ravel() for f in files]).astype(float)


def test_a_bias_stack_gives_back_the_configured_levels(frames):
    """Each channel: mean = bias / gain and variance = (noise / gain)^2 + rounding, 5 sigma; levels differ as asked."""
    campaign, files = frames
    detector, levels = campaign.camera.detector, []
    for channel in range(1, 17):
        gain = files["BIAS"][0].gain[channel]
        pixels, variance = stack(files["BIAS"], channel), (detector.read_noise / gain) ** 2 + 1 / 12
        header = files["BIAS"][0].header[f"DETBIA{channel:02d}"]
        assert abs(pixels.mean() - header) < 5 * np.sqrt(variance / pixels.size)
        assert abs(pixels.var() - variance) < 5 * variance * np.sqrt(2 / pixels.size)
        levels.append(pixels.mean() * gain)
    assert np.abs(np.array(levels) - detector.bias).max() < detector.bias_spread + 1  # electron
    assert np.std(levels) == pytest.approx(detector.bias_spread / np.sqrt(3), rel=0.5)  # uniform; 16 draws


def test_a_dark_stack_gives_back_the_dark_current(frames):
    """Electrons over the bias stack: mean and variance of every channel, 5 sigma."""
    campaign, files = frames
    dark = campaign.camera.detector.dark * 150.0
    for channel in range(1, 17):
        gain = files["DARK"][0].gain[channel]
        bias, pixels = stack(files["BIAS"], channel), stack(files["DARK"], channel)
        variance = (dark + campaign.camera.detector.read_noise**2) / gain**2 + 1 / 12
        n = pixels.size
        assert abs((pixels.mean() - bias.mean()) * gain - dark) < 5 * gain * np.sqrt((variance + bias.var()) / n)
        assert abs(pixels.var() - variance) < 5 * variance * np.sqrt((2 + 1 / variance) / n)


def test_a_led_flat_divided_by_the_model_flat_is_flat_within_noise(frames):
    """Whole chain: chi2 per pixel is 1 within 5 sigma, with the noise of Poisson, readout and rounding."""
    campaign, files = frames
    [file], camera = files["FLAT"], campaign.camera
    [layer] = [e for e in yaml.safe_load((SHIPPED / "observations/led_flat.yaml").read_text())["layers"]
               if "led_calib_model" in e]  # fmt: skip
    types, times = layer["led_calib_model"]["LED_TYPE"], layer["led_calib_model"]["LED_TIME"]
    assert [file.header[f"LEDSTA{i:02d}"] for i in range(1, len(types) + 1)] == types
    assert [file.header[f"LEDT{i:02d}"] for i in range(1, len(times) + 1)] == times
    assert file.header["LEDFLAG"] is True and file.header["LEDINTP"] == "880" and "SHTOPEN0" not in file.header
    job, leds = campaign.job("10000000001", CHIP), load_leds(camera.leds)
    field = FlatField(camera.leds, Streams(campaign.config.seed, "", CHIP, "").camera)
    model = np.zeros(job.window.shape)
    for name, seconds in zip(types, times, strict=True):
        seen = leds[name].line * camera.filters[job.chip.filter].at(GRID)
        if seen.any():
            level = seconds * leds[name].rate * np.trapezoid(seen, GRID)
            model += level * field.led_map(job.chip, job.window, GRID, seen)
    electrons = calibrate(file.frame(), file.readout, Electronics(file.gain)).electrons.astype(float)
    detector = camera.detector
    dark = detector.dark * 150.0
    variance = model + dark + detector.read_noise**2 + detector.gain**2 / 12
    chi2 = np.mean((electrons - dark - model) ** 2 / variance)
    assert model.min() > 1e4
    assert abs(chi2 - 1) < 5 * np.sqrt(2 / model.size)
    assert abs(((electrons - dark) / model).mean() - 1) < 3e-4  # the bias of 16 short overscans


def test_unknown_lamps_and_long_lists_are_refused_before_work(tmp_path):
    layers = yaml.safe_load((SHIPPED / "observations/led_flat.yaml").read_text())["layers"][1:]
    for param, words in (
        ({"LED_TYPE": ["555"], "LED_TIME": [1.0]}, ["flat.yaml", "led_calib_model", "555", "275, 310"]),
        (
            {"LED_TYPE": ["590"], "LED_TIME": [151.0]},
            ["flat.yaml", "LED_TIME", "151", "exposure of 2027-06-01T00:20:00"],
        ),
    ):
        (tmp_path / "flat.yaml").write_text(yaml.safe_dump({"layers": [{"led_calib_model": param}, *layers]}))
        path = write_campaign(
            tmp_path, TABLE, select={"types": ["FLAT"], "chips": [CHIP]},
            observations={"FLAT": str(tmp_path / "flat.yaml")},
        )  # fmt: skip
        result = CliRunner().invoke(main, ["check", str(path)])
        assert result.exit_code == 2 and all(word in result.output for word in words), result.output


def test_measuring_takes_flat_and_shutter_out_again(tmp_path):
    """Nine stars of S/N > 200 under a vignetting of 30%: fluxes as without any loss, and errors that follow it."""
    found = {}
    x, y = (v.ravel() + 0.3 for v in np.meshgrid([20, 63, 106], [20, 63, 106]))
    layers = yaml.safe_load((SHIPPED / "observations" / "science.yaml").read_text())["layers"]
    for on in (True, False):
        folder = tmp_path / str(on)
        folder.mkdir()
        for layer in layers[:2]:
            for param in layer.values():
                param |= {"flat_fielding": on, "shutter_effect": on}
        (folder / "science.yaml").write_text(yaml.safe_dump({"layers": layers}))
        path = write_scene(folder, "Stars", x, y, mag=18.0, observations={"SCIE": str(folder / "science.yaml")})
        leds = yaml.safe_load((folder / "instrument" / "leds.yaml").read_text())
        leds["half_mosaic"]["value"], leds["vignetting"]["corner"]["value"] = [300, 250], [0.4, 0.4]
        (folder / "instrument" / "leds.yaml").write_text(yaml.safe_dump(leds))
        done("chip", path, "--obsid", "10100000001", "--chip", CHIP)
        done("measure", path, "--obsid", "10100000001", "--chip", CHIP)
        campaign = OpenCampaign(path)
        job = campaign.job("10100000001", CHIP)
        found[on] = ObjectTable.read(campaign.paths.measure("10100000001", CHIP))
        header = read_level0(campaign.paths.level0(job)).header
        assert ("SHTOPEN0" in header) == on
        if on:
            day = [header[k] for k in ("SHTOPEN0", "SHTOPEN1", "SHTCLOS0", "SHTCLOS1")]
            start, end = job.pointing.mjd, job.pointing.mjd + 150 / 86400
            assert day == pytest.approx([start, start + 1.3 / 86400, end - 1.3 / 86400, end], abs=1e-9)

    def stars(table):
        near = [np.hypot(table["x"] - a, table["y"] - b).argmin() for a, b in zip(x, y, strict=True)]
        return {name: table[name][near] for name in ("x", "y", "flux_psf", "flux_psf_err", "flux_kron_err")}

    lossy, plain = stars(found[True]), stars(found[False])
    snr = lossy["flux_psf"] / lossy["flux_psf_err"]
    assert snr.min() > 200
    ratio = lossy["flux_psf"] / plain["flux_psf"]
    noise = np.hypot(lossy["flux_psf_err"] / lossy["flux_psf"], plain["flux_psf_err"] / plain["flux_psf"])
    assert np.abs((ratio - 1) / noise).max() < 5
    assert np.abs((ratio - 1).mean()) < 5 * np.sqrt((noise**2).mean() / 9)
    assert max(np.abs(lossy[k] - plain[k]).max() for k in "xy") < 0.02  # px
    # Fewer electrons, larger errors: by 1 / sqrt(share), as these stars' own noise is nearly all; 3% for the rest
    job = campaign.job("10100000001", CHIP)
    share = response_map(
        job.chip,
        job.window,
        campaign.camera.filters["r"],
        150.0,
        flat=FlatField(campaign.camera.leds, Streams(campaign.config.seed, "", CHIP, "").camera),
        shutter=True,
    )[np.rint(y).astype(int), np.rint(x).astype(int)]
    assert share.max() < 0.95 and np.ptp(share) > 0.05
    for kind in ("psf", "kron"):
        error = (lossy[f"flux_{kind}_err"] / plain[f"flux_{kind}_err"]) ** 2
        assert error * share == pytest.approx(1, abs=0.03)
