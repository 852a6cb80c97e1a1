"""A cache of compiled code that names a class of an earlier version does not end the program."""

import os
import subprocess
import sys
from importlib.metadata import entry_points

import pytest

KERNEL = """
from typing import NamedTuple
import numba
class {name}(NamedTuple):
    x: float
@numba.njit(cache=True)
def double(pair):
    return 2 * pair.x
"""
CALL = "import kernel; print(kernel.double(kernel.{name}(1.5)))"


def run(folder, program):
    variables = os.environ | {"PYTHONPATH": os.pathsep.join([str(folder), *sys.path]), "NUMBA_CACHE_DIR": str(folder)}
    return subprocess.run([sys.executable, "-c", program], env=variables, text=True, capture_output=True)


@pytest.mark.parametrize("init", ["from csstsim.base.process.compiled_cache import init; init(); init(); ", ""])
def test_a_class_that_was_renamed_is_compiled_again(tmp_path, init):
    """Without `init`, numba finds it by the entry point of what is installed."""
    if not init and not any(e.value == "csstsim.base.process.compiled_cache:init" for e in entry_points(name="init")):
        pytest.skip("csstsim was installed before it had this entry point")
    module = tmp_path / "kernel.py"
    for name in ("Work", "Wider"):  # of other lengths: the file's size differs, whatever its time
        module.write_text(KERNEL.format(name=name))
        done = run(tmp_path, init + CALL.format(name=name))
        assert (done.stdout.strip(), done.returncode) == ("3.0", 0), done.stderr
    assert len(list(tmp_path.rglob("*.nbc"))) >= 1


def test_numba_itself_would_end(tmp_path):
    """If this fails, numba can do it, and the module is not needed any more."""
    module = tmp_path / "kernel.py"
    found = []
    off = "import numba.core.entrypoints as e; e._already_initialized = True; "
    for name in ("Work", "Wider"):
        module.write_text(KERNEL.format(name=name))
        found.append(run(tmp_path, off + CALL.format(name=name)))
    assert found[0].returncode == 0 and "Can't get attribute 'Work'" in found[1].stderr
