"""Products of each stage have the same bits for any number of threads in the libraries used."""

import json
import os
import subprocess
import sys
import threading
from contextlib import redirect_stdout
from io import StringIO
from pathlib import Path

import pytest
from support import all_products
from threadpoolctl import threadpool_info, threadpool_limits

from csstsim.base.files import atomic
from csstsim.base.process.one_thread import one_thread
from csstsim.command_line.group import SECTIONS

pytestmark = pytest.mark.thorough

THREADS = "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"
STAGES = {
    "truth", "psf", "select", "render", "readout", "level0", "chip", "masters", "calibrate", "measure", "extract",
    "merge", "validate", "report",
}  # fmt: skip


def threads():
    """Return the threads of each linear algebra library that is loaded."""
    return {pool["filepath"]: pool["num_threads"] for pool in threadpool_info() if pool["user_api"] == "blas"}


@pytest.fixture
def several():
    """A process whose linear algebra has two threads, as a user's may have."""
    with threadpool_limits(2, user_api="blas"):
        before = threads()
        if set(before.values()) != {2}:
            pytest.skip("the linear algebra library is built for one thread")
        yield before


def made(folder, names, number):
    """Return {product: digest} of every stage, in a process that is told its threads by these variables, or by none."""
    environment = {name: value for name, value in os.environ.items() if name not in THREADS}
    program = [sys.executable, str(Path(all_products.__file__)), str(folder)]
    environment |= dict.fromkeys(names, str(number))
    done = subprocess.run(program, env=environment, capture_output=True, text=True, timeout=600, check=False)
    assert done.returncode == 0, done.stderr
    empty(folder)
    return json.loads(done.stdout)


def empty(folder):
    """The same folder is used again: its name stands in products."""
    for path in sorted(folder.rglob("*"), reverse=True):
        path.rmdir() if path.is_dir() else path.unlink()


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("threads")


@pytest.fixture(scope="module")
def of_one_thread(folder):
    """What the workflow makes, which sets all of the variables to 1."""
    return made(folder, THREADS, 1)


@pytest.mark.slow  # as in a process that was given two threads, below
@pytest.mark.parametrize(
    ("names", "number"),
    [
        pytest.param(THREADS, 8, id="8"),
        pytest.param(THREADS, 2, id="2"),
        pytest.param(("OPENBLAS_NUM_THREADS",), 2, id="blas-2"),
        pytest.param((), 0, id="unset"),
    ],
)
def test_every_product_has_the_bits_of_one_thread(folder, of_one_thread, names, number):
    """More threads than cores are cut to the cores by OpenBLAS; any number above 1 showed the fault."""
    same(made(folder, names, number), of_one_thread)


def same(found, expected):
    assert len(found) > 40 and found.keys() == expected.keys()
    assert [name for name in found if found[name] != expected[name]] == []


def test_each_stage_writes_the_bits_of_one_thread_on_one_thread(folder, of_one_thread, monkeypatch, several):
    """Seen from within, too, at each write: small campaigns have few sums that are long enough to be cut in threads."""
    seen, flush, stage = {}, atomic._flush, None

    def noted(path):
        seen.setdefault(stage, set()).update(threads()[library] for library in several)
        flush(path)

    sky, lamps = all_products.science(folder / "sky"), all_products.exposures(folder / "lamps")
    monkeypatch.setattr(atomic, "_flush", noted)
    with redirect_stdout(StringIO()):
        for stage, call in (*all_products.chain(sky), *all_products.calibration_chain(lamps)):
            call()
            assert threads() | several == threads(), f"{stage} keeps the threads of its caller"
    found = all_products.digests(sky) | all_products.digests(lamps)
    empty(folder)
    assert seen == {stage: {1} for stage in STAGES}
    same(found, of_one_thread)


def test_no_stage_is_left_out():
    """A new one belongs into all_products.chain and into STAGES."""
    assert {*SECTIONS["Stages of the workflow, one job each"], "chip", "report"} == STAGES


def test_what_is_made_in_memory_is_made_on_one_thread(tmp_path, monkeypatch, several):
    """Simulation.chip and light, and the PSF they make first."""
    from csstsim.api import Simulation
    from csstsim.layers import gain, scie_obs

    seen = []
    for module in (gain, scie_obs):
        apply = module.apply
        monkeypatch.setattr(
            module, "apply", lambda *given, apply=apply: seen.append(set(threads().values())) or apply(*given)
        )
    run = all_products.science(tmp_path / "sky", catalog={"kind": "support.mini_campaign:Stars", "options": {
        "ra": [60.0], "dec": [-40.0], "mag": [20.0]}})  # fmt: skip
    sim = Simulation(run.file, cache=tmp_path / "cache")
    sim.chip(run.jobs[0].obsid, 9)
    sim.light(run.jobs[0].obsid, 9)
    assert seen == [{1}, {1}, {1}]


def test_threads_are_given_back(several):
    """After an error, by the outermost of those within each other, and by the last of those side by side."""
    with pytest.raises(ZeroDivisionError), one_thread:
        1 / 0  # noqa: B018
    assert threads() == several
    with one_thread:
        with one_thread:
            pass
        assert set(threads().values()) == {1}
    assert threads() == several
    inside, leave = threading.Event(), threading.Event()

    @one_thread
    def other():
        inside.set()
        leave.wait(10)
        return set(threads().values())

    found = []
    thread = threading.Thread(target=lambda: found.append(other()))
    with one_thread:
        thread.start()
        assert inside.wait(10)
    assert set(threads().values()) == {1}, "another thread still works"
    leave.set()
    thread.join()
    assert found == [{1}] and threads() == several
