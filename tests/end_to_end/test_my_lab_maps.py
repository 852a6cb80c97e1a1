"""docs/lab_maps.md on the camera of examples/my_camera: its code writes a map, its YAML names it, frames have it."""

import re
import shutil
from contextlib import chdir

import numpy as np
import pytest
from astropy.io import fits
from astropy.table import Table
from click.testing import CliRunner
from matplotlib.image import imread
from support.lab_maps import map_path, name_maps, response, write_map
from support.mini_campaign import write_scene

import csstsim
from csstsim.base.shipped import ROOT
from csstsim.campaign.opened import OpenCampaign
from csstsim.command_line.main import main
from csstsim.detector.channels import ReadoutFrame
from csstsim.instrument.camera import load_camera
from csstsim.report.quicklook.picture import read_picture
from csstsim.stages.calibrate import calibrated_frame
from csstsim.stages.chip import chip, missing

pytestmark = pytest.mark.thorough

PAGE = ROOT / "docs" / "lab_maps.md"
SHAPE = 2064, 2048
OBSID = "30100000001"
WINDOW = 900, 1060, 1000, 1120  # x0, x1, y0, y1


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """The example with a map of chip 2's responses by the code of the page, and one of its bad pixels."""
    made = tmp_path_factory.mktemp("lab") / "my_camera"
    shutil.copytree(ROOT / "examples" / "my_camera", made)
    (made / "instrument" / "maps").mkdir()
    text = PAGE.read_text()
    yaml = re.search("```yaml\n(.*?)```", text, re.S)[1].splitlines()[0].replace("[2, 3]", "[2]")
    bad = 'bad_pixels: {files: "maps/bad_{chip}.fits", chips: [2], source: "darks", confidence: S}'
    (made / "instrument" / "maps.yaml").write_text(f"{yaml}\n{bad}\n")
    np.save(made / "response.npy", response(SHAPE, 6, 0.03))
    with chdir(made):
        exec(re.search("```python\n(.*?)```", text, re.S)[1])
    bits = np.zeros(SHAPE, np.uint8)
    bits[1010:1020, 950] = 16
    write_map(made / "instrument" / "maps" / "bad_02.fits", bits)
    return made


@pytest.fixture(scope="module")
def sim(folder, tmp_path_factory):
    """A window without objects: sky alone."""
    far = Table({"ra": [0.0], "dec": [80.0], "type": ["star"], "mag_green": [20.0]})
    made = csstsim.Simulation(folder / "campaign.yaml", cache=tmp_path_factory.mktemp("cache"))
    return made.replace(window=WINDOW, catalog=far, psf={"grid": 2}, fidelity="noise_free")


def test_the_command_checks_the_maps(folder):
    result = CliRunner().invoke(main, ["check", str(folder / "campaign.yaml")])
    assert result.exit_code == 0, result.output


def test_light_meets_the_map(sim):
    """With and without the layer, the ratio is the map in the window, to the rounding of float32."""
    with_it, without = sim.light(OBSID, 2), sim.replace(layers={"prnu_effect": None}).light(OBSID, 2)
    x0, x1, y0, y1 = WINDOW
    np.testing.assert_allclose(with_it.image / without.image, response(SHAPE, 6, 0.03)[y0:y1, x0:x1], rtol=3e-7)


def test_other_chips_keep_their_bits(sim, folder, tmp_path):
    """Chip 3 has no map: its frame is that of the camera without maps. That of chip 2 is another."""
    plain = shutil.copytree(folder, tmp_path / "plain")
    (plain / "instrument" / "maps.yaml").unlink()
    shutil.rmtree(plain / "instrument" / "maps")
    other = sim.replace(instrument=str(plain / "instrument"))
    same, differs = (np.array_equal(sim.chip(OBSID, n).image, other.chip(OBSID, n).image) for n in (3, 2))
    assert same and not differs


def test_the_file_says_which_maps_it_has(sim):
    frame = sim.chip(OBSID, 2)
    history = "".join(map(str, frame.header["HISTORY"]))
    assert "camera maps.prnu = prnu_02.fits, DATASUM" in history and "camera maps.bad_pixels = bad_02.fits" in history
    rms = response(SHAPE, 6, 0.03)[WINDOW[2] : WINDOW[3], WINDOW[0] : WINDOW[1]].std()
    assert frame.header["PRNURMS"] == pytest.approx(rms, rel=1e-5) and frame.header["NDEAD"] == 10
    assert frame.electrons[10:20, 50].mean() < np.median(frame.electrons) - 8  # e-: 13 of 21 are lost, error 2.6
    assert "maps." not in "".join(map(str, sim.chip(OBSID, 3).header["HISTORY"]))


@pytest.mark.parametrize("name", ["prnu_02", "bad_02"])
def test_show_draws_a_map_and_its_numbers(folder, tmp_path, name):
    file, png = folder / "instrument" / "maps" / f"{name}.fits", tmp_path / "map.png"
    result = CliRunner().invoke(main, ["show", str(file), "--output", str(png)], catch_exceptions=False)
    assert result.exit_code == 0, result.output
    assert np.ptp(imread(png)[..., 0]) > 0.5
    values = fits.getdata(file)
    said = f"mean {values.mean(dtype=float):.6g}, rms " if name == "prnu_02" else f"{np.count_nonzero(values)} of "
    assert read_picture(file).remark.startswith(said)


def test_what_measure_calibrates_has_neither_map(tmp_path):
    """From catalogue to electrons: of the bias structure and the responses nothing is left, within 5 sigma of noise."""
    file = write_scene(tmp_path, "Stars", [40.0], [50.0], mag=21.0)
    instrument = tmp_path / "instrument"
    shape = ReadoutFrame.of(load_camera(instrument).detector, None).stored_shape("mosaic")
    structure = np.random.default_rng(8).normal(0, 10, shape).astype(np.float32)
    values = {"prnu": response((128, 128), 9, 0.2), "bias": structure - structure.mean()}
    name_maps(instrument, *values, **{kind: {"chips": [9]} for kind in values})
    for kind, value in values.items():
        write_map(map_path(instrument, kind, 9), value)
    run = OpenCampaign(file)
    job = run.jobs[0]
    missing(run, job, lambda text: None)
    chip(run, job, log=lambda text: None)
    _, frame = calibrated_frame(run, job)
    there = ReadoutFrame.of(run.camera.detector, None)
    added = there.active(there.from_stored(values["bias"], "mosaic"))
    light = frame.electrons - run.camera.detector.dark * 150.0 / values["prnu"]  # dark current meets no response
    good = (frame.marks == 0) & (np.abs(light - np.median(light)) < 60)
    assert good.mean() > 0.9
    for pattern in (added, values["prnu"]):
        left = np.corrcoef(light[good], pattern[good])[0, 1]
        assert abs(left) < 5 / np.sqrt(good.sum())
