"""A stage killed (SIGKILL) at each of its writes: half a file on disk, or only some products renamed."""

import os
import signal

import pytest
from faults.small_run import CHAIN

from csstsim.base.files import atomic

pytestmark = pytest.mark.faults
MOMENTS = "half", "renamed"


def killed(small_run, rule, moment, number):
    """Run a stage in a process that kills itself at its `number`th write; return whether it lived to its end."""
    child = os.fork()
    if child:
        _, status = os.waitpid(child, 0)
        assert status in (0, signal.SIGKILL)
        return status == 0
    try:
        _kill_at(moment, number)
        silence = os.open(os.devnull, os.O_WRONLY)
        os.dup2(silence, 1)
        small_run.stage(rule)
        os._exit(0)
    finally:
        os._exit(1)


def _kill_at(moment, number):
    """Of the flushes: a temporary's, cut to half before, or the folder's, after the rename."""
    flush, seen = atomic._flush, []

    def last(path):
        if path.is_dir() == (moment == "renamed"):
            seen.append(path)
        if len(seen) == number:
            if moment == "half":
                os.truncate(path, path.stat().st_size // 2)
            os.kill(os.getpid(), signal.SIGKILL)
        flush(path)

    atomic._flush = last


def test_a_stage_killed_at_each_of_its_writes(small_run, tell):
    small_run.back_before("truth")
    _ = small_run.opened
    kills = 0
    for rule in CHAIN:
        for moment in MOMENTS:
            number = 1
            while not killed(small_run, rule, moment, number):
                small_run.assert_nothing_wrong()
                assert len(small_run.temporaries()) <= 1, "the next writer of a file removes what was left of it"
                kills, number = kills + 1, number + 1
            assert number > 1 and small_run.temporaries() == []
    assert small_run.products() == small_run.wanted
    happened = "half-written files are never under a product's name; the same stage again removes them"
    tell("kill -9 of a stage", f"each of {len(CHAIN)} stages, at each write and rename: {kills} kills", happened)
