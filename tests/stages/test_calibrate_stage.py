"""Calibrated images are rates: stars, background and errors of a frame against the electrons of its truth."""

import numpy as np
import pytest
from astropy.io import fits
from support.mini_campaign import write_scene

from csstsim.base.digest import digest
from csstsim.campaign.opened import OpenCampaign
from csstsim.catalog.open import open_catalog
from csstsim.io.level0 import read_level0
from csstsim.io.truth import read_truth
from csstsim.measure.light.photometry import psf_model
from csstsim.stages.calibrate import calibrate
from csstsim.stages.chip import chip
from csstsim.stages.psf import open_psf

EXPTIME, HALF = 150.0, 12  # s; px about a star


@pytest.fixture(scope="module")
def frame(tmp_path_factory):
    """({extension: data}, header of SCI, truth, campaign) of a frame with two stars of 19.5 mag."""
    positions = [40.0, 90.0], [45.0, 85.0]
    run = OpenCampaign(write_scene(tmp_path_factory.mktemp("rates"), "Stars", *positions, 19.5))
    (job,) = run.jobs
    chip(run, job, log=str)
    calibrate(run, job)
    with fits.open(run.paths.calibrated(*job.key)) as file:
        planes = {name: file[name].data.astype(float) for name in ("SCI", "ERR", "DQ")}
        return planes, file["SCI"].header, read_truth(run.paths.level0_truth(job)), run


def test_a_star_has_its_electrons(frame):
    """Within 6%: noise is 1%, and a box of 25 px holds 96% of a star's light."""
    planes, _, truth, _ = frame
    for x, y, rendered in zip(truth["x"], truth["y"], truth["drawn"], strict=True):
        row, column = round(float(y)), round(float(x))
        box = planes["SCI"][row - HALF : row + HALF + 1, column - HALF : column + HALF + 1]
        assert box.sum() * EXPTIME == pytest.approx(rendered, rel=0.06)


def test_the_background_is_that_of_sky_and_dark(frame):
    planes, header, truth, _ = frame
    budget = truth.meta["electrons"]
    pixel = (budget["light"] - budget["objects"] + budget["dark"]) / planes["SCI"].size
    assert header["BACKMED"] * EXPTIME == pytest.approx(pixel, rel=0.03)


def test_the_error_of_an_empty_pixel_is_the_scatter_there(frame):
    """Both robust: 10,000 pixels know their scatter to 1%, its 5 sigma."""
    planes, *_ = frame
    empty = (planes["DQ"] == 0) & (np.abs(planes["SCI"]) < 5 * np.median(planes["ERR"]))
    scatter = 1.4826 * np.median(np.abs(planes["SCI"][empty] - np.median(planes["SCI"][empty])))
    assert np.median(planes["ERR"][empty]) == pytest.approx(scatter, rel=0.05)


def test_the_header_turns_a_stars_rate_into_its_magnitude(frame):
    """AB magnitude of 1 e-/s, through flat field and shutter corrected: to 0.08 mag, as the box leaves light out."""
    planes, header, truth, run = frame
    for x, y in zip(truth["x"], truth["y"], strict=True):
        row, column = round(float(y)), round(float(x))
        rate = planes["SCI"][row - HALF : row + HALF + 1, column - HALF : column + HALF + 1].sum()
        assert header["MAGZERO"] - 2.5 * np.log10(rate) == pytest.approx(19.5, abs=0.08)
    assert header["RDNOISE"] == pytest.approx(run.camera.detector.read_noise, rel=0.05)


@pytest.mark.parametrize("window", [{"x0": 16, "x1": 112, "y0": 40, "y1": 96}])
def test_pixels_are_filled_with_the_psf_of_their_position_on_the_chip(tmp_path, monkeypatch, window):
    """A window whose corner has unlike coordinates."""
    run = OpenCampaign(write_scene(tmp_path, "Stars", [60.0], [60.0], 19.5, window=window))
    (job,) = run.jobs
    chip(run, job, log=str)
    asked = []

    def model(psf, corner, shape):
        asked.append((corner, shape))
        return psf_model(psf, corner, shape)

    monkeypatch.setattr("csstsim.measure.light.photometry.psf_model", model)
    calibrate(run, job)
    assert asked == [((16, 40), (56, 96))]


def test_the_file_says_of_which_catalogue_and_psf_its_light_is(frame):
    *_, run = frame
    (job,) = run.jobs
    header = read_level0(run.paths.level0(job)).header0
    assert header["PSFHASH"] == digest(open_psf(run, job.chip).attributes)
    assert header["TRUTHASH"] == open_catalog(run.catalog, run.region(job), run.paths.truth, {}).truth_hash
