"""The worked example of a user's own catalogue runs as its README says."""

import runpy
import sys

import numpy as np
import pytest
import yaml
from click.testing import CliRunner
from support.commands import done

from csstsim.base.shipped import SHIPPED
from csstsim.campaign.config import load_campaign
from csstsim.campaign.opened import OpenCampaign
from csstsim.catalog.contract import check
from csstsim.catalog.flags import BAD_VALUE
from csstsim.command_line.main import main
from csstsim.instrument.filter import GRID
from csstsim.io.truth import read_truth

EXAMPLE = SHIPPED.parent / "examples" / "my_catalogue"
OBSID, CHIP = "10100000004", 9


@pytest.fixture
def campaign(tmp_path, monkeypatch):
    """The example's campaign with its data and output in a folder of the test's; a file's path."""
    monkeypatch.chdir(SHIPPED.parent)
    monkeypatch.syspath_prepend(EXAMPLE)
    runpy.run_path(str(EXAMPLE / "make_data.py"))["main"](tmp_path / "data")
    config = load_campaign(EXAMPLE / "campaign.yaml").model_dump(mode="json")
    config["catalog"]["options"] = {"table": str(tmp_path / "data/objects.csv"), "curves": str(SHIPPED / "curves")}
    path = tmp_path / "campaign.yaml"
    path.write_text(yaml.safe_dump(config | {"output": str(tmp_path / "out")}))
    yield path
    sys.modules.pop("my_catalogue", None)


def test_it_is_drawn(campaign):
    done("chip", campaign, "--obsid", OBSID, "--chip", CHIP)
    run_ = OpenCampaign(campaign)
    truth = read_truth(run_.paths.level0_truth(run_.job(OBSID, CHIP)))
    assert sorted(truth["id"]) == list(range(1, 23))
    assert not (truth["flags"] & BAD_VALUE).any() and (truth["drawn"] > 100).all()
    assert truth["user_spectrum"][truth["id"] == 21] == "quasar.csv"


def test_it_keeps_the_contract_and_its_magnitudes(campaign):
    """`check` finds nothing; SDSS r of the spectra by speclite is the table's, to 2 mmag."""
    import speclite.filters
    from astropy import units as u

    assert "11 of type star" in done("check", campaign)
    run_ = OpenCampaign(campaign)
    region = run_.region(run_.job(OBSID, CHIP))
    report = check(run_.open_truth(), run_.config.catalog.options, region, run_.camera)
    assert not report.faults and not report.warnings, report
    catalog = run_.open_truth()(run_.config.catalog.options, region)
    [band] = speclite.filters.load_filters("sdss2010-r")
    wave = GRID * u.AA
    energy = (catalog.load_seds(range(22)) * u.ph / (u.s * u.m**2 * u.AA)).to(
        "erg / (s cm2 AA)", u.spectral_density(wave)
    )
    mags = np.array([band.get_ab_magnitude(sed, wave) for sed in energy])
    assert mags[:21] == pytest.approx([obj.mag_norm for obj in catalog.objs[:21]], abs=2e-3)
    assert energy[21, GRID == 5500.0].value == pytest.approx(1e-15, rel=1e-3)  # absolute


def test_its_own_test_passes_and_can_fail(tmp_path, monkeypatch):
    """In the folder that `csstsim init` makes of it."""
    folder = tmp_path / "copy"
    done("init", folder, "--example", "catalogue")
    runpy.run_path(str(folder / "make_data.py"))["main"](folder / "data")
    monkeypatch.syspath_prepend(folder)
    monkeypatch.delitem(sys.modules, "my_catalogue", raising=False)
    test = runpy.run_path(str(folder / "test_csv_catalogue.py"))["test_contract"]
    test()
    table = folder / "data" / "objects.csv"
    table.write_text(table.read_text().replace("2,star", "1,star", 1))
    with pytest.raises(AssertionError, match="an id given more than once"):
        test()
    del sys.modules["my_catalogue"]


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("sun.csv", "moon.csv", ["CsvCatalogue.load_sed, object 2", "FileNotFoundError", "moon.csv"]),
        ("2,star", "2,planet", ["object 2 is of unknown type", "planet", "star, galaxy, quasar"]),
        ("2,star", "1,star", ["an id given more than once: object 1"]),
    ],
)
def test_its_mistakes_are_one_line(campaign, old, new, words):
    table = campaign.parent / "data" / "objects.csv"
    table.write_text(table.read_text().replace(old, new))
    result = CliRunner().invoke(main, ["-v", "check", str(campaign)])
    *before, last = result.stderr.strip().splitlines()
    assert result.exit_code == 2 and last.startswith("csstsim: error: ") and all(word in last for word in words), last
    assert any(line.startswith("Traceback") for line in before)
