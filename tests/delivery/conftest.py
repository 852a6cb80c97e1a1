"""The small campaign, made once; copies of it to spoil."""

import shutil

import pytest
from small_delivery import delivery

from csstsim.campaign.opened import OpenCampaign


@pytest.fixture(scope="session")
def sound(tmp_path_factory):
    """(campaign file, its output folder) of a finished campaign; nothing is to be changed in it."""
    file = delivery(tmp_path_factory.mktemp("delivery"))
    return file, OpenCampaign(file).paths.output


@pytest.fixture
def copied(sound, tmp_path):
    """(campaign file, a copy of its output folder)."""
    return sound[0], shutil.copytree(sound[1], tmp_path / "a copy")
