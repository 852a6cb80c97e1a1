"""Bad input gives one line with file, key, value and allowed values, exit code 2, and no files left."""

import pytest
import yaml
from support.commands import command, done, refused
from support.mini_campaign import POINTINGS, write_campaign

from csstsim.campaign.opened import OpenCampaign

GOOD = POINTINGS[0]


@pytest.mark.parametrize(
    "rows, words",
    [
        ([GOOD.replace("60.15,", "nan,", 1)], ["table.csv", "line 2", "ra"]),
        ([GOOD, GOOD], ["table.csv", "line 3", "obsid", "10100000001"]),
        ([GOOD.replace("-40.0", "91")], ["table.csv", "line 2", "dec", "91", "-90"]),
        ([GOOD.replace("SCIE", "SPAM")], ["table.csv", "type", "SPAM", "SCIE"]),
        ([], ["table.csv"]),
    ],
)
def test_survey_table(tmp_path, rows, words):
    path = write_campaign(tmp_path, rows)
    line = refused("check", path)
    assert all(word in line for word in words), line
    assert not (tmp_path / "out").exists()


def test_survey_table_without_a_column(tmp_path):
    path = write_campaign(tmp_path)
    table = tmp_path / "table.csv"
    table.write_text(table.read_text().replace("obsid,type,ra,dec,pa", "obsid,type,ra,dec,angle"))
    line = refused("check", path)
    assert "table.csv" in line and "angle" in line and "pa" in line


@pytest.mark.parametrize(
    "change, words",
    [
        (lambda folder: (folder / "GI1.conf").unlink(), ["GI1.conf", "No such file"]),
        (lambda folder: (folder / "GI_p0.fits").write_bytes(b"no FITS"), ["GI_p0.fits", "sensitivity"]),
        (lambda folder: folder.with_name("gratings.yaml").unlink(), ["gratings.yaml", "no gratings"]),
    ],
)
def test_gratings_are_read_before_any_work(tmp_path, change, words):
    path = write_campaign(tmp_path, select={"types": ["SCIE"], "chips": [1]})
    change(tmp_path / "instrument" / "gratings")
    line = refused("check", path)
    assert all(word in line for word in words), line


@pytest.mark.parametrize(
    "changes, words",
    [
        ({"colour": 1}, ["campaign.yaml", "colour", "unknown key", "survey_table"]),
        ({"select": {"chips": [31]}}, ["campaign.yaml", "select.chips", "31", "30"]),
        ({"select": {"filters": ["q"]}}, ["campaign.yaml", "select.filters", "'q'", "NUV"]),
        ({"select": {"obsids": ["42"]}}, ["campaign.yaml", "select.obsids", "42"]),
        ({"window": {"x0": 0, "x1": 4000, "y0": 0, "y1": 10}}, ["campaign.yaml", "window", "4000", "128"]),
        ({"window": {"x0": 9, "x1": 3, "y0": 0, "y1": 10}}, ["campaign.yaml", "window", "x0 = 9"]),
        ({"window": "region"}, ["campaign.yaml", "window", "select.region"]),
        (
            {"window": "regio"},
            ["campaign.yaml: window: must be a mapping of x0, x1, y0, y1, or 'region' (got 'regio')"],
        ),
        ({"window": {"x0": 9, "x1": 3, "y0": 0, "y1": 10}}, ["window.x1: must exceed x0 = 9 (got 3)"]),
        ({"output": None}, ["campaign.yaml: output: must be a path, and is empty"]),
        ({"observations": {"SKIE": "o.yaml"}}, ["observations.SKIE: unknown key", "'SCIE', 'BIAS', 'DARK' or 'FLAT'"]),
        (
            {"observations": {"SCIE": "o.yaml"}},
            ["campaign.yaml: observations.SCIE: cannot read the file: No such file", "o.yaml"],
        ),
        ({"seed": -1}, ["campaign.yaml", "seed", "-1"]),
        ({"survey_table": "."}, ["campaign.yaml: survey_table: cannot read the file: it is a folder", "."]),
        ({"survey_table": "/nowhere.csv"}, ["campaign.yaml: survey_table: cannot read the file", "/nowhere.csv"]),
        ({"catalog": {"kind": "nosuch.module:Class"}}, ["catalog.kind", "nosuch"]),
        ({"catalog": {"kind": "support.mini_campaign:write_campaign"}}, ["catalog.kind", "write_campaign", "Stars"]),
        (
            {"catalog": {"kind": "support.mini_campaign:Stars"}},
            ["Stars.__init__", "KeyError: 'ra'", "mini_campaign.py, line"],
        ),
        ({"universe": "/nowhere"}, ["campaign.yaml: universe: no such folder (got '/nowhere')"]),
        ({"output": ""}, ["campaign.yaml", "output", "empty path"]),
        ({"output": "a\0b"}, ["campaign.yaml", "output", "NUL"]),
        ({"observations": {"SCIE": "a\0b"}}, ["campaign.yaml", "observations.SCIE", "NUL"]),
        ({"seed": True}, ["campaign.yaml", "seed", "True"]),
        ({"seed": 2**63}, ["campaign.yaml", "seed", "9223372036854775807"]),
        ({"seed": "1:30"}, ["campaign.yaml", "seed", "1:30"]),
        ({"select": {"chips": [True]}}, ["campaign.yaml", "select.chips", "True"]),
        ({"catalog": {"mag_limit": float("inf")}}, ["campaign.yaml", "catalog.mag_limit", "finite"]),
        ({"psf": {"beta": float("nan")}}, ["campaign.yaml", "psf.beta", "finite"]),
        ({"name": "x" * 100_000 + "!"}, ["campaign.yaml", "name", "xxx ..."]),
    ],
)
def test_campaign(tmp_path, changes, words):
    flat = "10700000001,FLAT,0,0,0,2027-11-20T03:00:00,10"
    path = write_campaign(tmp_path, [*POINTINGS, flat], **({"select": {"types": ["SCIE"]}} | changes))
    line = refused("check", path)
    assert all(word in line for word in words), line
    assert not (tmp_path / "out").exists()


OVER = {"prescan_overscan": {}}
END = [OVER, {"gain": {}}, {"quantization_and_output": {}}]


def test_a_key_misspelt_is_named_not_the_one_it_leaves_missing(tmp_path):
    path = write_campaign(tmp_path)
    path.write_text(path.read_text().replace("seed:", "sead:"))
    assert "sead: unknown key (and 1 more)" in refused("check", path)


def test_a_bad_catalogue_fails_before_any_work(tmp_path):
    """`chip` opens the catalogue before it makes the PSF; `plan` names it too."""
    path = write_campaign(tmp_path, catalog={"kind": "support.mini_campaign:Stars"})
    assert "Stars.__init__" in refused("chip", path, "--obsid", "10100000001", "--chip", 9)
    assert not (tmp_path / "out").exists()
    path = write_campaign(tmp_path, catalog={"kind": "support.mini_campaign:Star"})
    assert "catalog.kind" in refused("plan", path)


@pytest.mark.parametrize(
    "layers, words",
    [
        ([{"biass": {}}], ["science.yaml", "unknown layer", "biass", "bias, blooming"]),
        ([{"CTI_effect": {}}], ["science.yaml", "unknown layer", "CTI_effect"]),
        ([{"bias": {"bias_17channel": True}}], ["science.yaml", "bias_17channel", "bias_16channel"]),
        ([OVER, {"gain": {}}, {"bias": {}}], ["science.yaml", "bias", "DN"]),
        ([OVER, {"sky_background": {}}], ["science.yaml", "sky_background", "render"]),
        ([{"bias": {}}, OVER], ["science.yaml", "bias", "readout pixels", "prescan_overscan"]),
        ([OVER, {"poisson_and_dark": {}}], ["science.yaml", "prescan_overscan", "must come after poisson_and_dark"]),
        ([OVER, {"bias": {}}, {"Bias": {}}], ["science.yaml", "Bias", "twice"]),
        ([OVER, {"gain": {}}], ["science.yaml", "quantization_and_output", "missing"]),
        ([{"poisson_and_dark": {}}], ["science.yaml", "prescan_overscan", "missing"]),
        (
            [{"scie_obs": {"exptime": 10}}, {"poisson_and_dark": {"exptime": 20}}, *END],
            ["poisson_and_dark", "different exposure times", "20"],
        ),
        ([{".bias": {}}], ["science.yaml", ".bias", "cannot import"]),
        ([{"sky_background": {"exptime": -3}}], ["science.yaml", "exptime", "-3"]),
    ],
)
def test_observation(tmp_path, layers, words):
    (tmp_path / "science.yaml").write_text(yaml.safe_dump({"layers": layers}))
    path = write_campaign(tmp_path, observations={"SCIE": str(tmp_path / "science.yaml")})
    line = refused("check", path)
    assert all(word in line for word in words), line


def test_light_has_no_place_in_a_bias_frame(tmp_path):
    (tmp_path / "bias.yaml").write_text(yaml.safe_dump({"layers": [{"scie_obs": {}}, *END]}))
    path = write_campaign(tmp_path, observations={"BIAS": str(tmp_path / "bias.yaml")}, select={"types": ["BIAS"]})
    line = refused("check", path)
    assert all(word in line for word in ("bias.yaml", "scie_obs", "BIAS", "allowed: SCIE"))


def test_missing_brick_then_damaged_brick(tmp_path):
    path = write_campaign(tmp_path)
    line = refused("select", path, "--obsid", "10100000001", "--chip", 9)
    assert "Npix=" in line
    campaign = OpenCampaign(path)
    for pix in campaign.truth_bricks(campaign.job("10100000001", 9)):
        brick = campaign.paths.truth(pix)
        done("truth", path, "--brick", pix)
        brick.write_bytes(brick.read_bytes()[:-200])
    line = refused("select", path, "--obsid", "10100000001", "--chip", 9)
    assert "Npix=" in line and "parquet file" in line
    assert not list((tmp_path / "out").rglob("select*"))


def test_truncated_psf_file(tmp_path):
    path = write_campaign(tmp_path)
    done("chip", path, "--obsid", "10100000001", "--chip", 9)
    psf = OpenCampaign(path).paths.psf(9)
    psf.write_bytes(psf.read_bytes()[: psf.stat().st_size // 2])
    done("select", path, "--obsid", "10100000001", "--chip", 9)
    assert "chip_09.h5" in refused("render", path, "--obsid", "10100000001", "--chip", 9)
    assert not list((tmp_path / "out").rglob("render*")) and not list((tmp_path / "out").rglob("drawn*"))


def test_product_of_another_campaign_is_refused(tmp_path):
    path = write_campaign(tmp_path)
    done("chip", path, "--obsid", "10100000001", "--chip", 9)
    done("select", path, "--obsid", "10100000001", "--chip", 9)
    other = write_campaign(tmp_path, seed=4)
    line = refused("render", other, "--obsid", "10100000001", "--chip", 9)
    assert "select.parquet" in line and "another" in line


def test_chip_does_not_write_into_the_folder_of_another_campaign(tmp_path):
    """One run by `chip` alone, or begun by the workflow: its files would be overwritten."""
    job = "--obsid", "10100000001", "--chip", 9
    (tmp_path / "two").mkdir()
    mine, other = write_campaign(tmp_path), write_campaign(tmp_path / "two")
    done("chip", mine, "--obsid", "10100000001", "--chip", 9)
    before = {path: path.stat().st_mtime_ns for path in (tmp_path / "out").rglob("*")}
    assert "another campaign" in refused("chip", other, *job, "--output", tmp_path / "out")
    assert {path: path.stat().st_mtime_ns for path in (tmp_path / "out").rglob("*")} == before


@pytest.mark.parametrize(
    ("instrument", "words"),
    [
        ({"psf.jitter": 1.0}, ["psf.yaml: jitter", "too wide", "13.5 pixel rms", "1 arcsec, 4 um", "up to 2 pixel"]),
        ({"psf.jitter": -3}, ["psf.yaml: jitter", "(got -3)", ">= 0"]),
        ({"psf.filter_figure.rms.r": -1}, ["psf.yaml: filter_figure.rms.r", "(got -1)", ">= 0"]),
        ({"psf.oversampling.r": 3}, ["psf.yaml: oversampling.r", "(got 3)", "2, 4"]),
        ({"psf.mirror.cycles_max": 0}, ["psf.yaml: mirror", "cycles_min < cycles_max"]),
    ],
)
def test_numbers_of_the_psf(tmp_path, instrument, words):
    """`check` finds them, before the stage that would use them."""
    folder = str(OpenCampaign(write_campaign(tmp_path)).camera.folder)
    line = refused("check", write_campaign(tmp_path, instrument=instrument | {"folder": folder}))
    assert all(word in line for word in [folder, *words]), line


def test_output_that_is_a_file(tmp_path):
    (tmp_path / "file").write_text("mine")
    path = write_campaign(tmp_path, output=str(tmp_path / "file"))
    assert str(tmp_path / "file") in refused("psf", path, "--chip", 9)
    assert (tmp_path / "file").read_text() == "mine"


@pytest.mark.parametrize("chip", ["31", "0", "x"])
def test_chip_number_on_the_command_line(tmp_path, chip):
    result = command("psf", write_campaign(tmp_path), "--chip", chip)
    assert result.exit_code == 2 and chip in result.stderr


def test_unknown_exposure(tmp_path):
    line = refused("chip", write_campaign(tmp_path), "--obsid", "1", "--chip", 9)
    assert "obsid" in line and "'1'" in line


def test_level0_file_of_another_campaign_is_not_measured(tmp_path):
    path = write_campaign(tmp_path)
    done("chip", path, "--obsid", "10100000001", "--chip", 9)
    other = write_campaign(tmp_path, seed=4)
    assert "CAMPHASH" in refused("measure", other, "--obsid", "10100000001", "--chip", 9)


@pytest.mark.parametrize("fidelity, fine", [("standard", False), ("preview", False), ("noise_free", True)])
def test_photons_that_nothing_counts(tmp_path, fidelity, fine):
    names = ["scie_obs", "prescan_overscan", "gain", "quantization_and_output"]
    (tmp_path / "silent.yaml").write_text(yaml.safe_dump({"layers": [{name: {}} for name in names]}))
    path = write_campaign(tmp_path, fidelity=fidelity, observations={"SCIE": str(tmp_path / "silent.yaml")})
    if fine:
        assert OpenCampaign(path).jobs
    else:
        line = refused("plan", path)
        assert "silent.yaml" in line and "poisson_and_dark" in line and "noise_free" in line


@pytest.mark.parametrize("key, value", [("gain_spread", 1.5), ("adc_max", 70000)])
def test_detector_numbers_that_no_file_can_hold(tmp_path, key, value):
    path = write_campaign(tmp_path)
    file = OpenCampaign(path).camera.folder / "detector.yaml"
    numbers = yaml.safe_load(file.read_text())
    next(part for part in numbers.values() if key in part)[key]["value"] = value
    file.write_text(yaml.safe_dump(numbers))
    line = refused("plan", path)
    assert "detector.yaml" in line and key in line and str(value) in line
