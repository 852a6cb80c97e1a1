"""Calibrated images are rates: stars, background and errors of a frame against the electrons of its truth."""

import numpy as np
import pytest
from astropy.io import fits
from support.mini_campaign import write_scene

from csstsim.campaign.opened import OpenCampaign
from csstsim.io.truth import read_truth
from csstsim.stages.calibrate import calibrate
from csstsim.stages.chip import chip

EXPTIME, HALF = 150.0, 12  # s; px about a star


@pytest.fixture(scope="module")
def frame(tmp_path_factory):
    """({extension: data}, header of SCI, truth) of a frame with two stars of 19.5 mag."""
    positions = [40.0, 90.0], [45.0, 85.0]
    run = OpenCampaign(write_scene(tmp_path_factory.mktemp("rates"), "Stars", *positions, 19.5))
    (job,) = run.jobs
    chip(run, job, log=str)
    calibrate(run, job)
    with fits.open(run.paths.calibrated(*job.key)) as file:
        planes = {name: file[name].data.astype(float) for name in ("SCI", "ERR", "DQ")}
        return planes, file["SCI"].header, read_truth(run.paths.level0_truth(job))


def test_a_star_has_its_electrons(frame):
    """Within 6%: noise is 1%, and a box of 25 px holds 96% of a star's light."""
    planes, _, truth = frame
    for x, y, rendered in zip(truth["x"], truth["y"], truth["drawn"], strict=True):
        row, column = round(float(y)), round(float(x))
        box = planes["SCI"][row - HALF : row + HALF + 1, column - HALF : column + HALF + 1]
        assert box.sum() * EXPTIME == pytest.approx(rendered, rel=0.06)


def test_the_background_is_that_of_sky_and_dark(frame):
    planes, header, truth = frame
    budget = truth.meta["electrons"]
    pixel = (budget["light"] - budget["objects"] + budget["dark"]) / planes["SCI"].size
    assert header["BACKMED"] * EXPTIME == pytest.approx(pixel, rel=0.03)


def test_the_error_of_an_empty_pixel_is_the_scatter_there(frame):
    """Both robust: 10,000 pixels know their scatter to 1%, its 5 sigma."""
    planes, _, _ = frame
    empty = (planes["DQ"] == 0) & (np.abs(planes["SCI"]) < 5 * np.median(planes["ERR"]))
    scatter = 1.4826 * np.median(np.abs(planes["SCI"][empty] - np.median(planes["SCI"][empty])))
    assert np.median(planes["ERR"][empty]) == pytest.approx(scatter, rel=0.05)
