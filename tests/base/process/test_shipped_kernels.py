"""Compiled code that comes with the package: taken where it fits, and nowhere else."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from csstsim.base.process.shipped_kernels import FEATURES, PROCESSOR, shipped_folder
from csstsim.base.shipped import ROOT

HELPER = "FACTOR = 2.0\n"
KERNEL = """
import numba
from pack.helper import FACTOR
@numba.njit(cache=True)
def total(values):
    out = 0.0
    for value in values:
        out += FACTOR * value
    return out
"""
START = """
import sys, numpy as np
import csstsim.base.process.shipped_kernels as shipped
shipped.PACKAGE = sys.argv[1] + "/pack"
from csstsim.base.process.compiled_cache import init
init()
from pack.kernel import total
value = total(np.full(1000, 0.1))
"""
CALL = START + "print(value.hex(), sum(total.stats.cache_misses.values()))"
BUILD = START + "from pathlib import Path\nfrom builders.build_kernels import store\nprint(store(Path(sys.argv[2])))"


def run(folder, program, *words, **variables):
    """Return what a program prints whose package `pack` is in the folder."""
    path = os.pathsep.join([str(folder), str(ROOT), *sys.path])
    environment = os.environ | {"PYTHONPATH": path, "NUMBA_CACHE_DIR": str(folder / "here")} | variables
    environment["PYTHONDONTWRITEBYTECODE"] = "1"  # which Python takes for that of a source by its time
    done = subprocess.run(
        [sys.executable, "-c", program, folder, *words], env=environment, text=True, capture_output=True, check=False
    )
    assert done.returncode == 0, done.stderr
    return done.stdout.split()


@pytest.fixture
def package(tmp_path):
    """A folder with a package, and `kernels`: its code as it is compiled for the shipped processor."""
    (tmp_path / "pack").mkdir()
    for name, text in {"__init__": "", "helper": HELPER, "kernel": KERNEL}.items():
        (tmp_path / "pack" / f"{name}.py").write_text(text)
    other = {"NUMBA_CACHE_DIR": str(tmp_path / "there"), "NUMBA_CPU_NAME": PROCESSOR, "NUMBA_CPU_FEATURES": ""}
    (tmp_path / "kernels").mkdir()
    assert run(tmp_path, BUILD, tmp_path / "kernels", CSSTSIM_KERNELS="", **other) == ["1"]
    return tmp_path


def called(folder, kernels=None):
    """Return (value, functions that were compiled) in a process with the folder's shipped code."""
    value, misses = run(folder, CALL, CSSTSIM_KERNELS=str(folder / "kernels") if kernels is None else kernels)
    return value, int(misses)


def test_nothing_is_compiled_where_it_fits_and_the_bits_are_those_of_code_compiled_here(package):
    value, misses = called(package)
    assert misses == 0 and not list((package / "here").rglob("*.nbc"))
    assert called(package, kernels="") == (value, 1)


def test_what_was_compiled_here_comes_first(package):
    value, _ = called(package, kernels="")
    for file in (package / "kernels").rglob("*.nbc"):
        file.unlink()
    assert called(package) == (value, 0)


@pytest.mark.parametrize("name", ["Python", "numba", "llvmlite", "machine", "features", "target"])
def test_code_for_another_machine_or_version_is_compiled_here(package, name):
    path = package / "kernels" / "about.json"
    about = json.loads(path.read_text())
    assert about["features"] == list(FEATURES) and about["target"][1:] == [PROCESSOR, ""]
    if name in about["versions"]:
        about["versions"][name] += "0"
    else:
        about[name] = ["no such feature"] if name == "features" else ["another", PROCESSOR, ""]
    path.write_text(json.dumps(about))
    assert called(package)[1] == 1


@pytest.mark.parametrize("name", ["helper", "kernel"])
def test_code_of_another_source_is_compiled_here(package, name):
    """Of the same length and time: only the content tells."""
    file = package / "pack" / f"{name}.py"
    before = file.stat()
    file.write_text(file.read_text().replace("2.0", "4.0").replace("0.0", "9.0"))
    os.utime(file, ns=(before.st_atime_ns, before.st_mtime_ns))
    expected = sum([0.1 * 4.0] * 1000) if name == "helper" else 9.0 + sum([0.1 * 2.0] * 1000)
    value, misses = called(package)
    assert misses == 1 and float.fromhex(value) == pytest.approx(expected, rel=1e-12)


def test_sources_of_others_have_no_code_in_the_package():
    from csstsim.base.process import shipped_kernels

    package = Path(shipped_kernels.PACKAGE)
    assert shipped_folder(str(package / "measure" / "light" / "moments.py"), "x") == "x/measure/light"
    assert shipped_folder(str(package.parent / "mine.py"), "x") is None
