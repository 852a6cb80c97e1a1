"""`make`'s set-up killed half-way and started again: the real Makefile, with packages made here for the index's."""

import os
import shutil
import signal
import subprocess
import sys
import time
import zipfile

import pytest
from support.workflow_run import ROOT

pytestmark = pytest.mark.faults
BACKEND = """
import zipfile

def build_editable(folder, settings=None, metadata=None):
    with zipfile.ZipFile(f"{folder}/ours-1.0-py3-none-any.whl", "w") as wheel:
        wheel.writestr("ours-1.0.dist-info/METADATA", "Metadata-Version: 2.1\\nName: ours\\nVersion: 1.0\\n")
        wheel.writestr("ours-1.0.dist-info/WHEEL", "Wheel-Version: 1.0\\nRoot-Is-Purelib: true\\nTag: py3-none-any\\n")
        wheel.writestr("ours-1.0.dist-info/RECORD", "")
    return "ours-1.0-py3-none-any.whl"
"""
PROJECT = """[build-system]
requires = []
build-backend = "backend"
backend-path = ["."]
"""
SLOW_TO_COMPILE = "VALUES = [" + "(1, 'a', x, y + 2)," * 150_000 + "]\n"  # as scipy: seconds


def wheel(folder, name, version, module, script=None):
    """Write a wheel of one module, with a program if asked for."""
    about = f"{name}-{version}.dist-info"
    with zipfile.ZipFile(folder / f"{name}-{version}-py3-none-any.whl", "w", zipfile.ZIP_DEFLATED) as file:
        file.writestr(f"{name}.py", module)
        file.writestr(f"{about}/WHEEL", "Wheel-Version: 1.0\nRoot-Is-Purelib: true\nTag: py3-none-any\n")
        if script:
            file.writestr(f"{about}/entry_points.txt", f"[console_scripts]\n{script} = {name}:main\n")
        file.writestr(f"{about}/METADATA", f"Metadata-Version: 2.1\nName: {name}\nVersion: {version}\n")
        file.writestr(f"{about}/RECORD", "")


@pytest.fixture
def project(tmp_path):
    """A folder with the Makefile, a list of one package, and the packages."""
    wheels = tmp_path / "wheels"
    wheels.mkdir()
    (tmp_path / "src").mkdir()
    wheel(wheels, "tool", "1.0", f"def main():\n    print('works')\n\ndef unused(x, y):\n    {SLOW_TO_COMPILE}", "tool")
    wheel(wheels, "grismagic", "0.1.1", "")
    shutil.copy(ROOT / "Makefile", tmp_path)
    (tmp_path / "requirements.lock").write_text("tool==1.0\n")
    (tmp_path / "pyproject.toml").write_text(PROJECT)
    (tmp_path / "backend.py").write_text(BACKEND)
    return tmp_path


def make(project):
    """Start `make .venv/ready` in a process group of its own."""
    environment = os.environ | {"PIP_NO_INDEX": "1", "PIP_FIND_LINKS": str(project / "wheels"), "PYTHONPATH": ""}
    with open(project / "said.txt", "w") as said:
        line = ["make", ".venv/ready", f"PYTHON={sys._base_executable}"]
        return subprocess.Popen(line, cwd=project, env=environment, stdout=said, stderr=said, start_new_session=True)


def killed_when(project, there, missing):
    """Start make; kill it and all it started when a file that `there` matches is there, and none of `missing`."""
    process, end = make(project), time.monotonic() + 240
    while not list(project.glob(there)):
        assert process.poll() is None and time.monotonic() < end, (project / "said.txt").read_text()
        time.sleep(0.005)
    os.killpg(process.pid, signal.SIGKILL)
    process.wait()
    assert not list(project.glob(missing)), "killed too late to tell anything"
    assert not (project / ".venv/ready").exists()


@pytest.mark.skipif(not shutil.which("make"), reason="no make")
def test_interrupted_installation(project, tell):
    killed_when(project, ".venv/bin/python3", ".venv/bin/pip")
    killed_when(project, ".venv/lib/*/site-packages/tool-1.0.dist-info/METADATA", ".venv/bin/tool")
    assert make(project).wait(timeout=240) == 0, (project / "said.txt").read_text()
    done = subprocess.run([project / ".venv/bin/tool"], capture_output=True, text=True, timeout=60, check=True)
    assert done.stdout == "works\n" and "cut short" in (project / "said.txt").read_text()
    assert (project / ".venv/ready").exists() and not (project / ".venv/unfinished").exists()
    moments = "while the environment is made; between a package's files and its programs"
    tell("set-up interrupted (kill -9 of make)", moments, "the next make says so and starts again")
