"""How a command ends when something fails: its exit code, and the one line that it prints."""

import errno
import signal

import pytest
from commands import command
from mini_campaign import POINTINGS, write_campaign

from csstsim.base.errors import CsstsimError, InputError
from csstsim.command_line import group
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
    monkeypatch.setattr(group, "_forget_output", lambda: forgotten.append(1))
    found = ending(BrokenPipeError(errno.EPIPE, "Broken pipe"))
    assert (found.exit_code, found.output, forgotten) == (141, "", [1])


def test_a_signal_ends_with_its_number():
    with pytest.raises(SystemExit) as ended:
        group._stop(signal.SIGTERM, None)
    assert ended.value.code == 143


def test_a_campaign_that_cannot_be_opened_is_refused_by_every_stage(tmp_path):
    file = write_campaign(tmp_path, POINTINGS[:1], select={"obsids": ["42"]})
    for words in (("plan", file), ("status", file), ("chip", file, "--obsid", "42", "--chip", 9), ("report", file)):
        found = command(*words)
        assert found.exit_code == 2 and "select.obsids: not in the survey table (got '42')" in found.stderr


def test_a_chip_that_a_variant_takes_from_its_base_has_no_profile():
    said = []
    assert profiled(lambda: None, said.append) is None and not said
