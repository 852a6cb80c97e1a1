"""Stars of known magnitude on a GV chip's window, through every layer, are recovered from the Level-0 file."""

import numpy as np
import pytest
import yaml
from support.commands import done, refused
from support.mini_campaign import Emitters

from csstsim.base.shipped import SHIPPED
from csstsim.base.units import ab_photon_density
from csstsim.campaign.opened import OpenCampaign
from csstsim.catalog.astrometry.reduction import icrs
from csstsim.catalog.table import ObjectTable
from csstsim.instrument.filter import GRID
from csstsim.measure.spectra.spectrum_columns import BESIDE, DIM, LOST, SATURATED

pytestmark = pytest.mark.thorough

OBSID = "10100000001"


def made(folder, magnitudes, window, places, objects="Stars", **changes):
    """A campaign file: a star in front of either grating of chip 2."""
    content = {
        "schema_version": 1,
        "name": "extracted", "survey_table": str(SHIPPED.parent / "survey_tables" / "demo.csv"), "seed": 5,
        "output": str(folder / "out"), "select": {"types": ["SCIE"], "chips": [2, 9], "obsids": [OBSID]},
        "window": window, "psf": {"grid": 2}, **changes,
    }  # fmt: skip
    file = folder / "campaign.yaml"
    file.write_text(yaml.safe_dump(content))
    job = OpenCampaign(file).job(OBSID, 2)
    ra, dec = icrs(*job.wcs.pixel_to_world(*np.array(places)), job.observer)
    options = {"ra": ra.tolist(), "dec": dec.tolist(), "mag": magnitudes}
    file.write_text(
        yaml.safe_dump(content | {"catalog": {"kind": f"support.mini_campaign:{objects}", "options": options}})
    )
    return file


@pytest.fixture(scope="module")
def campaign(tmp_path_factory):
    window = {"x0": 3100, "x1": 4300, "y0": 4100, "y1": 4220}
    places = [2650.3, 4700.6], [4130.2, 4185.7]
    return made(tmp_path_factory.mktemp("extracted"), [16.0, 16.0], window, places)


def extracted(campaign):
    """The open campaign and its table of spectra, by the commands."""
    for verb in ("chip", "extract"):
        done(verb, campaign, "--obsid", OBSID, "--chip", 2)
    run = OpenCampaign(campaign)
    return run, ObjectTable.read(run.paths.spectra(OBSID, 2))


def test_flux_of_stars_through_both_gratings(campaign):
    run, table = extracted(campaign)
    assert table.meta["recipe"] == run.recipe(run.job(OBSID, 2), "measure") and table.meta["spectra"] == 2
    for star in (0, 1):
        good = (table["id"] == star) & (table["flags"] & (DIM | LOST) == 0)
        assert good.sum() > 330
        light, true, error = (table[name][good].astype(float) for name in ("electrons", "model", "electrons_err"))
        assert light.sum() == pytest.approx(true.sum(), rel=0.01)  # noise: 0.1%
        assert 0.85 < ((light - true) / error).std() < 1.25
        given = np.interp(table["wavelength"][good], GRID, ab_photon_density(GRID, 16.0))
        assert np.median(table["flux"][good] / given) == pytest.approx(1.0, abs=0.01)


def test_a_line_of_a_galaxy_is_measured_by_the_commands(tmp_path):
    """[OII] at z = 0.35 in a galaxy of 19 mag, through every layer, to 5 sigma and 3%; a star has no known line."""
    window = {"x0": 3100, "x1": 4300, "y0": 4100, "y1": 4220}
    places = [2650.3, 4700.6], [4130.2, 4185.7]
    file = made(tmp_path, [18.0, 19.0], window, places, "Emitters")
    run, _ = extracted(file)
    lines = ObjectTable.read(run.paths.lines(OBSID, 2))
    assert lines.meta["recipe"] == run.recipe(run.job(OBSID, 2), "measure")
    assert lines.meta["lines"] == len(lines) and lines.meta["limits_held"] <= lines.meta["limits"]
    [k] = np.flatnonzero(lines["line"] == "[OII]")
    given = Emitters.PHOTONS * 1.986446e-12 / lines["wavelength"][k]
    assert lines["id"][k] == 1 and lines["snr"][k] > 10
    assert abs(lines["flux"][k] - given) < 5 * lines["flux_err"][k] + 0.03 * given
    assert lines["flux_true"][k] == pytest.approx(given, rel=0.05)
    assert set(lines["line"][lines["id"] == 0].tolist()) <= {""}


def test_imaging_chips_are_refused(campaign):
    line = refused("extract", campaign, "--obsid", OBSID, "--chip", 9)
    assert "has no spectra" in line and "chip" in line


def test_columns_without_a_flag_are_as_good_as_they_say(tmp_path):
    """Of stars near and above saturation, to the ends of the spectrum, where wings of the brighter columns lie.

    Pulls of 34 and 346 columns: their width within 5 sigma of its error and 5% of the PSF's, their sum to 5 sigma and
    0.15%, none beyond 4.5. Cosmic rays are left out: what the extraction rejects of them is another matter.
    """
    layers = yaml.safe_load((SHIPPED / "observations" / "science.yaml").read_text())["layers"]
    file = tmp_path / "science.yaml"
    file.write_text(yaml.safe_dump({"layers": [layer for layer in layers if "cosmic_rays" not in layer]}))
    window, places = {"x0": 3100, "x1": 4300, "y0": 4000, "y1": 4320}, ([2650.3, 4700.6], [4080.2, 4235.7])
    _, table = extracted(made(tmp_path, [12.0, 12.5], window, places, observations={"SCIE": str(file)}))
    for star, (saturated, fewest) in enumerate([(280, 25), (0, 320)]):
        mine = table["id"] == star
        full, beside = ((table["flags"][mine] & bit) > 0 for bit in (SATURATED, BESIDE))
        assert full.sum() >= saturated and (full.sum() > 0) == (saturated > 0) == (beside.sum() > 0)
        good = mine & (table["flags"] == 0)
        light, true, error = (table[name][good].astype(float) for name in ("electrons", "model", "electrons_err"))
        pull, n = (light - true) / error, good.sum()
        assert n > fewest and pull.std() < 1.05 + 5 / np.sqrt(2 * n) and np.abs(pull).max() < 4.5
        assert abs(light.sum() / true.sum() - 1) < 0.0015 + 5 * np.sqrt((error**2).sum()) / true.sum()
