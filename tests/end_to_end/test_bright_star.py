"""A star of magnitude 0, 1e11 electrons in a pixel, saturates, blooms and is written, in both orders of the layers."""

import numpy as np
import pytest
from support.mini_campaign import write_scene

from csstsim.base.shipped import SHIPPED
from csstsim.campaign.opened import OpenCampaign
from csstsim.io.level0 import read_level0
from csstsim.stages import chip as chip_stage

pytestmark = pytest.mark.thorough


@pytest.mark.parametrize("order", ["science", "science_paper"])
def test_it_saturates_and_is_written(tmp_path, order):
    lists = {"SCIE": str(SHIPPED / "observations" / f"{order}.yaml")}
    run = OpenCampaign(write_scene(tmp_path, "Stars", [60.0], [60.0], 0.0, observations=lists))
    [job] = run.jobs
    chip_stage.chip(run, job, log=lambda _: None)
    file = read_level0(run.paths.level0(job), verify=True)
    assert file.header["NSATUR"] > 100 and file.header["BLOOMOUT"] > 1e10
    assert np.isfinite(file.assembled()).all() and file.header["CLIPHIGH"] > 100
