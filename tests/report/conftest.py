"""A campaign run up to its report, once for all tests."""

import pytest
from report_page import star_campaign
from support.commands import done


@pytest.fixture(scope="session")
def reported(tmp_path_factory):
    """(campaign file, OpenCampaign, what the report printed) of a whole r chip whose windows fill its thumbnail."""
    file, run = star_campaign(tmp_path_factory.mktemp("reported") / "a #1 folder")
    return file, run, done("report", file)
