"""The set of mutations fits the source: each old text occurs once, the new one is Python, and tests exist."""

import subprocess
import sys
from pathlib import Path

import pytest

sys.path.append(str(Path(__file__).parent))
from code_graph import CodeGraph
from entries import PACKAGE, ROOT, load

LEAST = 220  # mutations, of all folders of the package


@pytest.fixture(scope="module")
def mutations():
    return load()


def test_each_entry_can_be_made(mutations):
    faults = [f"{m.file}: {m.what}: {fault}" for m in mutations if (fault := m.fault())]
    assert not faults


def test_entries_have_names_of_their_own_in_their_folders(mutations):
    names = [(m.file, m.what) for m in mutations]
    assert len(names) == len(set(names)) >= LEAST
    assert all(m.folder == m.file.split("/")[0] for m in mutations)


@pytest.mark.thorough
def test_a_fault_in_the_copy_reaches_the_tests(tmp_path):
    """Of a fault that tests see: the processes import the copy, not the installed package."""
    words = ["--folder", "base", "--match", "a word's key is mixed in once", "--scratch", str(tmp_path)]
    run = [sys.executable, str(Path(__file__).parent / "run.py"), *words]
    made = subprocess.run(run, capture_output=True, text=True, check=False)
    assert made.returncode == 0 and "| base | 1 | 1 | 100% |" in made.stdout, made.stdout + made.stderr


def test_the_graph_knows_who_holds_a_copy_of_a_function():
    graph = CodeGraph(ROOT / PACKAGE)
    users = graph.users({("csstsim.base.counter", "word")})
    assert {
        ("csstsim.render.photon_positions", "from_psf"),
        ("csstsim.detector.charge_transfer.serial", "_transfer_rows"),
    } <= users
    assert ("csstsim.render.imaging.photons", "_shoot") in users  # by way of others
    assert ("csstsim.render.imaging.unresolved", "_scatter") not in users
    assert ("csstsim.render.photon_positions", "from_wing") in graph.users(
        {("csstsim.catalog.profiles.log_table", "BITS")}
    )  # a constant
