"""Two runs of the small campaign, each in its own folder, and copies of the first to damage."""

import shutil

import pytest
from delivery.small_delivery import delivery

from csstsim.campaign.opened import OpenCampaign


@pytest.fixture(scope="session")
def runs(sound, tmp_path_factory):
    """The output folders of two runs; nothing is to be changed in them."""
    return sound[1], OpenCampaign(delivery(tmp_path_factory.mktemp("the second run"))).paths.output


@pytest.fixture
def copied(runs, tmp_path):
    """(the first run's output folder, a copy of it)."""
    return runs[0], shutil.copytree(runs[0], tmp_path / "copy")
