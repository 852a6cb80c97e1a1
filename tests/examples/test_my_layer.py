"""The worked example of a user's own layer: short, valid, and its light in the file follows its formula."""

import importlib
import sys

import numpy as np
import pytest
import yaml
from support.commands import done
from support.mini_campaign import write_scene

from csstsim.base.rng import Streams
from csstsim.base.shipped import SHIPPED
from csstsim.campaign.opened import OpenCampaign
from csstsim.io.level0 import read_level0
from csstsim.simulation.layer_contract import check_layer

EXAMPLE = SHIPPED.parent / "examples" / "my_layer"
SCIENCE = SHIPPED / "observations" / "science.yaml"
OBSID, CHIP, SIDE = "10100000001", 9, 128


@pytest.fixture(autouse=True)
def importable(monkeypatch):
    monkeypatch.syspath_prepend(EXAMPLE)
    yield
    for name in ("mylab", "mylab.glint"):
        sys.modules.pop(name, None)


def test_layer_docstring_and_test_are_under_forty_lines():
    files = EXAMPLE / "mylab" / "glint.py", EXAMPLE / "test_glint.py"
    assert sum(len(file.read_text().splitlines()) for file in files) < 40
    assert importlib.import_module("mylab.glint").__doc__


def test_it_keeps_the_contract():
    assert check_layer("mylab.glint") == ()


def test_its_list_is_the_shipped_one_with_a_layer_more():
    lists = [yaml.safe_load(path.read_text())["layers"] for path in (EXAMPLE / "science.yaml", SCIENCE)]
    ours, shipped = ([next(iter(entry)) for entry in layers] for layers in lists)
    ours.remove("mylab.glint")
    assert ours == shipped


def electrons(folder, layers):
    """Return the active pixels [e-, bias and all] of the Level-0 file that a list of layers makes."""
    folder.mkdir()
    (folder / "list.yaml").write_text(yaml.safe_dump({"layers": layers}))
    campaign = write_scene(folder, "Stars", [40.0], [50.0], 22.0, observations={"SCIE": str(folder / "list.yaml")})
    done("chip", campaign, "--obsid", OBSID, "--chip", CHIP)
    run = OpenCampaign(campaign)
    image = np.zeros((SIDE, SIDE))
    for channel in read_level0(run.paths.level0(run.job(OBSID, CHIP))).channels():
        image[channel.window.slices] = channel.gain * channel.active.astype(float)
    return image, run


def test_its_light_is_in_the_file(tmp_path):
    """A star of that magnitude seen for pixel_scale / speed in each pixel of its path, within 0.5%; none beside it.

    The amplifiers' nonlinearity takes 0.2%; shot noise is 0.05%. Bad columns, which have levels of their own, are off.
    """
    layers = yaml.safe_load((EXAMPLE / "science.yaml").read_text())["layers"]
    layers.remove({"detector_defects": {}})
    image, run = electrons(tmp_path / "with", layers)
    trail = image - electrons(tmp_path / "without", [entry for entry in layers if "mylab.glint" not in entry])[0]
    camera = run.camera
    x0, y0, angle = Streams(3, OBSID, CHIP, "mylab.glint").exposure("path").uniform(0, (SIDE, SIDE, np.pi))
    steps = np.arange(-2 * SIDE, 2 * SIDE, 0.01)
    x, y = x0 + steps * np.cos(angle), y0 + steps * np.sin(angle)
    length = 0.01 * ((np.abs(x - 63.5) < 64) & (np.abs(y - 63.5) < 64)).sum()
    rate = 10 ** (0.4 * (camera.filters["r"].zeropoint(camera.telescope) - 4.0))
    assert trail.sum() == pytest.approx(rate * length * camera.telescope.pixel_scale / 1800.0, rel=0.005)
    row, column = np.indices(trail.shape)
    far = np.abs((column - x0) * np.sin(angle) - (row - y0) * np.cos(angle)) > 12
    assert far.sum() > 5000 and abs(trail[far].mean()) < 0.5
