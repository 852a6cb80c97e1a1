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


SLOW = """
import time
import numba
from numba.extending import overload
def wait(x): ...
@overload(wait)
def _wait(x):
    time.sleep({seconds})  # while it is compiled
    return lambda x: 2 * x
@numba.njit(cache=True)
def inner(x):
    return wait(x)
@numba.njit(cache=True)
def outer(x):
    return inner(x) + 1
print(outer({argument}), sum(outer.stats.cache_misses.values()), flush=True)
"""


def started(folder, *words, tree=False, seconds=1.0, before=""):
    """Start a process that compiles for some seconds; tree: beside the source."""
    file = folder / "slow.py"
    text = before + SLOW.format(seconds=seconds, argument=3.0)
    if not file.exists():
        file.write_text(text)
    variables = {name: value for name, value in os.environ.items() if name != "NUMBA_CACHE_DIR"}
    variables |= {"PYTHONPATH": os.pathsep.join(sys.path), "HOME": str(folder / "home")}
    variables |= {} if tree else {"NUMBA_CACHE_DIR": str(folder / "cache")}
    return subprocess.Popen(
        [sys.executable, file, *words], env=variables, text=True, stdout=subprocess.PIPE, stderr=subprocess.PIPE
    )


def results(*processes):
    """Return what each printed: the value and how many functions it compiled."""
    said = [process.communicate() for process in processes]
    assert all(process.returncode == 0 for process in processes), said
    return [out.split() for out, _ in said]


def test_processes_that_start_together_compile_once(tmp_path):
    found = results(*(started(tmp_path) for _ in range(3)))
    assert {value for value, _ in found} == {"7.0"}
    assert sorted(misses for _, misses in found) == ["0", "0", "1"]


def test_who_waits_goes_on_when_the_other_is_killed(tmp_path):
    first = started(tmp_path, seconds=60.0)
    lock = tmp_path / "cache"
    while not any(lock.rglob("compiling.lock")):
        assert first.poll() is None
    (tmp_path / "slow.py").unlink()
    second = started(tmp_path, seconds=0.1)
    with pytest.raises(subprocess.TimeoutExpired):
        second.wait(3)
    first.kill()
    first.communicate()
    assert results(second) == [["7.0", "1"]]


def test_code_beside_a_package_is_read_if_it_cannot_be_written(tmp_path):
    """As of a user whose package another one has installed and compiled."""
    unwritable = (
        "from numba.core.caching import InTreeCacheLocator as tree\n"
        "import sys\n"
        "if sys.argv[1:]: tree.from_function = classmethod(lambda *given: None)\n"
    )
    first = started(tmp_path, tree=True, before=unwritable)
    assert results(first) == [["7.0", "1"]]
    beside = {path: path.stat().st_mtime_ns for path in (tmp_path / "__pycache__").iterdir()}
    other = started(tmp_path, "unwritable", tree=True)
    assert results(other) == [["7.0", "0"]]
    assert {path: path.stat().st_mtime_ns for path in (tmp_path / "__pycache__").iterdir()} == beside


SHAPES = """
import numpy as np
import numba
from numba.core.compiler import CompilerBase
from csstsim.base.process.compiled_cache import init
if {ours}:
    init()
found, compile_ = [], CompilerBase._compile_core
def count(self):
    found.append(self.state.func_id.func_qualname)
    return compile_(self)
CompilerBase._compile_core = count
@numba.njit
def assign(rows, row):
    rows[1] = row
rows = np.zeros((2, 3))
assign(rows, np.arange(3.0))
assert rows.tolist() == [[0, 0, 0], [0, 1, 2]]
assign(rows, np.ones(1))
assert rows.tolist() == [[0, 0, 0], [1, 1, 1]]
for length in (0, 2, 4):
    try:
        assign(rows, np.zeros(length))
    except ValueError as error:
        print(error)
print(len(found))
"""


def test_an_array_of_another_shape_is_refused_without_the_text_of_its_shapes(tmp_path):
    """numba alone compiles some twenty functions of strings for the text; if it does not, the change is not needed."""
    off = "import numba.core.entrypoints as e; e._already_initialized = True\n"
    texts, counts = {}, {}
    for ours in (True, False):
        done = run(tmp_path, off + SHAPES.format(ours=ours))
        assert done.returncode == 0, done.stderr
        *texts[ours], counts[ours] = done.stdout.splitlines()
    assert texts[True] == ["an array cannot be assigned to a part of another: their shapes differ"] * 3
    assert all("shape" in text for text in texts[False]) and len(texts[False]) == 3
    assert int(counts[True]) <= 3 and int(counts[False]) > 15
