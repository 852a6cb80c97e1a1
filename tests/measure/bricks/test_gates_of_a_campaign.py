"""A sound campaign passes its gates; one with a fault in its chain fails the gate of that fault."""

import io
import json
from contextlib import nullcontext

import numpy as np
import pytest
import yaml
from PIL import Image
from support.commands import done
from support.faulty_chain import FAULTS
from support.mini_campaign import write_scene

from csstsim.campaign.opened import OpenCampaign
from csstsim.io.level0 import Level0
from csstsim.optics.geometry.wcs import ChipWCS

SECOND = "10100000002"
SIDE, STEP, MAG = 384, 62, 21.5  # px; S/N 130


def stars(folder, read_noise=5.0, again=()):
    """Write a campaign of 36 stars on an r chip with this read noise; make its frames; return the campaign's file.

    again: more exposures of the same place, (obsid, start).
    """
    x, y = (v.ravel() for v in np.meshgrid(np.arange(36, SIDE, STEP), np.arange(36, SIDE, STEP)))
    side = SIDE // 8, SIDE // 2
    geometry = {"nx": SIDE, "ny": SIDE, "channel_nx": side[0], "channel_ny": side[1]}
    shift = np.random.default_rng(4).uniform(-0.5, 0.5, (2, x.size))  # of the star in its pixel
    file = write_scene(folder, "Stars", x + shift[0], y + shift[1], MAG, geometry=geometry)
    with (folder / "table.csv").open("a") as table:
        table.writelines(f"{obsid},SCIE,60.15,-40.0,-113.4333,{start},150\n" for obsid, start in again)
    path = OpenCampaign(file).camera.folder / "detector.yaml"
    numbers = yaml.safe_load(path.read_text())
    numbers["charge"]["read_noise"]["value"] = read_noise
    path.write_text(yaml.safe_dump(numbers))
    for job in OpenCampaign(file).jobs:
        done("chip", file, "--obsid", job.obsid, "--chip", job.chip.id)
    return file


@pytest.fixture(autouse=True)
def _without_pictures(monkeypatch):
    """Figures are drawn for people; two thirds of the time would go there."""
    picture = io.BytesIO()
    Image.new("L", (1, 1)).save(picture, "PNG")
    monkeypatch.setattr("csstsim.report.figures.png", lambda figure: picture.getvalue())


@pytest.fixture(scope="module")
def campaign(tmp_path_factory):
    return stars(tmp_path_factory.mktemp("gates"))


def verdict(file, second=nullcontext):
    """Measure again, exposure SECOND in a context, and validate; return {(gate, band)} that fail, and the counts."""
    run = OpenCampaign(file)
    for job in run.imaging_jobs:
        with second() if job.obsid == SECOND else nullcontext():
            done("measure", file, "--obsid", job.obsid, "--chip", job.chip.id)
    for pix in run.merge_bricks:
        done("merge", file, "--brick", pix)
        done("validate", file, "--brick", pix)
    output = done("report", file)
    found = json.loads((run.paths.report.with_name("verdict.json")).read_text())
    failing = {(gate["name"], gate["band"]) for gate in found["gates"] if gate["passed"] is False}
    assert all(name in output for name, _ in failing)
    return failing, found["counts"]


def test_without_a_fault_nothing_fails(campaign):
    failing, counts = verdict(campaign)
    assert failing == set() and counts["pass"] >= 5


def test_a_gain_wrong_by_5_percent(campaign, monkeypatch):
    right = Level0.gain.func
    monkeypatch.setattr(Level0, "gain", property(lambda file: {n: 1.05 * g for n, g in right(file).items()}))
    failing, _ = verdict(campaign)
    assert ("magnitude bias of stars", "r") in failing


def test_a_wcs_one_pixel_off(campaign, monkeypatch):
    right = ChipWCS.pixel_to_world
    monkeypatch.setattr(ChipWCS, "pixel_to_world", lambda wcs, x, y: right(wcs, np.asarray(x) + 1.0, y))
    failing, _ = verdict(campaign)
    assert ("position residual at S/N > 50 [mas]", "all") in failing


def test_a_chip_that_was_not_read(campaign, monkeypatch):
    right = Level0.frame
    monkeypatch.setattr(Level0, "frame", lambda file: np.full_like(right(file), 454))
    failing, _ = verdict(campaign)
    assert ("completeness", "r") in failing


def test_twice_the_noise(tmp_path):
    """7.7 electrons of sky and readout become 16."""
    failing, _ = verdict(stars(tmp_path, read_noise=15.0))
    assert ("depth beyond the published limits [mag]", "r") in failing


ONE_OF_TWO = (
    "noise doubled in one of two exposures", "header's WCS 0.3 px off", "GAIN of the header 2% wrong",
    "code's WCS 0.3 px off in one of four exposures",
)  # fmt: skip


@pytest.fixture(scope="module")
def twice(tmp_path_factory):
    return stars(tmp_path_factory.mktemp("twice"), again=[(SECOND, "2027-11-20T01:09:00")])


def test_two_exposures_without_a_fault(twice):
    failing, counts = verdict(twice)
    assert failing == set() and counts["pass"] >= 15


@pytest.mark.thorough
@pytest.mark.parametrize("fault", [fault for fault in FAULTS if fault.words in ONE_OF_TWO], ids=lambda f: f.words)
def test_one_of_two_exposures_is_wrong(twice, fault):
    run = OpenCampaign(twice)
    path = run.paths.level0(run.job(SECOND, 9))
    right = path.read_bytes()
    try:
        with fault.context() if fault.stage == "chip" else nullcontext():
            done("chip", twice, "--obsid", SECOND, "--chip", 9)
        failing, _ = verdict(twice, fault.context if fault.stage == "measure" else nullcontext)
    finally:
        path.write_bytes(right)
    assert (fault.gate, "r") in failing
