"""A chip's stages pass files on in a scratch folder (option or environment); products go to the output."""

import pytest
from click.testing import CliRunner
from support.mini_campaign import POINTINGS, write_campaign

from csstsim.campaign.opened import OpenCampaign
from csstsim.command_line.main import main


@pytest.mark.parametrize("by", ["option", "environment"])
def test_intermediates_lie_in_the_scratch_folder_alone(tmp_path, by):
    file = write_campaign(tmp_path, POINTINGS[2:], select={"types": ["BIAS"], "chips": [9]})
    scratch = str(tmp_path / "scratch")
    option, environment = (["--scratch", scratch], {}) if by == "option" else ([], {"CSSTSIM_SCRATCH": scratch})
    for stage in ("readout", "level0"):
        line = [stage, str(file), "--obsid", "10300000001", "--chip", "9", *option]
        done = CliRunner().invoke(main, line, env=environment, catch_exceptions=False)
        assert done.exit_code == 0, done.output
    run = OpenCampaign(file, scratch=scratch)
    assert run.paths.level0(run.jobs[0]).exists()
    assert run.paths.stage("10300000001", 9, "readout.fits").is_relative_to(scratch)
    assert [p.name for p in (tmp_path / "scratch").rglob("*") if p.is_file()] == ["readout.fits"]
    assert not (tmp_path / "out" / "chips").exists()
