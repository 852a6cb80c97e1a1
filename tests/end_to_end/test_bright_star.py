"""A star of magnitude 0, 1e11 electrons in a pixel, saturates, blooms and is written, in both orders of the layers."""

import numpy as np
import pytest
from mini_campaign import write_scene

from csstsim import stages
from csstsim.campaign import OpenCampaign
from csstsim.config import SHIPPED
from csstsim.io.level0 import read_level0


@pytest.mark.parametrize("order", ["science", "science_paper"])
def test_it_saturates_and_is_written(tmp_path, order):
    lists = {"SCIE": str(SHIPPED / "observations" / f"{order}.yaml")}
    run = OpenCampaign(write_scene(tmp_path, "Stars", [60.0], [60.0], 0.0, observations=lists))
    [job] = run.jobs
    stages.chip(run, job, say=lambda _: None)
    file = read_level0(run.paths.level0(job.pointing, job.chip.id), verify=True)
    assert file.header["NSATUR"] > 100 and file.header["BLOOMOUT"] > 1e10
    assert np.isfinite(file.assembled()).all() and file.header["CLIPHIGH"] > 100
