"""How a command ends when something fails: its exit code, and the one line that it prints."""

import errno
import signal
import subprocess
import sys
from types import SimpleNamespace

import numpy as np
import pytest
from support.commands import command
from support.mini_campaign import POINTINGS, write_campaign

from csstsim.base.errors import CsstsimError, InputError
from csstsim.catalog.table import ObjectTable
from csstsim.command_line import group, profile
from csstsim.command_line.profile import profiled


@pytest.fixture
def ending(monkeypatch):
    """Return a function that ends `csstsim init d` with an exception, and returns the click result."""

    def run(error, *before):
        def init(*given):
            raise error

        monkeypatch.setattr("csstsim.campaign.starter.init", init)
        return command(*before, "init", "d")

    return run


@pytest.mark.parametrize(("error", "line"), [
    (InputError("bad", file="a.yaml", key="k"), "a.yaml: k: bad"), (CsstsimError("worse"), "worse"),
    (OSError(errno.ENOSPC, "No space left on device", "/out/x"), "/out/x: No space left on device"),
    (OSError(errno.ENOSPC, "No space left on device"), "No space left on device"),
    (PermissionError(errno.EACCES, "Permission denied", "/out"), "/out: Permission denied"),
])  # fmt: skip
def test_what_a_user_can_mend_is_one_line(ending, error, line):
    found = ending(error)
    assert (found.exit_code, found.stdout, found.stderr) == (2, "", f"csstsim: error: {line}\n")
    loud = ending(error, "-v")
    assert ("Traceback" in loud.stderr) == isinstance(error, CsstsimError) and loud.stderr.endswith(f"error: {line}\n")


def test_bugs_are_let_through_and_pipes_without_a_reader_end_silently(ending, monkeypatch):
    for bug in (OSError("of no file"), ZeroDivisionError("no")):
        assert ending(bug).exception is bug
    forgotten = []
    monkeypatch.setattr(group, "_discard_output", lambda: forgotten.append(1))
    found = ending(BrokenPipeError(errno.EPIPE, "Broken pipe"))
    assert (found.exit_code, found.output, forgotten) == (141, "", [1])


def test_a_signal_ends_with_its_number():
    with pytest.raises(SystemExit) as ended:
        group._stop(signal.SIGTERM, None)
    assert ended.value.code == 143


TERMINATED = """
import time
from csstsim.base.files.atomic import atomic_path
from csstsim.campaign import starter
from csstsim.command_line.main import main

def init(*given):
    with atomic_path("a.txt") as temporary:
        temporary.write_text("half")
        print("begun", flush=True)
        time.sleep(60)

starter.init = init
main(["init", "d"])
"""


def test_a_command_that_is_terminated_leaves_nothing_half_written(tmp_path):
    """As a batch system ends a job: without a word, and with 143."""
    line = [sys.executable, "-c", TERMINATED]
    with subprocess.Popen(line, cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        assert process.stdout.readline() == "begun\n" and len(list(tmp_path.iterdir())) == 1
        process.terminate()
        out, errors = process.communicate(timeout=30)
    assert (process.returncode, out, errors, list(tmp_path.iterdir())) == (143, "", "", [])


def test_a_campaign_that_cannot_be_opened_is_refused_by_every_stage(tmp_path):
    file = write_campaign(tmp_path, POINTINGS[:1], select={"obsids": ["42"]})
    for words in (("plan", file), ("status", file), ("chip", file, "--obsid", "42", "--chip", 9), ("report", file)):
        found = command(*words)
        assert found.exit_code == 2 and "select.obsids: not in the survey table (got '42')" in found.stderr


def test_a_chip_that_a_variant_takes_from_its_base_has_no_profile():
    said = []
    assert profiled(lambda: None, said.append) is None and not said


def test_the_profile_has_the_own_seconds_of_the_functions_that_took_longest(monkeypatch):
    """cProfile has of each function: calls that are not recursive, all calls, own and cumulative seconds, callers."""
    entries = {(f"/src/csstsim/render/f{k}.py", 10 + k, "draw"): (1, 2, 0.1 * k, 100.0 - k, {}) for k in range(1, 31)}
    entries |= {
        ("~", 0, "<built-in method sum>"): (7, 9, 50.0, 70.0, {}),
        ("/a/main.py", 1, "all"): (1, 1, 0, 999.0, {}),
    }
    monkeypatch.setattr(profile.pstats, "Stats", lambda profiler: SimpleNamespace(stats=entries))
    truth = ObjectTable(
        {
            "method": np.array(["photons", "stamps", "photons"]),
            "electrons": np.array([10.0, 2e6, 30.0]),
            "ms": np.array([500.0, 40.0, 1000.0]),
        }
    )
    state = SimpleNamespace(header={"timing": [("sky", 99.0, 1.25), ("readout", 99.0, 0.5)]}, truth=truth)
    said = []
    profiled(lambda: state, said.append)
    lines = [line.split() for text in said for line in text.splitlines() if line]
    assert lines[:6] == [
        ["layer", "CPU", "s"], ["sky", "1.25"], ["readout", "0.50"], ["method", "objects", "electrons", "CPU", "s"],
        ["photons", "2", "40", "1.50"], ["stamps", "1", "2e+06", "0.04"],
    ]  # fmt: skip
    assert lines[6] == ["function", "calls", "wall", "s"]
    assert lines[7] == ["<built-in", "method", "sum>", "9", "50.00"]
    assert lines[8:] == [[f"render/f{k}.py:{10 + k}", "draw", "2", f"{0.1 * k:.2f}"] for k in range(30, 16, -1)]


@pytest.mark.parametrize("truth", [None, ObjectTable({"method": np.array([], str)})])
def test_a_chip_without_objects_has_no_profile_of_methods(truth):
    said = []
    profiled(lambda: SimpleNamespace(header={"timing": []}, truth=truth), said.append)
    heads = [text.strip().split()[0] for text in said if text.startswith("\n")]
    assert heads == ["layer", "function"]
