"""Bias, dark and lamp exposures become masters; a science frame is calibrated with them, and with the truth."""

import numpy as np
import pytest
import yaml
from astropy.io import fits
from astropy.wcs import WCS
from support.commands import command, done
from support.mini_campaign import POINTINGS, write_campaign, write_scene

from csstsim.base.rng import Streams
from csstsim.campaign.opened import OpenCampaign
from csstsim.catalog.astrometry.reduction import icrs
from csstsim.detector import prnu
from csstsim.io.frames import load_frame
from csstsim.io.output_owner import OWNER_FILE
from csstsim.io.truth import read_truth
from csstsim.measure.calibration.bad_pixels import known_defects
from csstsim.stages.calibrate import calibrated_frame
from csstsim.stages.psf import open_psf

pytestmark = pytest.mark.thorough

CHIP = 9
TABLE = [
    *(f"1030000000{i},BIAS,0,0,0,2027-06-01T00:0{i}:00,0" for i in range(1, 4)),
    *(f"1070000000{i},DARK,0,0,0,2027-06-01T00:1{i}:00,150" for i in range(1, 4)),
    *(f"1000000000{i},FLAT,0,0,0,2027-06-01T00:2{i}:00,150" for i in range(1, 5)),
]
HALF = 8  # px
X, Y = np.array([30.3, 64.0, 100.6]), np.array([20.4, 100.2, 60.1])


@pytest.fixture(scope="module")
def calibration(tmp_path_factory):
    """The campaign whose masters of one chip are made."""
    folder = tmp_path_factory.mktemp("masters")
    select = {"types": ["BIAS", "DARK", "FLAT"], "chips": [CHIP]}
    campaign = OpenCampaign(write_campaign(folder, TABLE, select=select))
    for obsid in campaign.pointings:
        done("chip", campaign.file, "--obsid", obsid, "--chip", CHIP)
    assert "of the pixels are bad" in done("masters", campaign.file, "--chip", CHIP)
    return campaign


@pytest.fixture(scope="module")
def science(tmp_path_factory):
    """A frame of three stars, made: {calibration: campaign}."""
    folder = tmp_path_factory.mktemp("science")
    file = write_scene(folder, "Stars", X, Y, 18.0)
    done("chip", file, "--obsid", POINTINGS[0].split(",")[0], "--chip", CHIP)
    return file


def changed(file, **measurement):
    """Return the campaign with another `measurement`; the output folder is its own from now on."""
    path = file.with_name("changed.yaml")
    (file.parent / "out" / OWNER_FILE).unlink(missing_ok=True)
    path.write_text(yaml.safe_dump(yaml.safe_load(file.read_text()) | {"measurement": measurement}))
    return OpenCampaign(path)


def test_the_flat_is_the_pixels_response(calibration):
    """What is left of 1% is shot noise of four exposures, the large scales taken off, and no more than 15% else."""
    planes, meta = load_frame(calibration.paths.masters(CHIP))
    detector = calibration.camera.detector
    true = np.ones((detector.ny, detector.nx), np.float32)
    prnu.multiply(true, 0, 0, detector.prnu, Streams(3, "", CHIP, "").chip_key("prnu"))
    good = planes["bad"] == 0
    [flat, *_] = [job for job in calibration.jobs if job.pointing.type == "FLAT"]
    level = np.median(calibrated_frame(calibration, flat)[1].electrons)
    left = (planes["flat"] / true)[good]
    assert left.std() < 1.15 / np.sqrt(4 * level) < 0.5 * true.std()
    assert meta["dark [e-/s]"] == pytest.approx(detector.dark, abs=0.005)
    assert all(abs(offset) < 0.5 for offset in meta["offset"].values())  # e-; medians of 1024 px of noise 5 / sqrt(3)


def test_defects_are_found(calibration):
    """All dead pixels and columns; of the hot ones those above five sigma of the noise."""
    planes, _ = load_frame(calibration.paths.masters(CHIP))
    [job, *_] = [job for job in calibration.jobs if job.pointing.type == "FLAT"]
    layer = calibration.steps["FLAT"].step("detector_defects")
    true = known_defects(
        job.chip, job.window, layer.param.model_copy(update={"hot_pixels": False}),
        Streams(3, job.obsid, CHIP, "measure"),
    )  # fmt: skip
    assert true.any() and (planes["bad"][true] > 0).mean() > 0.95
    everything = known_defects(job.chip, job.window, layer.param, Streams(3, job.obsid, CHIP, "measure"))
    assert (planes["bad"][~everything] > 0).mean() < 2e-3  # 5 sigma, blooming beside bright columns


@pytest.mark.parametrize("kind", ["truth", "frames"])
def test_calibrated_product(calibration, science, kind):
    """Stars lie where the WCS says within 0.1 px and have the light of their PSF, in e-/s, within 1%."""
    how = {"calibration": kind} | ({"masters": str(calibration.paths.output)} if kind == "frames" else {})
    campaign = changed(science, **how)
    job = campaign.jobs[0]
    done("calibrate", campaign.file, "--obsid", job.obsid, "--chip", CHIP)
    truth = read_truth(campaign.paths.level0_truth(job))
    with fits.open(campaign.paths.calibrated(*job.key), checksum=True) as file:
        assert [hdu.name for hdu in file] == ["PRIMARY", "SCI", "ERR", "DQ"]
        image, error, quality = (hdu.data for hdu in file[1:])
        assert image.shape == error.shape == quality.shape == job.window.shape
        assert file["SCI"].header["BUNIT"] == "electron/s" and kind in str(file[0].header["HISTORY"])
        wcs = WCS(file["SCI"].header)
    rows, columns = np.indices(image.shape)
    positions = zip(truth["x"] - job.window.x0, truth["y"] - job.window.y0, strict=True)
    near = np.min([np.hypot(columns - x, rows - y) for x, y in positions], axis=0)
    sky = image[(quality == 0) & (near > 15.0)]
    scatter = 1.4826 * np.median(abs(sky - np.median(sky)))  # 4 sigma
    assert abs(np.median(sky)) < 0.02
    assert np.median(error) == pytest.approx(scatter, rel=4 * 1.17 / np.sqrt(sky.size)), (scatter, sky.size)
    ra, dec = icrs(*job.wcs.pixel_to_world(truth["x"], truth["y"]), job.observer)
    x, y = wcs.world_to_pixel_values(ra, dec)
    assert np.hypot(x - truth["x"], y - truth["y"]).max() < 0.1
    psf = open_psf(campaign, job.chip)
    for row in range(len(truth)):
        column, line = round(float(x[row])), round(float(y[row]))
        light = image[line - HALF : line + HALF + 1, column - HALF : column + HALF + 1].sum()
        cells = psf.at(x[row], y[row]).mean(axis=0)
        middle, reach = len(cells) // 2, round((HALF + 0.5) * psf.oversampling)
        inside = cells[middle - reach : middle + reach, middle - reach : middle + reach].sum()
        assert light * job.pointing.exptime == pytest.approx(inside * truth["electrons"][row], rel=0.01)


def test_what_cannot_be_calibrated_is_refused(calibration, science, tmp_path):
    job = OpenCampaign(science).jobs[0]
    with_masters = {"calibration": "frames", "masters": str(tmp_path)}
    path = science.with_name("refused.yaml")
    (science.parent / "out" / OWNER_FILE).unlink(missing_ok=True)
    for measurement, said in (
        (with_masters, "masters/chip_09.fits"), ({"calibration": "frames"}, "masters must be given with"),
        ({"cti_passes": -1}, "cti_passes"), ({"masters": str(tmp_path)}, "masters must be given with"),
    ):  # fmt: skip
        path.write_text(yaml.safe_dump(yaml.safe_load(science.read_text()) | {"measurement": measurement}))
        result = command("measure", path, "--obsid", job.obsid, "--chip", CHIP)
        assert result.exit_code == 2 and said in result.output and "Traceback" not in result.output
    other = yaml.safe_load(science.read_text()) | {"seed": 4, "measurement": with_masters}
    (tmp_path / "masters").mkdir()
    (tmp_path / "masters" / "chip_09.fits").write_bytes(calibration.paths.masters(CHIP).read_bytes())
    path.write_text(yaml.safe_dump(other))
    campaign = OpenCampaign(path)
    done("chip", path, "--obsid", job.obsid, "--chip", CHIP, "--output", tmp_path / "out")
    campaign = OpenCampaign(path, tmp_path / "out")
    path.write_text(yaml.safe_dump(other | {"output": str(campaign.paths.output)}))
    result = command("measure", path, "--obsid", job.obsid, "--chip", CHIP)
    assert result.exit_code == 2 and "seed" in result.output
    result = command("masters", science, "--chip", CHIP)
    assert result.exit_code == 2 and "3 of each BIAS, DARK, FLAT" in result.output
    first = calibration.jobs[0].obsid
    result = command("calibrate", calibration.file, "--obsid", first, "--chip", CHIP)
    assert result.exit_code == 2 and "BIAS" in result.output
