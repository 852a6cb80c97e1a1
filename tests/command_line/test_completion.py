"""Shell completion by click, with the exposures and chips of the campaign."""

import os
import shutil
import subprocess
from types import SimpleNamespace

import pytest
import yaml
from click.shell_completion import ShellComplete
from click.testing import CliRunner

from csstsim.command_line.completion import INSTALL, chips_of, obsids_of
from csstsim.command_line.main import main
from csstsim.simulation.sim_steps import known_layers

TABLE = """# a remark
obsid,type,ra,dec,pa,time,exptime
10100000001,SCIE,60.0,-40.0,-113.4333,2027-11-20T01:08:00,150
10100000002,SCIE,60.0005,-40.0003,20.0,2027-11-20T01:12:00,150
10300000001,BIAS,0,0,0,2027-11-20T02:00:00,0
"""


def offered(*words, incomplete=""):
    shell = ShellComplete(main, {}, "csstsim", "_CSSTSIM_COMPLETE")
    return [item.value for item in shell.get_completions([str(word) for word in words], incomplete)]


@pytest.fixture
def campaign(tmp_path):
    """Write a campaign with what completion looks at; return a function that does so with changes."""
    (tmp_path / "table.csv").write_text(TABLE)

    def write(**changes):
        path = tmp_path / "campaign.yaml"
        path.write_text(yaml.safe_dump({"survey_table": str(tmp_path / "table.csv")} | changes))
        return path

    return write


def test_verbs_and_options():
    assert offered(incomplete="fit") == ["fit-grating"]
    assert set(offered(incomplete="s")) == {"select", "shear", "show", "status"}
    assert offered("chip", "c.yaml", incomplete="--pro") == ["--profile"]


def test_files_are_left_to_the_shell():
    shell = ShellComplete(main, {}, "csstsim", "_CSSTSIM_COMPLETE")
    assert [item.type for item in shell.get_completions(["plan"], "camp")] == ["file"]


def test_exposures(campaign):
    everything = ["10100000001", "10100000002", "10300000001"]
    assert offered("chip", campaign(), "--obsid") == everything
    assert offered("chip", campaign(), "--obsid", incomplete="103") == everything[2:]
    assert offered("render", campaign(select={"types": ["SCIE"]}), "--obsid") == everything[:2]
    assert offered("chip", campaign(select={"obsids": [10100000002]}), "--obsid") == everything[1:2]


@pytest.mark.parametrize(
    "changes",
    [
        {"survey_table": "/nowhere.csv"},
        {"survey_table": 0},
        {"survey_table": None},
        {"select": 3},
        {"select": {"types": 1}},
    ],
)
def test_what_is_no_campaign_offers_no_exposures(campaign, changes):
    assert offered("chip", campaign(**changes), "--obsid") == []


def test_no_campaign_at_all_offers_none(tmp_path):
    assert offered("chip", tmp_path / "nowhere.yaml", "--obsid") == []
    assert offered("chip", "--obsid") == []
    (tmp_path / "torn.yaml").write_bytes(b"a: [\xff")
    assert offered("chip", tmp_path / "torn.yaml", "--obsid") == []


def test_chips(campaign):
    assert offered("psf", campaign(), "--chip", incomplete="2") == ["2", *map(str, range(20, 30))]
    assert offered("psf", campaign(select={"chips": [8, 9]}), "--chip") == ["8", "9"]
    assert len(offered("psf", campaign(select={"chips": "imaging"}), "--chip")) == 30
    assert len(offered("psf", "--chip")) == 30


@pytest.mark.parametrize("instrument", ["cam", {"folder": "cam", "detector.gain": 2.0}])
def test_files_that_a_campaign_names_are_beside_it(tmp_path, monkeypatch, instrument):
    """Wherever one stands: the table, and the chips of a camera of one's own."""
    (tmp_path / "far" / "cam").mkdir(parents=True)
    (tmp_path / "far" / "table.csv").write_text(TABLE)
    rows = [{"id": number, "filter": "r"} for number in (12, 3)]
    (tmp_path / "far" / "cam" / "chips.yaml").write_text(yaml.safe_dump({"chips": {"values": rows}}))
    path = tmp_path / "far" / "campaign.yaml"
    path.write_text(yaml.safe_dump({"survey_table": "table.csv", "instrument": instrument}))
    monkeypatch.chdir(tmp_path)
    for file in (path, "far/campaign.yaml"):
        assert offered("chip", file, "--obsid", incomplete="10300") == ["10300000001"]
        assert offered("chip", file, "--chip") == ["3", "12"]


def test_layers():
    assert offered("layers") == known_layers()
    assert offered("layers", "bias", incomplete="Cos") == ["cosmic_rays"]


@pytest.mark.parametrize("shell", INSTALL)
def test_the_script_says_how_to_install_it(shell):
    said = CliRunner().invoke(main, ["completion", shell])
    assert said.exit_code == 0
    assert "_CSSTSIM_COMPLETE" in said.output and INSTALL[shell] in said.output
    if shutil.which(shell):
        assert subprocess.run([shell, "-n"], input=said.output, text=True, check=False).returncode == 0


def test_a_survey_table_that_is_a_pipe_offers_nothing(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    os.mkfifo("table.csv")
    (tmp_path / "campaign.yaml").write_text("survey_table: table.csv\nselect: {chips: [9, [1], null]}\n")
    context = SimpleNamespace(params={"campaign": "campaign.yaml"}, args=[])
    assert obsids_of(context, None, "") == [] and chips_of(context, None, "") == ["9"]
