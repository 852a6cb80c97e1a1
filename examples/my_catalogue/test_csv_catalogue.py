from pathlib import Path

from my_catalogue import CsvCatalogue

from csstsim.campaign.opened import OpenCampaign
from csstsim.catalog.contract import check, sky_region


def test_contract():
    run = OpenCampaign(Path(__file__).with_name("campaign.yaml"))
    report = check(CsvCatalogue, run.catalog.options, sky_region(ra=60.1172, dec=-40.0330, radius=0.1))
    assert not report.faults, report
