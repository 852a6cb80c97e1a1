"""Layout `chip` with an older form of names, from the command to what clients and our own commands read."""

import numpy as np
import pytest
import sep
import yaml
from astropy.io import fits
from astropy.table import Table
from astropy.wcs import WCS
from click.testing import CliRunner
from support.mini_campaign import write_scene
from support.readout_state import plain_list

from csstsim.campaign.opened import OpenCampaign
from csstsim.catalog.table import ObjectTable
from csstsim.command_line.main import main
from csstsim.io.level0 import read_level0
from csstsim.io.truth import read_truth
from csstsim.measure.bricks.validation.facts import header_off, pixels_off
from csstsim.stages.parts.frame_facts import frame_facts

pytestmark = pytest.mark.thorough

OBSID, CHIP = "10100000001", 9
PLACE_PX = 0.02


def run(*arguments):
    result = CliRunner().invoke(main, [str(a) for a in arguments], catch_exceptions=False)
    assert result.exit_code == 0, result.output
    return result.output


@pytest.fixture(scope="module")
def campaign(tmp_path_factory):
    """Nine stars of 2e5 electrons, seen without distortion; one Level-0 file, C5.2."""
    folder = tmp_path_factory.mktemp("assembled")
    layers = plain_list("science")
    layers[0]["scie_obs"]["field_dist"] = False
    layers[-1]["quantization_and_output"]["layout"] = "chip"
    (folder / "science.yaml").write_text(yaml.safe_dump({"layers": layers}))
    x, y = (v.ravel() + 0.5 for v in np.meshgrid([20, 63, 106], [20, 63, 106]))
    path = write_scene(
        folder, "Stars", x, y, 18.0, CHIP, observations={"SCIE": str(folder / "science.yaml")}, level0_names="C5.2",
        truth=["parquet", "cat"],
    )  # fmt: skip
    run("chip", path, "--obsid", OBSID, "--chip", CHIP)
    return OpenCampaign(path)


def test_what_an_early_pipeline_reads(campaign):
    """Names, HDU, type and keywords, by astropy alone; stars stand where the only WCS says, linear in the pixels."""
    job = campaign.job(OBSID, CHIP)
    path = campaign.paths.level0(job)
    words = path.name.removesuffix(".fits").split("_")
    assert words[:4] == ["CSST", "MSC", "MS", "SCI"] and words[6:] == [OBSID, "09", "L0", "1"]
    text = campaign.paths.level0_catalogue(job)
    assert text.name == f"MSC_{OBSID}_chip_09_filt_r.cat" and len(Table.read(text, format="ascii")) == 9
    with fits.open(path) as file:
        detector = campaign.camera.detector
        first, header, image = file[0].header, file[1].header, file[1].data
        assert image.shape == (detector.ny, detector.nx) and image.dtype == np.uint16
        assert first["FILENAME"] == path.stem and first["EXPTIME"] == 150 and first["INSTRUME"] == "MSC"
        assert header["BUNIT"] == "ADU" and (header["PSCAN1"], header["OSCAN1"], header["OSCAN2"]) == (0, 0, 0)
        assert header["GAIN1"] == header["GAIN01"] == header["GAIN16"] == pytest.approx(detector.gain, rel=0.01)
        assert header["RDNOISE1"] == pytest.approx(detector.read_noise)
        assert not [name for name in header if name.startswith(("BSEC", "CRPIX1A"))]
        wcs = WCS(header)
    light = image.astype(float) - np.median(image)
    truth = read_truth(campaign.paths.level0_truth(job))
    x, y = wcs.all_world2pix(truth["ra"], truth["dec"], 0)
    found = sep.winpos(light, x, y, np.full(len(x), 1.5), subpix=0)
    assert np.hypot(found[0] - x, found[1] - y).max() < PLACE_PX


def test_our_own_commands_take_it(campaign):
    """calibrate, measure, verify and the facts of validate; what the overscan would give is taken from the header."""
    where = campaign.file, "--obsid", OBSID, "--chip", CHIP
    run("calibrate", *where)
    run("measure", *where)
    said = CliRunner().invoke(main, ["verify", str(campaign.paths.output)]).output
    assert "report/index.html: missing" in said and "2 faults" in said  # nothing else is
    job = campaign.job(OBSID, CHIP)
    facts = frame_facts(campaign, job)
    assert max(abs(value) for _, value, _ in header_off(facts)["gain"]) < 1e-12
    channels = ObjectTable.read(campaign.paths.measure(OBSID, CHIP)).meta["channels"]
    truth = read_truth(campaign.paths.level0_truth(job))
    off = pixels_off(channels, facts, truth, campaign.camera.telescope.pixel_scale)
    assert len(channels) == 16 and off["bias"] == off["read_noise"] == []
    file = read_level0(campaign.paths.level0(job), verify=True)
    assert file.layout == "chip" and not file.readout.overscan
    science = fits.getdata(campaign.paths.calibrated(OBSID, CHIP), "SCI")
    assert abs(np.median(science)) < 0.05
    electrons = (file.assembled().astype(float) - file.levels[1][0]) * file.gain[1]
    assert np.median(electrons) == pytest.approx(150 * campaign.camera.filters["r"].sky, rel=0.5)
