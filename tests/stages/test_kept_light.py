"""Kept light: another detector gives the same bits from it as from nothing; other light is refused."""

import shutil

import numpy as np
import pytest
import yaml
from support.mini_campaign import POINTINGS, write_scene

from csstsim.base.errors import InputError
from csstsim.campaign.opened import OpenCampaign
from csstsim.io.frames import load_frame, save_frame
from csstsim.io.level0 import read_level0
from csstsim.stages.chip import chip
from csstsim.stages.level0 import level0
from csstsim.stages.psf import psf
from csstsim.stages.readout import readout
from csstsim.stages.render import render
from csstsim.stages.select import select


@pytest.fixture(scope="module")
def kept(tmp_path_factory):
    """A campaign whose light is there, to its render stage."""
    file = write_scene(tmp_path_factory.mktemp("kept"), "Stars", [60.0], [60.0], 17.0, pointing=POINTINGS[0])
    run = OpenCampaign(file)
    psf(run, run.jobs[0].chip.id)
    for stage in (select, render):
        stage(run, run.jobs[0])
    return file


def with_detector(file, name, value):
    """Change a number of detector.yaml; return the campaign opened again, and its job."""
    path = OpenCampaign(file).camera.folder / "detector.yaml"
    data = yaml.safe_load(path.read_text())
    section = next(section for section in data.values() if name in section)
    section[name] = section[name] | {"value": value} if isinstance(section[name], dict) else value
    path.write_text(yaml.safe_dump(data))
    run = OpenCampaign(file)
    assert getattr(run.camera.detector, name) == value
    return run, run.jobs[0]


def test_another_detector_reads_the_kept_light_out(kept, tmp_path):
    run, job = with_detector(kept, "gain", 1.3)
    for stage in (readout, level0):
        stage(run, job)
    fresh = OpenCampaign(kept, tmp_path / "fresh", copied=True)
    shutil.copytree(run.paths.output / "psf", tmp_path / "fresh" / "psf")
    chip(fresh, job, lambda _: None)
    pixels = [read_level0(of.paths.level0(job)).frame() for of in (run, fresh)]
    assert np.array_equal(*pixels) and np.ptp(pixels[0]) > 1000


def test_light_of_another_full_well_is_refused(kept):
    """It says which objects of the truth saturate."""
    with pytest.raises(InputError, match=r"render\.fits: .*another campaign"):
        readout(*with_detector(kept, "full_well", 80000.0))


@pytest.mark.parametrize("rendered", [{}, {(0, 1): 7, (4, 5): -2}], ids=["dark", "two pixels"])
def test_a_plane_of_few_pixels_comes_back_whole(tmp_path, rendered):
    plane = np.zeros((5, 6), np.int32)
    for position, value in rendered.items():
        plane[position] = value
    save_frame(tmp_path / "frame.fits", {"counted": plane}, {"stage": "render"}, sparse=("counted",))
    planes, meta = load_frame(tmp_path / "frame.fits")
    assert np.array_equal(planes["counted"], plane) and planes["counted"].dtype == np.int32
    assert meta == {"stage": "render"}
    planes, meta = load_frame(tmp_path / "frame.fits", sparse=True)
    assert np.array_equal(planes["counted"].dense(), plane) and meta == {"stage": "render"}


@pytest.mark.parametrize("at", [[3, 99], [-1, 3], [4, 3], [3, 3]])
def test_parts_that_do_not_fit_their_plane_are_refused(tmp_path, at):
    at, values = np.array([at], np.int32), np.ones((1, 2), np.int32)
    save_frame(tmp_path / "frame.fits", {"counted_at": at, "counted_is": values}, {"sparse": {"counted": [5, 6]}})
    with pytest.raises(InputError, match="counted: damaged"):
        load_frame(tmp_path / "frame.fits")
