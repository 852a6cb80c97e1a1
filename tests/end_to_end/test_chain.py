"""Whole chips through the commands: position and amount of light, and contents of the files."""

import subprocess
from pathlib import Path

import numpy as np
import pytest
import sep
import yaml
from astropy import units as u
from astropy.io import fits
from astropy.wcs import WCS
from support.commands import done
from support.mini_campaign import spectrum, write_campaign, write_scene
from support.readout_state import plain_list
from synphot import Empirical1D, Observation, SourceSpectrum, SpectralElement
from synphot.units import PHOTLAM

from csstsim.base.shipped import SHIPPED
from csstsim.campaign.opened import OpenCampaign
from csstsim.catalog.table import ObjectTable
from csstsim.instrument.camera import load_camera
from csstsim.instrument.filter import GRID
from csstsim.io.frames import load_frame
from csstsim.io.level0 import read_level0
from csstsim.io.truth import read_truth
from csstsim.measure.calibration.calibrate import Electronics, calibrate
from csstsim.stages.psf import open_psf

BANDS = {"NUV": 12, "u": 14, "g": 8, "r": 9, "i": 7, "z": 11, "y": 6}
CENTROID_PX = 0.02
FLUX = 1e-3  # relative


def star_campaign(folder, chip, layout, pa, distorted=True):
    """Nine isolated stars on one chip, near pixel corners so that none saturates; 2.8e5 electrons each."""
    pointing = f"10100000001,SCIE,60.0,-40.0,{pa},2027-11-20T01:08:00,150"
    names = ["sky_background", "poisson_and_dark", "prescan_overscan", "bias", "readout_noise", "gain"]
    layers = [{"scie_obs": {"field_dist": distorted}}, *({name: {}} for name in names)]
    layers.append({"quantization_and_output": {"layout": layout, "sip": True}})
    (folder / "science.yaml").write_text(str({"layers": layers}))
    rng = np.random.default_rng(chip)
    x, y = (v.ravel() + 0.5 + rng.uniform(-0.2, 0.2, 9) for v in np.meshgrid([20, 63, 106], [20, 63, 106]))
    camera = load_camera(SHIPPED / "instrument")
    mag = camera.filters[camera.chips[chip].filter].zeropoint(camera.telescope) - 2.5 * np.log10(2.8e5 / 150)
    observations = {"SCIE": str(folder / "science.yaml")}
    return OpenCampaign(write_scene(folder, "Stars", x, y, mag, chip, pointing, observations=observations))


WAYS = ("channels", -113.4333, False), ("mosaic", 20.0, True)


@pytest.mark.parametrize(
    "band, layout, pa, distorted",
    [pytest.param(band, *way, marks=[pytest.mark.slow] if (i + j) % 2 else [], id=f"{band}-{way[0]}")
     for i, band in enumerate(BANDS) for j, way in enumerate(WAYS)],
)  # fmt: skip
def test_bright_stars_stand_where_the_truth_and_the_header_say(tmp_path, band, layout, pa, distorted):
    """S/N > 500: the windowed centroid (sigma 1.5 px) is within 0.02 px of the truth; every band, the layouts in turn.

    The header is the linear one without field distortion, and with it the SIP one.
    """
    chip = BANDS[band]
    campaign = star_campaign(tmp_path, chip, layout, pa, distorted)
    done("chip", campaign.file, "--obsid", "10100000001", "--chip", chip)
    job = campaign.job("10100000001", chip)
    file = read_level0(campaign.paths.level0(job), verify=True)
    assert file.layout == layout
    assert file.header0["FLDDIST"] is distorted and file.header["CTYPE1"] == "RA---TAN" + "-SIP" * distorted
    head = file.header0
    assert (
        all(0 < head[f"{name}{end}"] < 180 for name in ("SUNANGL", "MOONANG") for end in (0, 1)) and "LIMBANG1" in head
    )
    assert head["SUNANGL0"] != head["SUNANGL1"] and head["SATESWV"] == file.header["DETSN"] == "not simulated"
    assert ("CRPIX1A" in file.header) is not distorted  # readers would apply SIP to the channels' WCS, too
    truth = read_truth(campaign.paths.level0_truth(job))
    image = calibrate(file.frame(), file.readout, Electronics(file.gain))
    assert not image.saturated.any()
    electrons = (image.electrons - np.median(image.electrons)).astype(float)
    x, y, _ = sep.winpos(electrons, truth["x"], truth["y"], np.full(9, 1.5), subpix=0)
    noise = np.sqrt(truth["drawn"] + 100 * electrons[:8, :8].var())
    assert (truth["drawn"] / noise).min() > 500
    assert np.hypot(x - truth["x"], y - truth["y"]).max() < CENTROID_PX
    # An independent reader of the header: the apparent sky position through astropy.
    sky = WCS(fits.getheader(file.path, "IMAGE"), key=" ")
    px, py = sky.all_world2pix(truth["ra"], truth["dec"], 0)
    assert np.hypot(x - px, y - py).max() < CENTROID_PX


def test_electrons_are_the_synthetic_photometry_times_the_enclosed_light(tmp_path):
    """Three spectra: drawn electrons against synphot's count rate and the PSF's own sum; no light beyond its box."""
    layers = plain_list("science")
    layers[0]["scie_obs"] |= {"wings": False, "ghosts": False}
    (tmp_path / "science.yaml").write_text(yaml.safe_dump({"layers": layers}))
    observations = {"SCIE": str(tmp_path / "science.yaml")}
    path = write_scene(tmp_path, "Spectra", [64.2, 64.0, 63.7], [64.0, 64.4, 63.5], 0.0, observations=observations)
    for stage in ("psf", "select", "render"):
        done(stage, path, *(["--obsid", "10100000001"] if stage != "psf" else []), "--chip", 9)
    campaign = OpenCampaign(path)
    job = campaign.job("10100000001", 9)
    drawn = ObjectTable.read(campaign.paths.stage("10100000001", 9, "drawn.parquet"))
    psf = open_psf(campaign, job.chip)
    filter_ = campaign.camera.filters["r"]
    band = SpectralElement(Empirical1D, points=filter_.wavelength, lookup_table=filter_.throughput)
    area = campaign.camera.telescope.area_m2 * u.m**2
    for i in range(3):
        source = SourceSpectrum(Empirical1D, points=GRID, lookup_table=(spectrum(i) * 1e-4) * PHOTLAM)
        rate = Observation(source, band, binset=GRID).countrate(area=area, binned=False).value
        share = np.array([drawn[f"flux{k}"][i] for k in range(4)])
        table = psf.at(drawn["x"][i], drawn["y"][i]).sum(axis=(1, 2))
        assert drawn["electrons"][i] == pytest.approx(rate * 150, rel=FLUX)
        assert drawn["drawn"][i] == pytest.approx(rate * 150 * (share @ table / share.sum()), rel=FLUX)


def test_every_level0_file_passes_fitsverify(tmp_path):
    try:
        subprocess.run(["fitsverify"], capture_output=True, check=False)
    except FileNotFoundError:
        pytest.skip("fitsverify is not installed (Debian package fitsverify)")
    path = write_campaign(tmp_path, select={"chips": [9]})
    for obsid in ("10100000001", "10300000001"):
        done("chip", path, "--obsid", obsid, "--chip", 9)
    files = list((tmp_path / "out" / "level0").rglob("*.fits"))
    assert len(files) == 2
    for file in files:
        report = subprocess.run(["fitsverify", "-q", str(file)], capture_output=True, text=True, check=False)
        assert report.returncode == 0 and "OK" in report.stdout, report.stdout


def test_stages_by_file_equal_the_chip_in_memory(tmp_path):
    """select, render, readout, level0 one by one give the pixels and the truth that `chip` gives."""
    path = write_campaign(tmp_path)
    campaign = OpenCampaign(path)
    job = campaign.job("10100000001", 9)
    done("chip", path, "--obsid", "10100000001", "--chip", 9, "--output", tmp_path / "memory")
    (tmp_path / "out").mkdir()
    for folder in ("truth", "psf"):
        (tmp_path / "memory" / folder).rename(tmp_path / "out" / folder)
    for stage in ("select", "render", "readout", "level0"):
        done(stage, path, "--obsid", "10100000001", "--chip", 9)
    here = campaign.paths.level0(job)
    there = tmp_path / "memory" / here.relative_to(tmp_path / "out")
    assert np.array_equal(fits.getdata(here), fits.getdata(there))
    ours, theirs = (read_truth(Path(p).with_suffix(".truth.parquet")) for p in (here, there))
    for name in ours.names:
        if name != "ms":
            assert ours[name].tobytes() == theirs[name].tobytes() or (ours[name] == theirs[name]).all(), name


def test_truth_adds_up_to_the_image(tmp_path):
    """Electrons said to be drawn are those in the plane, before the sky, to 1e-6."""
    names = "scie_obs", "poisson_and_dark", "prescan_overscan", "gain", "quantization_and_output"
    layers = [{name: {}} for name in names]
    (tmp_path / "science.yaml").write_text(str({"layers": layers}))
    path = write_campaign(tmp_path, observations={"SCIE": str(tmp_path / "science.yaml")})
    campaign = OpenCampaign(path)
    for pix in campaign.truth_bricks(campaign.job("10100000001", 9)):
        done("truth", path, "--brick", pix)
    done("psf", path, "--chip", 9)
    for stage in ("select", "render"):
        done(stage, path, "--obsid", "10100000001", "--chip", 9)
    paths = campaign.paths
    planes, _ = load_frame(paths.stage("10100000001", 9, "render.fits"))
    drawn = ObjectTable.read(paths.stage("10100000001", 9, "drawn.parquet"))
    assert len(drawn) > 3 and (drawn["drawn"] > 0).any()
    assert set(drawn["method"]) <= {"photons", "stamp"}
    light = sum(plane.sum(dtype=float) for plane in planes.values())
    assert light == pytest.approx(drawn["drawn"].sum(), rel=1e-6)


def test_a_catalogue_of_ones_own_is_what_was_drawn(tmp_path):
    campaign = star_campaign(tmp_path, 9, "channels", 0.0)
    done("chip", campaign.file, "--obsid", "10100000001", "--chip", 9)
    truth = read_truth(campaign.paths.level0_truth(campaign.job("10100000001", 9)))
    assert len(truth) == 9 and (truth["obj_type"] == 0).all()


def test_a_window_keeps_the_geometry_of_the_full_chip(tmp_path):
    """Same star, channels and sky position; a file of full size, 0 DN where nothing was read."""
    window = {"x0": 50, "x1": 90, "y0": 40, "y1": 80}
    files = []
    for name, changes in (("full", {}), ("window", {"window": window})):
        (tmp_path / name).mkdir()
        path = write_scene(tmp_path / name, "Stars", [70.3, 20.0], [60.4, 20.0], mag=17.5, **changes)
        done("chip", path, "--obsid", "10100000001", "--chip", 9)
        campaign = OpenCampaign(path)
        files.append(read_level0(campaign.paths.level0(campaign.job("10100000001", 9)), verify=True))
        truth = read_truth(campaign.paths.level0_truth(campaign.job("10100000001", 9)))
    full, part = files
    assert full.readout.stored_shape("channels") == part.readout.stored_shape("channels")
    assert [full.header[k] for k in ("CRPIX1", "CRPIX2", "CD1_1", "GAIN03")] == [
        part.header[k] for k in ("CRPIX1", "CRPIX2", "CD1_1", "GAIN03")
    ]
    image = part.assembled(full=True)
    inside = np.zeros(image.shape, bool)
    inside[40:80, 50:90] = True
    assert not image[~inside].any() and image[inside].all()
    assert np.unravel_index(image.argmax(), image.shape) == (60, 70)
    assert len(truth) == 2 and truth["x"][0] == pytest.approx(70.3, abs=1e-6)
    assert truth["fraction"][1] < 0.01 < truth["fraction"][0]  # the far star's wings only
    # within the window, both files hold the same scene: they differ by noise alone
    a, b = (f.assembled(full=True)[40:80, 50:90].astype(float) for f in files)
    noise = np.sqrt(2 * (a - np.median(a)).clip(0) / 1.1 + 2 * (a[:5, :5].var() + 1))
    assert np.abs((a - b) / noise).max() < 6
