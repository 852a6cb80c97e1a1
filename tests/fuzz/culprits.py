"""Readers with every fault the watch must see."""

import os
import subprocess
import time
from pathlib import Path

import numpy as np

from csstsim.base.errors import CsstsimError, InputError


def reads(path):
    assert path


def refuses(path):
    raise InputError("spoiled", file=path)


def raises(path):
    {}[path]


def hangs(path):
    time.sleep(60)


def dies(path):
    os.kill(os.getpid(), 11)


def asks_for_all_memory(path):
    np.ones(1 << 33)


def hides_that_memory_ran_out(path):
    try:
        np.ones(1 << 33)
    except MemoryError:
        raise InputError("damaged", file=path) from None


def writes_beside(path):
    beside = Path(path).parents[1] / "beside"
    beside.write_text("x")
    beside.unlink()


def writes_within(path):
    Path(path).write_text("x")


def runs_a_command(path):
    os.system("true")


def starts_a_process(path):
    subprocess.run(["true"], check=True)


def speaks_in_colours(path):
    raise CsstsimError("\x1b[31mred")
