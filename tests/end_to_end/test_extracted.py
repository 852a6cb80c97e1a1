"""Stars of known magnitude on a GV chip's window, through every layer, and back from the Level-0 file."""

import numpy as np
import pytest
import yaml
from click.testing import CliRunner

from csstsim.campaign import OpenCampaign
from csstsim.catalog.astrometry import icrs
from csstsim.catalog.table import ObjectTable
from csstsim.cli import main
from csstsim.config import SHIPPED
from csstsim.instrument.filter import GRID
from csstsim.measure import extract
from csstsim.units import ab_photon_density

OBSID = "10100000001"


@pytest.fixture(scope="module")
def campaign(tmp_path_factory):
    """A campaign file: a star in front of either grating of chip 2."""
    folder = tmp_path_factory.mktemp("extracted")
    content = {
        "schema_version": 1,
        "name": "extracted", "survey_table": str(SHIPPED.parent / "survey_tables" / "demo.csv"), "seed": 5,
        "output": str(folder / "out"), "select": {"types": ["SCIE"], "chips": [2, 9], "obsids": [OBSID]},
        "window": {"x0": 3100, "x1": 4300, "y0": 4100, "y1": 4220}, "psf": {"grid": 2},
    }  # fmt: skip
    file = folder / "campaign.yaml"
    file.write_text(yaml.safe_dump(content))
    job = OpenCampaign(file).job(OBSID, 2)
    x, y = np.array([2650.3, 4700.6]), np.array([4130.2, 4185.7])
    ra, dec = icrs(*job.wcs.pixel_to_world(x, y), job.observer)
    options = {"ra": ra.tolist(), "dec": dec.tolist(), "mag": [16.0, 16.0]}
    file.write_text(yaml.safe_dump(content | {"catalog": {"kind": "mini_campaign:Stars", "options": options}}))
    return file


def test_flux_of_stars_through_both_gratings(campaign):
    for command in ("chip", "extract"):
        result = CliRunner().invoke(main, [command, str(campaign), "--obsid", OBSID, "--chip", "2"])
        assert result.exit_code == 0, result.output
    run = OpenCampaign(campaign)
    table = ObjectTable.read(run.paths.spectra(OBSID, 2))
    assert table.meta["recipe"] == run.measure_recipe(run.job(OBSID, 2)) and table.meta["spectra"] == 2
    for star in (0, 1):
        good = (table["id"] == star) & (table["flags"] & (extract.DIM | extract.LOST) == 0)
        assert good.sum() > 330
        light, true, error = (table[name][good].astype(float) for name in ("electrons", "model", "electrons_err"))
        assert light.sum() == pytest.approx(true.sum(), rel=0.01)  # noise: 0.1%
        assert 0.85 < ((light - true) / error).std() < 1.25
        given = np.interp(table["wavelength"][good], GRID, ab_photon_density(GRID, 16.0))
        assert np.median(table["flux"][good] / given) == pytest.approx(1.0, abs=0.01)


def test_imaging_chips_are_refused(campaign):
    result = CliRunner().invoke(main, ["extract", str(campaign), "--obsid", OBSID, "--chip", "9"])
    assert result.exit_code == 2
    assert "has no spectra" in result.output and "chip" in result.output
