"""Single numbers of the camera, changed by name from a campaign or from Python."""

import numpy as np
import pytest
from support.mini_campaign import write_campaign

import csstsim
from csstsim.base.errors import InputError
from csstsim.campaign.opened import OpenCampaign
from csstsim.instrument.camera import load_camera
from csstsim.instrument.files import InstrumentFiles


@pytest.mark.parametrize(
    ("name", "value", "of"),
    [
        ("detector.read_noise", 20, lambda c: c.detector.read_noise),
        ("detector.charge.read_noise", 20.0, lambda c: c.detector.read_noise),
        ("telescope.diameter_m", 1.5, lambda c: c.telescope.diameter_m),
        ("filters.r.sky", 0.3, lambda c: c.filters["r"].sky),
        ("cti.well.beta", 0.6, lambda c: c.detector.traps.beta),
        ("gratings.chips.29.split", 4000, lambda c: c.gratings[29].split),
    ],
)
def test_a_number_changes_and_nothing_else(camera, name, value, of):
    changed = load_camera({name: value})
    assert of(changed) == value != of(camera)
    assert changed.digest != camera.digest and not changed.shipped and camera.shipped
    differ = {part for part in camera.files.parts if camera.files.parts[part] != changed.files.parts[part]}
    assert len(differ) == 1, "one part of the recipe"
    (full,) = changed.files.changes
    assert load_camera({full: value}).digest == changed.digest
    assert load_camera().digest == camera.digest, "the files themselves stay"


def test_names_may_be_nested_and_go_with_a_folder(camera):
    nested = InstrumentFiles({"folder": camera.folder, "detector": {"read_noise": 20, "gain": 1.3}})
    assert nested.changes == {"detector.charge.read_noise": 20, "detector.charge.gain": 1.3}


def test_numbers_as_yaml_and_numpy_have_them():
    """YAML 1.1 takes 1e-3 for a word."""
    given = InstrumentFiles({"detector": {"read_noise": "5e0", "gain": np.float32(1.5), "dark": np.int64(2)}}).changes
    assert given == {"detector.charge.read_noise": 5.0, "detector.charge.gain": 1.5, "detector.charge.dark": 2}
    assert all(type(value) in (int, float) for value in given.values())


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"detector.readnoise": 3}, "no such parameter of the camera.*detector.charge.read_noise"),
        ({"read_noise": 3}, "allowed: detector.charge.read_noise"),
        ({"detektor.gain": 3}, "allowed: detector.charge.gain"),
        ({"filters.sky": 3}, "several parameters have this name.*filters.r.sky"),
        ({"detector.gain": "much"}, "must be a number"),
        ({"detector.gain": "5"}, "must be a number .got '5'"),
        ({"detector.gain": True}, "must be a number"),
        ({"detector.gain": float("nan")}, "must be a number"),
        ({"detector.gain": -1}, "greater than or equal to 0.01.*`instrument` has detector.charge.gain: -1"),
        ({"detector.nx": 9216.5}, "detector.geometry.nx: 9216.5"),
        ({"chips.xc": 3}, "no such parameter"),
        ({"detector": {"gain": 1.2}, "detector.charge.gain": 1.3}, "the parameter is given twice"),
        ({"xyzzy": 3}, "allowed: detector.NAME"),
        ({"folder": "/nowhere", "detector.gain": 2}, "no such instrument folder"),
    ],
)
def test_what_cannot_be_changed_says_what_can(given, message):
    with pytest.raises(InputError, match=f"(?s){message}"):
        load_camera(given)


def test_a_changed_noise_is_in_the_pixels_the_header_and_the_recipe_of_what_reads_it(tmp_path):
    """Read noise of 20 e- instead of 5: the variance of 16,384 pixels is right to 1% (one sigma)."""
    bias = "10300000001,BIAS,0,0,0,2027-11-20T02:00:00,0"
    file = write_campaign(tmp_path, [bias], select={"types": ["BIAS"], "chips": [9]})
    plain = csstsim.Simulation(file, cache=tmp_path / "cache")
    loud = plain.replace(instrument={"folder": OpenCampaign(file).camera.folder, "detector.read_noise": 20})
    scatter = [np.std(sim.chip("10300000001", 9).electrons) for sim in (plain, loud)]
    assert abs(scatter[1] ** 2 - scatter[0] ** 2 - (20**2 - 5**2)) < 5 * 0.011 * 20**2
    frame = loud.chip("10300000001", 9)
    assert any("camera detector.charge.read_noise = 20" in str(line) for line in frame.header.get("HISTORY", []))
