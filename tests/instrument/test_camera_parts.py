"""Which stages a changed number of the camera makes out of date, and what the files may hold."""

import shutil

import pytest
from support.mini import INSTRUMENT

from csstsim.base.errors import InputError
from csstsim.instrument.camera import load_camera
from csstsim.instrument.load import data_files
from csstsim.instrument.traps import Traps, load_traps

STAGES = "truth", "psf", "select", "render", "readout", "level0", "measure", "validate"
FROM_RENDER, FROM_READOUT = STAGES[3:], STAGES[4:]
CHANGES = {  # number: (value, stages whose products change with it)
    "detector.pixel_um": (9.9, STAGES[1:]),
    "detector.dark": (0.03, STAGES[2:]),
    "detector.read_noise": (6, STAGES[2:]),
    "detector.full_well": (8e4, FROM_RENDER),
    "detector.prnu": (0.012, FROM_RENDER),
    "detector.gain": (1.5, FROM_READOUT),
    "detector.gain_spread": (0.05, FROM_READOUT),
    "detector.bias": (600, FROM_READOUT),
    "detector.overscan": (81, FROM_READOUT),
    "detector.prescan": (28, FROM_READOUT),
    "detector.bloom_row_share": (0.02, FROM_READOUT),
    "detector.nonlinearity_quadratic": (1e-7, FROM_READOUT),
    "detector.readout_time": (41, FROM_READOUT),
    "detector.adc_max": (60000, STAGES[5:]),
    "detector.temperature": (190, STAGES[5:]),
    "telescope.diameter_m": (1.9, STAGES),
    "telescope.pixel_scale": (0.075, STAGES[1:]),
    "telescope.focal_length_m": (27.9, STAGES[1:]),
    "telescope.shutter_time": (1.4, FROM_RENDER),
    "telescope.sun_angle_min": (45, ()),
    "telescope.altitude_km": (410, STAGES[2:]),
    "filters.r.sky": (0.3, STAGES[2:]),
    "filters.r.limiting_mag": (27, ("validate",)),
    "filters.r.saturation_mag": (18, ("validate",)),
    "cti.well.beta": (0.6, FROM_READOUT),
    "cosmic_rays.rate": (1e-5, FROM_READOUT),
    "defects.defective": (0.002, FROM_READOUT),
    "psf.jitter": (0.02, STAGES[1:]),
    "leds.flat.pattern_rms": (0.02, FROM_RENDER),
    "gratings.chips.29.split": (4000, STAGES[2:]),
    "ghosts.geometry.gap": (60, STAGES[1:]),
}


@pytest.mark.parametrize("name", CHANGES)
def test_a_change_reaches_the_stages_that_read_it_and_those_behind(camera, name):
    """PSFs are behind render and measure, not behind select; measurements read PSFs and frames."""
    value, stages = CHANGES[name]
    changed = load_camera({name: value})
    differ = [stage for stage in STAGES if camera.digest_for(stage) != changed.digest_for(stage)]
    assert differ == list(stages)


def test_a_layer_may_read_what_its_stage_does_not(camera):
    changed = load_camera({"detector.adc_max": 60000})
    assert changed.digest_for("readout") == camera.digest_for("readout")
    assert changed.digest_for("readout", "level0") != camera.digest_for("readout", "level0")
    assert len(camera.digest_for("truth")) == 16


REFUSED = {
    "cosmic_rays.long_max": 1.0,  # below short_max
    "cosmic_rays.rate": 2e-3,
    "cosmic_rays.long_share": 1.1,
    "cosmic_rays.marked_from": 0,
    "defects.columns_max": 0,
    "defects.columns_to": 0.001,
    "defects.length_max": 0.0001,
    "defects.high_factor": 0.0,
    "defects.high_offset": 0.0,
    "defects.defective": 0.2,
    "defects.column_noise": 0.5,
    "defects.hot_time": 0,
    "detector.prnu": 0.3,
    "detector.gain_spread": 0.6,
    "detector.bloom_row_share": 1.5,
    "detector.adc_max": 65536,
    "detector.temperature": 401,
    "detector.full_well": 0,
    "detector.nonlinearity_spread": 2,
    "telescope.shutter_time": -1,
    "telescope.shutter_span_mm": 0,
    "telescope.diameter_m": 0.05,
    "cti.well.beta": 0.001,
    "cti.well.notch": -1,
}


@pytest.mark.parametrize("name", REFUSED)
def test_numbers_out_of_range_are_refused_by_name(name):
    with pytest.raises(InputError, match=name.rpartition(".")[2]):
        load_camera({name: REFUSED[name]})


def test_traps_have_the_numbers_of_their_own_register():
    well = {"beta": 0.5, "full_well": 9e4, "notch": 30.0}
    data = {"well": well, "species": {"density": [1.0, 2.0], "timescale": [3.0, 40.0]}}
    alone = load_traps(data, "cti.yaml")
    assert alone == Traps(0.5, 9e4, 30.0, (1.0, 2.0), (3.0, 40.0), None)
    serial = {
        "well": {"beta": 0.7, "full_well": 1e5, "notch": 0.0}, "species": {"density": [0.1], "timescale": [5.0]},
    }  # fmt: skip
    both = load_traps(data | {"serial": serial}, "cti.yaml")
    assert both == Traps(0.5, 9e4, 30.0, (1.0, 2.0), (3.0, 40.0), Traps(0.7, 1e5, 0.0, (0.1,), (5.0,)))
    for species, words in (
        ({"density": [1.0, 2.0], "timescale": [3.0]}, "same length"),
        ({"density": [0.0], "timescale": [3.0]}, "density"),
        ({"density": [1.0], "timescale": [-3.0]}, "timescale"),
    ):  # fmt: skip
        with pytest.raises(InputError, match=rf"cti.yaml: .*{words}"):
            load_traps({"well": well, "species": species}, "cti.yaml")
    with pytest.raises(InputError, match=r"cti.yaml: serial.well.beta"):
        load_traps(data | {"serial": serial | {"well": well | {"beta": 9}}}, "cti.yaml")


FILES = {  # data file: the stages whose products change with any change of it
    "brighter_fatter.yaml": FROM_READOUT,
    "chips.yaml": STAGES[1:],
    "cosmic_rays.yaml": FROM_READOUT,
    "cti.yaml": FROM_READOUT,
    "defects.yaml": FROM_READOUT,
    "distortion.fits": STAGES[2:],
    "distortion.yaml": ("psf", *FROM_RENDER),
    "ghosts.yaml": STAGES[1:],
    "gratings.yaml": STAGES[2:],
    "gratings/GV1.conf": STAGES[2:],
    "gratings/GV_p1.fits": STAGES[2:],
    "leds.yaml": FROM_RENDER,
    "level0_keywords.yaml": STAGES[5:],
    "psf.yaml": STAGES[1:],
    "scatter.yaml": STAGES[1:],
    "sky.yaml": FROM_RENDER,
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return shutil.copytree(INSTRUMENT, tmp_path_factory.mktemp("camera") / "instrument")


@pytest.mark.parametrize("name", FILES)
def test_a_changed_file_reaches_the_stages_that_read_it_and_those_behind(camera, folder, name):
    content = (folder / name).read_bytes()
    try:
        (folder / name).write_bytes(content + b"\n")
        changed = load_camera(folder)
        assert [stage for stage in STAGES if camera.digest_for(stage) != changed.digest_for(stage)] == list(FILES[name])
    finally:
        (folder / name).write_bytes(content)


def test_each_file_of_the_camera_has_its_line_here():
    """Of gratings one of a kind; files whose parameters are parts are in CHANGES."""
    parts = {"detector.yaml", "filters.yaml", "telescope.yaml"}
    names = {path.relative_to(INSTRUMENT).as_posix() for path in data_files(INSTRUMENT).values()}
    assert names - parts - set(FILES) == {name for name in names if name.startswith("gratings/")} - set(FILES)
