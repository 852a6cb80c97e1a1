from my_catalogue import CsvCatalogue

from csstsim.catalog.contract import check, sky_region

OPTIONS = {"table": "examples/my_catalogue/data/objects.csv", "curves": "config/curves"}


def test_contract():
    report = check(CsvCatalogue, OPTIONS, sky_region(ra=60.1172, dec=-40.0330, radius=0.1))
    assert not report.faults, report
