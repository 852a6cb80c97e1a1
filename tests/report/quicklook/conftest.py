"""Files to be shown: a tiny exposure of a star and two galaxies, a windowed bias, images of others."""

import numpy as np
import pytest
from astropy.io import fits
from support.mini_campaign import POINTINGS, write_campaign, write_scene
from support.tangent_header import tangent_header

from csstsim.campaign.opened import OpenCampaign
from csstsim.stages import chip as chip_stage
from csstsim.stages import level0 as level0_stage
from csstsim.stages import psf as psf_stage
from csstsim.stages import readout as readout_stage
from csstsim.stages import render as render_stage
from csstsim.stages import select as select_stage

PLACES = ([30.0, 60.0, 90.0], [40.0, 60.0, 95.0])


@pytest.fixture(scope="session")
def exposure(tmp_path_factory):
    """The (campaign, job) of a star at 30, 40 and galaxies at 60, 60 and 90, 95, run stage by stage."""
    run = OpenCampaign(write_scene(tmp_path_factory.mktemp("scene"), "Pair", *PLACES, 18.0))
    job = run.jobs[0]
    psf_stage.psf(run, job.chip.id)
    for stage in (select_stage.select, render_stage.render, readout_stage.readout, level0_stage.level0):
        stage(run, job)
    return run, job


@pytest.fixture(scope="session")
def level0(exposure):
    run, job = exposure
    return run.paths.level0(job)


@pytest.fixture(scope="session")
def windowed(tmp_path_factory):
    """The Level-0 file of a bias exposure that reads columns 20 to 69, rows 30 to 109."""
    window = {"x0": 20, "x1": 70, "y0": 30, "y1": 110}
    folder = tmp_path_factory.mktemp("bias")
    path = write_campaign(folder, [POINTINGS[2]], select={"types": ["BIAS"], "chips": [9]}, window=window)
    run = OpenCampaign(path)
    job = run.jobs[0]
    chip_stage.chip(run, job, log=lambda text: None)
    return run.paths.level0(job)


@pytest.fixture
def calibrated(tmp_path):
    """Return a function that writes `image` as the SCI of a calibrated file with `cards` and returns its path."""

    def write(image, **cards):
        primary = fits.PrimaryHDU()
        primary.header.update({"OBSID": "10100000001", "CHIPID": 9, "FILTER": "r", "EXPTIME": 150.0})
        header = tangent_header()
        header.update(cards)
        planes = [fits.ImageHDU(np.asarray(image), header, name="SCI"), fits.ImageHDU(np.ones((2, 2)), name="ERR")]
        path = tmp_path / "calibrated.fits"
        fits.HDUList([primary, *planes]).writeto(path, overwrite=True)
        return path

    return write
