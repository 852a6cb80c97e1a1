"""The sources that a module reaches: a change of any of them is seen, and of no other."""

import os
import subprocess
import sys

import pytest

from csstsim.base.process import reached_sources
from csstsim.base.process.reached_sources import sources_digest

FILES = {
    "pack/__init__.py": "",
    "pack/kernel.py": "import math\nfrom pack.inner import helper as h, other\n"
    "from pack.wide import (\n    A,\n    B,\n)\n"
    "if True:\n    from pack import unused\ndef f():\n    import pack.late\n",
    "pack/inner/__init__.py": "",
    "pack/inner/helper.py": "import pack.deep\n",
    "pack/inner/other.py": "",
    "pack/wide.py": "A = B = 1\n",
    "pack/deep.py": "from pack.kernel import f\n",  # a circle
    "pack/unused.py": "",
    "pack/late.py": "",
    "package/__init__.py": "",  # its name begins like pack's
}
NOT_REACHED = "pack/__init__.py", "pack/unused.py", "pack/late.py", "package/__init__.py"


@pytest.fixture
def pack(tmp_path):
    for name, text in FILES.items():
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text(text)
    return tmp_path


def digest(folder):
    reached_sources._source.cache_clear()
    return sources_digest(str(folder / "pack" / "kernel.py"))


@pytest.mark.parametrize("name", FILES)
def test_a_change_of_a_reached_file_changes_the_digest(pack, name):
    before = digest(pack)
    assert digest(pack) == before
    (pack / name).write_text(FILES[name] + "# changed\n")
    assert (digest(pack) != before) == (name not in NOT_REACHED)


def test_the_digest_does_not_depend_on_the_folder(pack, tmp_path_factory):
    before = digest(pack)
    moved = tmp_path_factory.mktemp("moved") / "there"
    pack.rename(moved)
    assert digest(moved) == before


def test_a_file_without_a_package_is_its_own(tmp_path):
    (tmp_path / "pack").mkdir()
    (tmp_path / "pack" / "kernel.py").write_text("import numpy\nfrom csstsim.base import counter\n")
    before = digest(tmp_path)
    (tmp_path / "pack" / "kernel.py").write_text("import numpy\n")
    assert digest(tmp_path) != before


KERNELS = {
    "pack/__init__.py": "",
    "pack/inner.py": "import numba\nSTEP = 1\n@numba.njit(cache=True)\ndef inner(x):\n    return x + {step}\n",
    "pack/constant.py": "FACTOR = {factor}\n",
    "pack/outer.py": "import numba\nfrom pack.constant import FACTOR\nfrom pack.inner import inner\n"
    "@numba.njit(cache=True)\ndef outer(x):\n    return FACTOR * inner(x)\n",
}
CALL = "from pack.outer import outer; print(outer(1.0), sum(outer.stats.cache_misses.values()))"


def called(folder, step, factor, init=True):
    """Return what a process prints that calls the kernel; Python itself sees a change by the length of a file."""
    for name, text in KERNELS.items():
        (folder / name).parent.mkdir(exist_ok=True)
        (folder / name).write_text(text.format(step=step, factor=factor))
    off = "import numba.core.entrypoints as e; e._already_initialized = True; "
    on = "from csstsim.base.process.compiled_cache import init; init(); " if init else ""
    variables = os.environ | {"PYTHONPATH": os.pathsep.join([str(folder), *sys.path]), "NUMBA_CACHE_DIR": str(folder)}
    return subprocess.run(
        [sys.executable, "-c", off + on + CALL], env=variables, text=True, capture_output=True, check=True
    ).stdout.split()


def test_code_is_compiled_again_if_what_it_uses_changed_in_another_file(tmp_path):
    assert called(tmp_path, 1, 10) == ["20.0", "1"]
    assert called(tmp_path, 1, 10) == ["20.0", "0"]
    assert called(tmp_path, 22, 10) == ["230.0", "1"]  # a function of another file
    assert called(tmp_path, 22, 100) == ["2300.0", "1"]  # a constant of another file
    assert called(tmp_path, 22, 100) == ["2300.0", "0"]


def test_numba_itself_would_use_the_old_code(tmp_path):
    """If this fails, numba looks at what a function uses, and the module is not needed any more."""
    assert called(tmp_path, 1, 10, init=False)[0] == "20.0"
    assert called(tmp_path, 22, 100, init=False)[0] == "20.0"
