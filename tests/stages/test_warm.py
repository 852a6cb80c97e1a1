"""doctor --warm: which exposures and chips, in which order; the code that it compiles is that of a campaign."""

import pytest
from click.testing import CliRunner

from csstsim.base.process.shipped_kernels import VARIABLE
from csstsim.campaign.opened import OpenCampaign
from csstsim.command_line.main import main
from csstsim.stages import warm


def test_every_stage_of_an_imaging_and_a_slitless_chip(tmp_path):
    run = OpenCampaign(warm._campaign(tmp_path))
    assert [(job.obsid, job.chip.id, job.chip.kind) for job in run.jobs] == [
        ("10100000004", 9, "imaging"), ("10100000015", 29, "slitless"),
    ]  # fmt: skip
    steps = [step.func.__name__ for step in warm._steps(run)]
    assert [name for name in steps if name != "truth"] == [
        "_find_positions", "psf", "chip", "measure", "psf", "chip", "extract", "merge", "validate",
    ]  # fmt: skip
    assert steps[1] == "truth" and run.paths.output.is_relative_to(tmp_path)


def test_it_comes_before_the_checks(monkeypatch):
    said = []
    monkeypatch.setenv(VARIABLE, "")  # which it leaves out: restored afterwards
    monkeypatch.setattr(warm, "_steps", lambda run: [lambda: said.append(run.config.name), lambda: print("hidden")])
    result = CliRunner().invoke(main, ["doctor", "--warm"])
    assert said == ["warm"] and "hidden" not in result.output and "numba cache" in result.output


@pytest.mark.slow
def test_afterwards_the_demos_chips_compile_nothing(tmp_path):
    """In new processes, with a cache that `--warm` alone has filled: `csstsim chip` of both finds all code compiled."""
    import os
    import subprocess
    import sys

    count = "import numba.core.dispatcher as d, atexit; made = []; old = d.FunctionCache.save_overload; "
    count += "d.FunctionCache.save_overload = lambda self, sig, data: (made.append(self), old(self, sig, data)); "
    count += "atexit.register(lambda: print('compiled', len(made)));"
    environment = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path / "compiled")}
    run = "from csstsim.command_line.main import main; main()"
    file = warm._campaign(tmp_path)
    lines = [
        ["doctor", "--warm"],
        *(["chip", str(file), "--obsid", o, "--chip", str(c)] for o, c in warm.EXPOSURES.items()),
    ]
    said = [
        subprocess.run([sys.executable, "-c", count + run, *line], env=environment, text=True, capture_output=True)
        for line in lines
    ]
    assert [done.returncode for done in said] == [0, 0, 0], said[-1].stderr
    made = [int(done.stdout.split()[-1]) for done in said]
    assert made[0] > 100 and made[1:] == [0, 0]
