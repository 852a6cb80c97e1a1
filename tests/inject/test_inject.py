"""Injection into frames of csstsim: what a simulation with the objects gives; errors; the input untouched."""

import hashlib
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import yaml
from astropy.io import fits
from astropy.table import Table
from click.testing import CliRunner
from inject.others.test_foreign import wcs_cards, write_image, write_psf
from inject.scene import CHIP, OBSID, empty, mixed, objects, read_out_with, simulation

from csstsim import __version__
from csstsim.base.errors import InputError
from csstsim.base.rng import Streams
from csstsim.base.shipped import ROOT
from csstsim.campaign.opened import OpenCampaign
from csstsim.catalog.flags import SATURATED
from csstsim.catalog.table import ObjectTable
from csstsim.command_line.main import main
from csstsim.detector.channels import ReadoutFrame
from csstsim.detector.mask import SATURATED as FULL_WELL
from csstsim.detector.random.normal import normal_table
from csstsim.inject.frames import check_job, kind_of
from csstsim.inject.inject import inject as inject_into
from csstsim.inject.level0 import difference
from csstsim.inject.light import catalogue_of, light_of, table_of
from csstsim.inject.likely_charge import BIN, _sampled_charge, likely_charges
from csstsim.inject.memory import BaseFrame
from csstsim.inject.request import Request, realisations, record
from csstsim.inject.rewritten import rewrite
from csstsim.instrument.chip import Window
from csstsim.io.level0 import read_level0
from csstsim.simulation.state import State

LIGHT = 0.01  # sigma of a pixel: difference to a simulation before the detector
DENSE = 30.0  # times the traps of the paper: the window is a small chip
DETECTOR = 0.1  # sigma of a pixel: rms difference behind it, before the rounding to whole DN
ROUNDED = 1e-2  # DN: of float32
SIGMAS = 5.0


@pytest.fixture(scope="module")
def sim(tmp_path_factory):
    return simulation(tmp_path_factory.mktemp("inject"))


@pytest.fixture(scope="module")
def bare(sim):
    return empty(sim)


def noise_of(bare):
    return np.sqrt(bare.light(OBSID, CHIP).image + bare._run.camera.detector.read_noise**2)


def test_before_the_detector_it_is_what_a_simulation_draws(sim, bare):
    table = mixed(sim, 40)
    wanted, sky = sim.replace(catalog=table).light(OBSID, CHIP), bare.light(OBSID, CHIP)
    made = bare.inject(sky, table, realisation=0)
    assert set(made.truth["method"]) == {"photons", "stamp"}
    assert (np.abs(made.image - wanted.image) / noise_of(bare)).max() < LIGHT
    assert made.image.sum() - sky.image.sum() == pytest.approx(made.truth["drawn"].sum(), rel=1e-4)
    faint = table[table["mag_r"] > 22]  # photons alone: to the bit where the sky is in whole electrons
    one, other = (bare.inject(sky, faint, realisation=k).image - sky.image for k in (0, 1))
    assert np.abs(one - other).max() > 1  # another realisation has other photons
    assert abs(one.sum() - other.sum()) < SIGMAS * np.sqrt(2 * one.sum())


@pytest.mark.parametrize("layers", [{}, {"CTE_effect": {"density_scale": 1.0}}], ids=["usual", "irradiated"])
def test_through_the_detector_it_is_what_a_readout_with_this_light_gives(bare, layers):
    sim = bare.replace(layers=layers)
    run, job = sim._run, sim._run.job(OBSID, CHIP)
    table = mixed(sim, 60, bright=19, seed=2)
    frame, sky = sim.chip(OBSID, CHIP), sim.light(OBSID, CHIP).image
    light = light_of(run, job, catalogue_of(run, job, table_of(table)), 1, lambda text: None)
    assert light.electrons.max() < run.camera.detector.full_well / 2
    without, wanted = (read_out_with(run, job, sky, some) for some in (None, light))
    assert np.array_equal(np.rint(without), frame.raw)  # the test's own readout is the simulator's
    held = BaseFrame(Path("frame"), frame.header, frame.header, frame.readout, "channels", None, frame.raw)
    added, _, _ = difference(run, job, held, light)
    off = frame.readout.active(added - (wanted - without)) * run.camera.detector.gain
    lit = light.plane(job.window.shape) > 0
    sigma = noise_of(bare)
    assert (off[lit] / sigma[lit]).std() < DETECTOR and (off[~lit] / sigma[~lit]).std() < DETECTOR
    assert abs(off.sum()) < 1e-3 * light.electrons.sum()
    # Whole DN of the same expectation: the fraction that the raw DN hides is drawn anew
    made = sim.inject(frame, table).raw.astype(float) - frame.raw
    assert np.abs(made - added).max() < 1.0 + ROUNDED
    touched = np.abs(added) > 0.5
    assert abs((made - added)[touched].mean()) < SIGMAS * 6**-0.5 / np.sqrt(touched.sum())


def test_charge_transfer_of_injected_light_has_no_bias(bare):
    """Charges drawn for a raw frame vary as those of the silicon; their mean errs as the best estimate does.

    What the read noise adds would fill too many traps.
    """
    sim, background = bare.replace(layers={"CTE_effect": {"density_scale": DENSE}}), 60.0
    run, job = sim._run, sim._run.job(OBSID, CHIP)
    rng, noise = np.random.default_rng(4), run.camera.detector.read_noise
    true = rng.poisson(background, job.window.shape).astype(np.float32)
    state = State.blank(job.exposure)
    state.image = true.copy()
    step = run.steps["SCIE"].step("cte_effect")
    moved = step.module.apply(state, step.param, run.streams(job).layer(step.name)).image
    assert np.std(moved - true) > 1.0  # electrons
    shown = np.maximum(moved + rng.normal(0, noise, true.shape), 0).astype(np.float32)
    drawn = [charge.astype(float) for charge in likely_charges(run, job, shown, Streams(1, OBSID, CHIP, "inject 1"))]
    assert len(drawn) == 2 and not np.array_equal(*drawn)
    error = background * noise**2 / (background + noise**2)
    for charge in drawn:
        assert charge.var() == pytest.approx(background, rel=0.03) and abs(charge.mean() - background) < 0.4
    assert np.std(np.mean(drawn, axis=0) - true) == pytest.approx(np.sqrt(error), rel=0.1)
    assert [*likely_charges(bare.replace(layers={"CTE_effect": None})._run, job, shown, None)] == [shown]


def test_saturation_and_dead_pixels(sim, bare):
    frame = bare.chip(OBSID, CHIP)
    table = objects(sim, [100.0], [60.0], [13.0])
    made = bare.inject(frame, table)
    top = bare._run.camera.detector.adc_max
    assert (made.raw >= top).sum() > 20 and made.image[60, 100] == top
    assert made.truth["flags"][0] & SATURATED
    column = made.image[:, 100].astype(int) - frame.image[:, 100]
    assert (column > 1000).sum() > 15  # blooms along the column


@pytest.mark.parametrize("well", [None, 30_000.0])
def test_saturated_light_in_a_calibrated_image_is_what_the_converter_or_the_well_holds(files, tmp_path, sim, well):
    """65535 DN less the bias, before the image was divided by the response, or the full well if that is less."""
    from csstsim.measure.calibration.bad_pixels import FULL
    from csstsim.stages.calibrate import known_corrections

    campaign, _, image, _ = files
    run = OpenCampaign(campaign, copied=True)
    detector, response = run.camera.detector, known_corrections(run, run.job(OBSID, CHIP)).response
    most = 65535 * detector.gain - detector.bias
    assert detector.full_well > most
    if well:
        most = well
        run.camera = replace(run.camera, detector=replace(detector, full_well=well))
    inject_into([image], objects(sim, [100.0], [60.0], [12.0]), tmp_path, lambda text: None, campaign=run)
    with fits.open(tmp_path / image.name) as made:
        row, column = np.nonzero(made["DQ"].data & FULL)
        rate = made["SCI"].data[row, column] + made["SCI"].header["BACKMED"]
    assert len(row) > 20
    assert rate * response.at(row, column) * 150.0 == pytest.approx(most, rel=1e-5)


def run_command(*arguments, code=0):
    result = CliRunner().invoke(main, [str(a) for a in arguments], catch_exceptions=False)
    assert result.exit_code == code, result.output
    return result.output


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """(campaign, Level-0 file, calibrated image, table) of an empty sky, on disk."""
    folder = tmp_path_factory.mktemp("files")
    sim = simulation(folder)
    sky = objects(sim, 128, 128, 60.0, id=[10**9])
    sky.write(folder / "sky.csv")
    data = yaml.safe_load((folder / "campaign.yaml").read_text())
    data["catalog"] = {"kind": "csstsim.catalog.own_table:TableCatalog", "options": {"file": str(folder / "sky.csv")}}
    campaign = folder / "campaign.yaml"
    campaign.write_text(yaml.safe_dump(data))
    run_command("chip", campaign, "--obsid", OBSID, "--chip", CHIP)
    run_command("calibrate", campaign, "--obsid", OBSID, "--chip", CHIP)
    run = OpenCampaign(campaign)
    job = run.job(OBSID, CHIP)
    table = folder / "new.csv"
    mixed(sim, 30, bright=19.5, faint=24, seed=3).write(table)
    return campaign, run.paths.level0(job), run.paths.calibrated(*job.key), table


def content(path):
    return hashlib.sha256(path.read_bytes()).hexdigest()


def test_the_command_on_both_kinds_of_file(files, tmp_path):
    campaign, raw, image, table = files
    before = [content(path) for path in (raw, image)]
    said = run_command("inject", raw, image, "--catalogue", table, "--output", tmp_path, "--campaign", campaign)
    assert said.count("30 objects injected") == 2 and [content(path) for path in (raw, image)] == before
    new, old = read_level0(tmp_path / raw.name, verify=True), read_level0(raw)
    changed = new.frame().astype(int) - old.frame()
    truth = ObjectTable.read((tmp_path / raw.name).with_suffix(".truth.parquet"))
    assert len(truth) == 30 and new.header0["INJCOUNT"] == 30
    assert changed.sum() * 1.1 == pytest.approx(truth["drawn"].sum(), rel=0.02)  # gains within 1 to 2%
    assert {k: v for k, v in new.header.items() if k not in ("CHECKSUM", "DATASUM")}.items() <= old.header.items()
    with fits.open(tmp_path / image.name, checksum=True) as made, fits.open(image) as was:
        assert any("injected 30 objects of new.csv" in str(line) for line in made[0].header["HISTORY"])
        for name in ("SCI", "ERR", "DQ"):
            assert made[name].data.dtype == was[name].data.dtype
        light = (made["SCI"].data - was["SCI"].data) * 150.0
        added = made["ERR"].data.astype(float) ** 2 - was["ERR"].data.astype(float) ** 2
        assert np.all(made["ERR"].data >= was["ERR"].data)
    # Light divided by the response: more than was counted, and the variance is that of the counted electrons
    assert 1.0 < light.sum() / truth["drawn"].sum() < 1.3
    bright = light > 200
    assert np.median(added[bright] * 150.0**2 / light[bright]) == pytest.approx(
        light.sum() / truth["drawn"].sum(), rel=0.05
    )


def test_noise_is_never_used_twice(files, tmp_path):
    """The same objects again: refused with the same realisation, and added with another."""
    campaign, _, image, table = files
    options = "--catalogue", table, "--campaign", campaign
    run_command("inject", image, *options, "--output", tmp_path / "once")
    once = tmp_path / "once" / image.name
    command = ["inject", once, *options, "--output", tmp_path / "twice"]
    said = CliRunner().invoke(main, [str(word) for word in command])
    assert said.exit_code == 2 and "--realisation: the frame has injected objects" in said.output
    assert not (tmp_path / "twice").exists()
    run_command(*command, "--realisation", 2)
    first, last = (
        fits.getdata(path, "SCI") - fits.getdata(image, "SCI") for path in (once, tmp_path / "twice" / image.name)
    )
    assert last.sum() == pytest.approx(2 * first.sum(), rel=0.02)


def test_calibrated_and_raw_agree(files, tmp_path):
    """An image calibrated after injection into the raw frame, and one injected into: the same light and errors."""
    campaign, raw, image, table = files
    run_command("inject", raw, image, "--catalogue", table, "--output", tmp_path, "--campaign", campaign)
    from csstsim.io.level0 import read_level0 as read
    from csstsim.stages.calibrate import calibrated_of

    run = OpenCampaign(campaign)
    job = run.job(OBSID, CHIP)
    seen = calibrated_of(run, job, read(tmp_path / raw.name))
    without = calibrated_of(run, job, read(raw))
    with fits.open(tmp_path / image.name) as made, fits.open(image) as was:
        light = (made["SCI"].data - was["SCI"].data) * 150.0
        error = made["ERR"].data * 150.0
        bad = was["DQ"].data > 0
    off = (seen.electrons - without.electrons) - light
    lit = (light > 0) & ~bad
    assert (off[lit] / error[lit]).std() < 0.15  # rounding to DN, charge that was not moved back exactly
    assert off[lit].sum() / light[lit].sum() == pytest.approx(0, abs=0.003)
    assert (seen.sigma()[lit] / error[lit]).std() < 0.02


def test_a_frame_tells_what_it_is_without_a_campaign(files, tmp_path):
    campaign, raw, _, table = files
    said = run_command(
        "inject", raw, "--catalogue", table, "--output", tmp_path, "--instrument", campaign.parent / "instrument"
    )
    assert "assumed  psf" in said and "30 objects injected" in said
    again = run_command(
        "inject",
        tmp_path / raw.name,
        "--catalogue",
        table,
        "--output",
        tmp_path / "twice",
        "--instrument",
        campaign.parent / "instrument",
        "--realisation",
        2,
    )  # the HISTORY of an injection does no harm
    assert "30 objects injected" in again


def test_a_frame_of_another_camera_is_said_to_be_one(files, tmp_path):
    """Without a campaign, its digest of the camera's files is compared with that of the files that are used."""
    campaign, raw, _, table = files

    def other(file):
        heads = [hdu.header for hdu in file if "CAMHASH" in hdu.header]
        assert heads
        for header in heads:
            header["CAMHASH"] = "0" * len(header["CAMHASH"])

    words = "CAMHASH: the frame was made with other camera parameters"
    for number, frame in enumerate((raw, broken(raw, tmp_path, other))):
        options = "--catalogue", table, "--instrument", campaign.parent / "instrument"
        said = run_command("inject", frame, *options, "--output", tmp_path / str(number))
        assert (words in " ".join(said.split())) == bool(number)


def broken(path, folder, change):
    new = folder / path.name
    with fits.open(path) as file:
        change(file)
        file.writeto(new)
    return new


def _no_wcs(file):
    for key in ("CTYPE1", "CRVAL1"):
        del file["SCI"].header[key]


def _moved(header):
    header["CRVAL2"] += 1e-3


def _nan(file):
    file["ERR"].data[3, 4] = np.nan


FAULTS = {
    "no WCS": _no_wcs,
    "unknown unit": lambda file: file["SCI"].header.__delitem__("BUNIT"),
    "the PSF would be of another filter": lambda file: file[0].header.set("FILTER", "g"),
    "not the size of the window": lambda file: setattr(file["ERR"], "data", file["ERR"].data[:-1]),
    "read in another window": lambda file: file["SCI"].header.set("READX0", 3),
    "1 of the errors are not numbers above 0": _nan,
    "the campaign's exposure time (got 250.0); allowed: 150 s": lambda file: file[0].header.set("EXPTIME", 250.0),
    "the WCS is not the campaign's (got '3.6 arcsec off')": lambda file: _moved(file["SCI"].header),
    "with another seed, catalogue or PSF": lambda file: file[0].header.set("CAMPHASH", "0"),
}


@pytest.mark.parametrize("message", FAULTS)
def test_bad_frames_give_one_line_and_write_nothing(files, tmp_path, message):
    campaign, raw, image, table = files
    frame = broken(image, tmp_path, FAULTS[message])
    out = tmp_path / "out"
    said = run_command("inject", raw, frame, "--catalogue", table, "--output", out, "--campaign", campaign, code=2)
    assert message in said and len(said.strip().splitlines()) == 1 and not out.exists()


def test_a_raw_frame_whose_wcs_was_changed_is_refused(files, tmp_path):
    """As a calibrated one is: objects would be injected beside their positions."""
    campaign, raw, _, table = files

    def moved(file):
        heads = [hdu.header for hdu in file if "CRVAL2" in hdu.header]
        assert heads
        for header in heads:
            _moved(header)

    frame, out = broken(raw, tmp_path, moved), tmp_path / "out"
    said = run_command("inject", frame, "--catalogue", table, "--output", out, "--campaign", campaign, code=2)
    assert "the WCS is not the campaign's (got '3." in said and not out.exists()


def test_each_frame_is_looked_at_for_the_realisation_before_any_is_written(files, tmp_path):
    """The second of two has these objects' noise already."""
    campaign, raw, image, table = files
    options = "--catalogue", table, "--campaign", campaign
    run_command("inject", image, *options, "--output", tmp_path / "once")
    said = run_command("inject", raw, tmp_path / "once" / image.name, *options, "--output", tmp_path / "out", code=2)
    assert "--realisation: the frame has injected objects" in said and not (tmp_path / "out").exists()


@pytest.mark.parametrize(("key", "value"), [("--psf", "psf.fits"), ("--zeropoint", 25.0)])
def test_what_is_for_frames_of_others_is_refused_for_ours(files, tmp_path, key, value):
    campaign, raw, _, table = files
    more = ("--campaign", campaign, key, value)
    said = run_command("inject", raw, "--catalogue", table, "--output", tmp_path / "out", *more, code=2)
    assert f"{key}: not for frames of csstsim" in said and not (tmp_path / "out").exists()


@pytest.mark.parametrize("existing", ["", "note.txt", "fine.truth.parquet"])
def test_no_copy_of_a_call_is_left_if_a_later_frame_fails(tmp_path, existing):
    """A galaxy that is too large at 20 times the resolution. What was in the folder stays."""
    out = tmp_path / "out"
    coarse = write_image(tmp_path, error=False).rename(tmp_path / "coarse.fits")
    cards = {f"CD{i}_{j}": wcs_cards()[f"CD{i}_{j}"] / 20 for i in (1, 2) for j in (1, 2)}
    fine = write_image(tmp_path, error=False, **cards).rename(tmp_path / "fine.fits")
    if existing:
        out.mkdir()
        (out / existing).write_text("mine")
    table = {"ra": [359.9999], "dec": [60.0], "mag": [20.0], "type": ["galaxy"], "size": [60.0]}
    said = []
    with pytest.raises(InputError, match=r"fine\.fits: size, id .*: a galaxy is too large to be rendered"):
        inject_into([coarse, fine], table, out, said.append, psf=write_psf(tmp_path), zeropoint=25.0)
    assert "coarse.fits: 1 object injected" in said[0]
    assert [file.name for file in out.glob("*")] == ([existing] if existing else []) and out.exists() is bool(existing)


def test_a_psf_is_for_the_frames_of_others_among_ours(files, tmp_path):
    """One command for a frame of each kind: ours has its campaign's PSF, the other the given one."""
    campaign, raw, _, table = files
    other = write_image(tmp_path)
    more = "--psf", write_psf(tmp_path), "--zeropoint", 25.0, "--campaign", campaign
    said = run_command("inject", raw, other, "--catalogue", table, "--output", tmp_path / "out", *more)
    assert "30 objects injected" in said and "0 objects injected, 30 outside" in " ".join(said.split())
    assert sorted(path.name for path in (tmp_path / "out").glob("*.fits")) == sorted([raw.name, other.name])


def test_other_bad_input(files, bare, sim, tmp_path):
    campaign, raw, _, table = files
    out = tmp_path / "out"
    bad, words = tmp_path / "bad.csv", tmp_path / "words.csv"
    Table({"ra": [1.0], "dec": [2.0]}).write(bad)
    Table({"ra": [1.0], "dec": [2.0], "mag_r": [20.0], "obj_type": ["star"]}).write(words)
    for more, message in (
        (("--catalogue", bad), f"{bad}: mag_"),
        (("--catalogue", words), f"{words}: obj_type, row 1: must be numbers (got 'star')"),
        (("--catalogue", tmp_path / "none.csv"), "No such file"),
    ):
        assert message in run_command("inject", raw, *more, "--output", out, "--campaign", campaign, code=2)
        assert not out.exists()
    run_command("inject", raw, "--catalogue", table, "--output", out, "--campaign", campaign)
    assert "exists already" in run_command(
        "inject", raw, "--catalogue", table, "--output", out, "--campaign", campaign, code=2
    )
    other = bare.replace(window=(10, 100, 10, 100)).chip(OBSID, CHIP)
    with pytest.raises(InputError, match="another window"):
        bare.inject(other, objects(sim, 50, 50, 20.0))
    with pytest.raises(InputError, match=r"words\.csv: obj_type"):
        bare.inject(bare.chip(OBSID, CHIP), words)


def test_nothing_reaches_the_frame(bare, sim):
    frame, far = bare.chip(OBSID, CHIP), objects(sim, 128, 128, 20.0)
    far["dec"] += 1.0
    made = bare.inject(frame, far)
    assert np.array_equal(made.raw, frame.raw) and len(made.truth) == 0 and made.header["INJCOUNT"] == 0


@pytest.mark.parametrize("layout", ["mosaic", "chip"])
def test_other_layouts_with_mask_and_compression(tmp_path, layout):
    """The light is the same in each layout; MASK gets the bits of a star that saturates, and the file is packed."""
    output = {"layout": layout, "mask": True, "compress": True}
    plain = simulation(tmp_path)
    layers = yaml.safe_load((ROOT / "config/observations/science.yaml").read_text())["layers"]
    layers[-1] = {"quantization_and_output": output}
    (tmp_path / "science.yaml").write_text(yaml.safe_dump({"layers": layers}))
    objects(plain, 128, 128, 60.0, id=[10**9]).write(tmp_path / "sky.csv")
    data = yaml.safe_load((tmp_path / "campaign.yaml").read_text()) | {
        "observations": {"SCIE": str(tmp_path / "science.yaml")}
    }
    data["catalog"] = {"kind": "csstsim.catalog.own_table:TableCatalog", "options": {"file": str(tmp_path / "sky.csv")}}
    (tmp_path / "campaign.yaml").write_text(yaml.safe_dump(data))
    run_command("chip", tmp_path / "campaign.yaml", "--obsid", OBSID, "--chip", CHIP)
    run = OpenCampaign(tmp_path / "campaign.yaml")
    raw = run.paths.level0(run.job(OBSID, CHIP))
    objects(plain, [60.0, 180.0], [60.0, 190.0], [20.0, 15.0]).write(tmp_path / "new.csv")
    run_command(
        "inject", raw, "--catalogue", tmp_path / "new.csv", "--output", tmp_path / "with", "--campaign", run.file
    )
    new, old = read_level0(tmp_path / "with" / raw.name, verify=True), read_level0(raw)
    added = (new.assembled().astype(int) - old.assembled())[30:90, 30:90].sum() * run.camera.detector.gain
    truth = ObjectTable.read((tmp_path / "with" / raw.name).with_suffix(".truth.parquet"))
    assert added == pytest.approx(truth["drawn"][0], rel=0.03)
    fresh = new.mask() & ~old.mask()
    assert old.mask().any() and np.array_equal(new.mask() & old.mask(), old.mask())  # what it marked stays marked
    assert [flags & SATURATED > 0 for flags in truth["flags"]] == [False, True]
    assert new.data_start is None and (fresh[180:200, 170:190] & FULL_WELL).sum() > 5 and not fresh[:100, :100].any()


def test_the_charge_of_a_window_is_the_chips():
    """Rows and columns have random numbers of their own positions, so a part of a frame has the noise of the whole."""
    shown = np.full((6 * BIN, 6 * BIN), 50.0, np.float32)
    level, key = np.full((6, 6), 50.0 * BIN**2, np.float32), np.uint64(77)
    whole = _sampled_charge(shown, np.zeros((0, 0), np.float32), level, 5.0, 1.0, key, 0, 0, *normal_table())
    part = _sampled_charge(shown[BIN:], np.zeros((0, 0), np.float32), level[1:], 5.0, 1.0, key, BIN, 0, *normal_table())
    assert np.array_equal(part, whole[BIN:]) and whole.std() > 1


def test_the_charge_of_a_part_of_the_columns_is_the_chips():
    shown = np.full((2 * BIN, 8 * BIN), 50.0, np.float32)
    level, key, none = np.full((2, 8), 50.0 * BIN**2, np.float32), np.uint64(77), np.zeros((0, 0), np.float32)
    whole = _sampled_charge(shown, none, level, 5.0, 1.0, key, 4, 0, *normal_table())
    part = _sampled_charge(
        shown[:, 3 * BIN :].copy(), none, level[:, 3:].copy(), 5.0, 1.0, key, 4, 3 * BIN, *normal_table()
    )
    assert np.array_equal(part, whole[:, 3 * BIN :]) and whole.std() > 1


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_charge_is_drawn_about_the_best_estimate(sign):
    """As the module's formula has it: b + b / (b + r^2) (q - b), variance b r^2 / (b + r^2), and 1/12 of rounding.

    The level changes from bin to bin; what was moved comes off first; pixels beyond 4 sigma keep what they show.
    """
    levels, noise, side = (40.0, 90.0), 6.0, 100
    level = np.repeat(np.array(levels, np.float32)[None] * BIN**2, side, axis=1).repeat(side, axis=0)
    shape = level.shape[0] * BIN + 1, level.shape[1] * BIN + 1  # the last row and column lie beyond the bins
    shown, moved = np.full(shape, 57.0, np.float32), np.full(shape, 3.0, np.float32)
    shown[5, 7], shown[6, 7] = 5000.0, 1e-3
    found = _sampled_charge(shown, moved, level, noise, sign, np.uint64(9), 0, 0, *normal_table())
    assert found[5, 7] == 4997.0 and found[6, 7] == 0.0 and (found == np.rint(found)).all()
    for b, columns in zip(levels, (np.s_[10:, : side * BIN], np.s_[10:, side * BIN :]), strict=True):
        values, ratio = found[columns], b / (b + noise**2)
        variance = ratio * noise**2 + 1 / 12
        assert values.mean() == pytest.approx(b + ratio * (54 - b), abs=SIGMAS * np.sqrt(variance / values.size))
        assert values.var() == pytest.approx(variance, rel=SIGMAS * np.sqrt(2 / values.size))
    other = _sampled_charge(shown, moved, level, noise, -sign, np.uint64(9), 0, 0, *normal_table())
    mean = 0.5 * (found + other)[10:, : side * BIN]
    assert np.abs(mean - (40 + 40 / 76 * 14)).max() <= 1.0  # opposite noise: rounding alone is left
    still = _sampled_charge(shown, moved, 0 * level, 0.0, sign, np.uint64(9), 0, 0, *normal_table())
    assert np.array_equal(still, np.maximum(shown - moved, 0))


def two_images(path):
    """Write two images, of other types, with cards and a HISTORY."""
    primary = fits.PrimaryHDU()
    primary.header["OBSID"], primary.header["INJCOUNT"] = ("7", "the exposure"), 3
    primary.header.add_history(" injected 3 objects of a.csv, digest abc1, realisation 4, by csstsim 1")
    first = fits.ImageHDU(np.arange(12, dtype=np.float32).reshape(3, 4), name="SCI")
    first.header["BUNIT"] = ("electron/s", "unit")
    second = fits.ImageHDU(np.arange(6, dtype=np.int16).reshape(2, 3), name="DQ")
    fits.HDUList([primary, first, second]).writeto(path)
    return path


def test_a_file_written_again_has_its_cards_and_planes(tmp_path):
    source = two_images(tmp_path / "a.fits")
    before = source.read_bytes()
    plane = np.full((2, 3), 9.0)
    said = {"cards": [("INJCOUNT", 5, "objects"), ("INJREAL", 12, "noise")], "history": ["one", "two, realisation"]}
    rewrite(source, tmp_path / "b.fits", {"DQ": plane}, said)
    with fits.open(tmp_path / "b.fits", checksum=True) as made:
        head = made[0].header
        assert [hdu.name for hdu in made] == ["PRIMARY", "SCI", "DQ"] and head["OBSID"] == "7"
        assert (head["INJCOUNT"], head["INJREAL"], head.count("INJCOUNT")) == (5, 12, 1)
        assert [line.strip() for line in head["HISTORY"]] == [
            "injected 3 objects of a.csv, digest abc1, realisation 4, by csstsim 1", "injected one",
            "injected two, realisation",
        ]  # fmt: skip
        assert made["DQ"].data.dtype.kind == "i" and (made["DQ"].data == 9).all()
        assert np.array_equal(made["SCI"].data.ravel(), np.arange(12)) and made["SCI"].header["BUNIT"] == "electron/s"
        assert made["SCI"].header.comments["BUNIT"] == "unit"
    assert source.read_bytes() == before
    with pytest.raises(InputError, match="DQ: not an image of the expected size"):
        rewrite(source, tmp_path / "c.fits", {"DQ": plane.T}, said)
    assert not (tmp_path / "c.fits").exists()


def test_every_realisation_of_a_history_is_known(tmp_path):
    """However it is cut into cards; an original has none."""
    said = "30 objects of a table of a rather long name.csv, digest abcdef0123, realisation"
    source = two_images(tmp_path / "a.fits")
    for number, (one, other) in enumerate(((17, 2), (1, 230))):
        history = [f"{'x' * number}{said} {k}, by csstsim 1.0" for k in (one, other)]
        rewrite(source, tmp_path / f"{number}.fits", {}, {"cards": [], "history": history})
        assert realisations(tmp_path / f"{number}.fits") == {4, one, other}
    fits.PrimaryHDU().writeto(tmp_path / "new.fits")
    assert realisations(tmp_path / "new.fits") == set()


def test_a_record_tells_tables_and_curves_apart(tmp_path):
    """The digest is of all columns, and of the content of the curves."""
    curves, others = tmp_path / "curves.csv", tmp_path / "others.csv"
    curves.write_text("curve,mjd,dmag\n")
    others.write_text("curve,mjd,dmag\na,5,1\n")
    columns = {"ra": [1.0], "mag": [20.0]}
    given = [
        Request(columns, "/some/where/new.csv", 3), Request(columns | {"mag": [21.0]}, "new.csv", 3),
        Request(columns, "new.csv", 3, light_curves=curves), Request(columns, "a table", 4),
        Request(columns, "new.csv", 3, light_curves=others),
    ]  # fmt: skip
    made = [record(request, count) for request, count in zip(given, (1, 2, 2, 2, 2), strict=True)]
    codes = [dict((key, value) for key, value, _ in one["cards"])["INJHASH"] for one in made]
    assert codes[0] == codes[3] and len(set(codes)) == 4
    assert [card[:2] for card in made[0]["cards"]] == [("INJCOUNT", 1), ("INJHASH", codes[0]), ("INJREAL", 3)]
    assert made[0]["history"] == [f"1 object of new.csv, digest {codes[0]}, realisation 3, by csstsim {__version__}"]
    assert made[3]["history"][0].startswith("2 objects of a table, digest") and "realisation 4" in made[3]["history"][0]


@pytest.mark.parametrize(
    ("ours", "names", "kind"),
    [
        (True, ["IMAGE"], "level0"), (True, ["SCI", "ERR", "DQ"], "calibrated"), (False, ["SCI", "ERR", "DQ"], "other"),
        (False, ["IMAGE"], "other"), (True, ["SCI", "ERR"], None),
    ],
)  # fmt: skip
def test_kinds_of_files(tmp_path, ours, names, kind):
    primary = fits.PrimaryHDU()
    if ours:
        primary.header["SIMVER"] = "1.0"
    fits.HDUList([primary, *(fits.ImageHDU(np.zeros((2, 2)), name=name) for name in names)]).writeto(
        tmp_path / "a.fits"
    )
    if kind:
        assert kind_of(tmp_path / "a.fits") == kind
    else:
        with pytest.raises(InputError, match="without IMAGE, and without SCI, ERR and DQ"):
            kind_of(tmp_path / "a.fits")


@pytest.mark.parametrize(("window", "key"), [((10, 50, 4, 8), None), ((10, 50, 4, 9), "READX0"), (None, "READX0"),
                                             ((4, 8, 10, 50), "READX0")])  # fmt: skip
def test_a_frame_is_of_the_jobs_window(window, key):
    """As the header says; one that says nothing is of the whole chip."""
    chip = SimpleNamespace(filter="r", detector=None, full_window=Window(0, 64, 0, 16))
    job = SimpleNamespace(chip=chip, window=Window(10, 50, 4, 8))
    head = SimpleNamespace(path="a.fits", get=lambda name: "R", window=lambda detector: window)
    whole = SimpleNamespace(chip=chip, window=Window(0, 64, 0, 16))
    if key is None:
        check_job(head, job)
        check_job(SimpleNamespace(path="a.fits", get=lambda name: None, window=lambda detector: None), whole)
    else:
        with pytest.raises(InputError, match=key):
            check_job(head, job)


def test_what_is_no_frame_is_refused(bare, sim):
    table = objects(sim, 50, 50, 20.0)
    with pytest.raises(InputError, match="frame: not a Frame"):
        bare.inject(np.zeros((3, 3)), table)
    with pytest.raises(InputError, match="does not state its exposure"):
        bare.inject(replace(bare.light(OBSID, CHIP), key=None), table)


def test_frames_that_would_be_written_twice_are_refused(tmp_path):
    """Before any is read: the same frame, two of one name, one that is there; and a folder that is a file."""
    (tmp_path / "other").mkdir()
    one, two = two_images(tmp_path / "a.fits"), two_images(tmp_path / "other" / "a.fits")
    table = {"ra": [1.0], "dec": [2.0], "mag": [20.0]}
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "a.fits").write_text("mine")
    for frames, folder in (([one, one], "new"), ([one, two], "new"), ([one], "out")):
        with pytest.raises(InputError, match="written twice, or exists already"):
            inject_into(frames, table, tmp_path / folder)
    with pytest.raises(InputError, match="is not a folder"):
        inject_into([one], table, two)
    assert not (tmp_path / "new").exists() and (tmp_path / "out" / "a.fits").read_text() == "mine"


def test_what_a_mask_gains_and_how_a_chip_of_one_gain_is_read(monkeypatch):
    """Two likely charges: the mean of what they add; a pixel is new in the mask if it is in one of them.

    Of a file whose channels have one gain, what a channel adds is in DN of that gain, without prescan and overscan.
    """
    from csstsim.inject import level0

    detector = SimpleNamespace(
        nx=64, ny=16, channels_x=8, channels_y=2, channel_nx=8, channel_ny=8, prescan=3, overscan=6,
        parallel_overscan=4, full_well=1e9,
    )  # fmt: skip
    window = Window(0, 64, 0, 16)
    readout = ReadoutFrame.of(detector, window)
    gains = np.linspace(1.0, 1.3, 16)
    masks = iter([np.uint32(v) for v in (1, 1 | 2, 4, 4 | 8)])  # without and with the light, of each charge

    def read_out(run, job, held):
        electrons, frame = held.pop(), np.zeros(readout.shape, np.float32)
        for block in readout.blocks:
            frame[block.active] = electrons[block.image] / gains[block.channel - 1]
        return SimpleNamespace(image=frame, mask=np.full(readout.shape, next(masks)), header={"gain": gains})

    shown = np.arange(16 * 64, dtype=np.float32).reshape(16, 64)
    monkeypatch.setattr(level0, "charge_in", lambda run, file: shown)
    monkeypatch.setattr(level0, "likely_charges", lambda run, job, shown, streams: iter([shown.copy(), shown + 5]))
    monkeypatch.setattr(level0, "_read_out", read_out)
    pixel = np.array([3, 70, 1000])
    light = SimpleNamespace(pixel=pixel, electrons=np.array([11.0, 22.0, 33.0], np.float32), truth="t", streams=None)
    run = SimpleNamespace(camera=SimpleNamespace(detector=detector))
    job = SimpleNamespace(chip=SimpleNamespace(kind="slitless"), window=window)
    file = SimpleNamespace(layout="chip", gain=dict.fromkeys(range(1, 17), 1.1))
    added, new, truth = difference(run, job, file, light)
    wanted = np.zeros(16 * 64)
    wanted[pixel] = light.electrons / 1.1
    assert added.shape == (16, 64) and added.ravel() == pytest.approx(wanted, abs=1e-3)
    assert truth == "t" and new.shape == (16, 64) and (new == 2 | 8).all()
