"""The sources that a module reaches: a change of any of them is seen, and of no other."""

import ast
import math
import os
import subprocess
import sys
import time
from pathlib import Path

import pytest

import csstsim
from csstsim.base.process import reached_sources
from csstsim.base.process.reached_sources import sources_digest

FILES = {
    "pack/__init__.py": "",
    "pack/kernel.py": "import math\nfrom pack.inner import helper as h, other\n"
    "from pack.wide import (\n    A,\n    B,\n)\n"
    "if TYPE_CHECKING:\n    from pack.types import T\n\nif True:\n    from pack import unused\n"
    "def f():\n    import pack.late\n",
    "pack/inner/__init__.py": "",
    "pack/inner/helper.py": "import pack.deep\n",
    "pack/inner/other.py": "",
    "pack/wide.py": "A = B = 1\n",
    # a circle; what it needs for types alone
    "pack/deep.py": "from pack.kernel import f\nif TYPE_CHECKING:\n    from pack.others import T\n",
    "pack/types.py": "from pack.nested import N\n",
    "pack/nested.py": "",
    "pack/others.py": "",
    "pack/unused.py": "",
    "pack/late.py": "",
    "package/__init__.py": "",  # its name begins like pack's
}
NOT_REACHED = "pack/__init__.py", "pack/unused.py", "pack/late.py", "pack/others.py", "package/__init__.py"


@pytest.fixture(autouse=True)
def begun_later(monkeypatch):
    """All sources are older than the process."""
    monkeypatch.setattr(reached_sources, "_start", math.inf)


@pytest.fixture
def pack(tmp_path):
    for name, text in FILES.items():
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text(text)
    return tmp_path


def digest(folder):
    reached_sources._source.cache_clear()
    sources_digest.cache_clear()
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


def test_a_source_that_changed_since_the_process_began_is_nobody_elses(pack, monkeypatch):
    """The process may have imported what was there before."""
    changed = pack / "pack" / "nested.py"
    monkeypatch.setattr(reached_sources, "_start", changed.stat().st_mtime + 1)
    before = digest(pack)
    assert digest(pack) == before
    os.utime(changed, (0, changed.stat().st_mtime + 2))
    assert digest(pack) != digest(pack)


def imported(body, known):
    """Return the files of the imports among statements, as Python reads them."""
    found = set()
    for node in body:
        names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
        if isinstance(node, ast.ImportFrom):
            assert node.level == 0
            names = [node.module, *(f"{node.module}.{alias.name}" for alias in node.names)]
        found |= {known[name] for name in names if name in known}
    return found


def test_imports_of_every_source_are_found():
    folder = Path(csstsim.__file__).parent
    known = {}
    for path in folder.rglob("*.py"):
        parts = path.relative_to(folder.parent).with_suffix("").parts
        known[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = str(path)
    some = 0
    for path in known.values():
        body = ast.parse(Path(path).read_text()).body
        types = [part for node in body if isinstance(node, ast.If) for part in node.body]
        source = reached_sources._Source(path)
        assert source.imports == imported(body, known), path
        assert source.types == imported(types, known), path
        some += len(source.types)
    assert some > 100


KERNELS = {
    "pack/__init__.py": "",
    "pack/inner.py": "import numba\nSTEP = 1\n@numba.njit(cache=True)\ndef inner(x):\n    return x + {step}\n",
    "pack/constant.py": "FACTOR = {factor}\n",
    "pack/outer.py": "import numba\nfrom pack.constant import FACTOR\nfrom pack.inner import inner\n"
    "@numba.njit(cache=True)\ndef outer(x):\n    return FACTOR * inner(x)\n",
}
CALL = "from pack.outer import outer; print(outer(1.0), sum(outer.stats.cache_misses.values()))"


def called(folder, step, factor, init=True, call=CALL):
    """Return what a process prints that calls the kernel; Python itself sees a change by the length of a file.

    step: None if the files stay as they are.
    """
    for name, text in KERNELS.items() if step is not None else ():
        (folder / name).parent.mkdir(exist_ok=True)
        (folder / name).write_text(text.format(step=step, factor=factor))
    off = "import numba.core.entrypoints as e; e._already_initialized = True; "
    on = "from csstsim.base.process.compiled_cache import init; init(); " if init else ""
    variables = os.environ | {"PYTHONPATH": os.pathsep.join([str(folder), *sys.path]), "NUMBA_CACHE_DIR": str(folder)}
    return subprocess.run(
        [sys.executable, "-c", off + on + call], env=variables, text=True, capture_output=True, check=True
    ).stdout.split()


def test_code_is_compiled_again_if_what_it_uses_changed_in_another_file(tmp_path):
    assert called(tmp_path, 1, 10) == ["20.0", "1"]
    assert called(tmp_path, 1, 10) == ["20.0", "0"]
    assert called(tmp_path, 22, 10) == ["230.0", "1"]  # a function of another file
    assert called(tmp_path, 22, 100) == ["2300.0", "1"]  # a constant of another file
    assert called(tmp_path, 22, 100) == ["2300.0", "0"]


EDITED = """
import os, time
import pack.inner, pack.outer
text = open(pack.inner.__file__).read().replace("STEP = 1", "STEP = 1  # edited").replace("x + 1", "x + 30")
open(pack.inner.__file__, "w").write(text)
os.utime(pack.inner.__file__, (time.time() + 5,) * 2)
print(pack.outer.outer(1.0))
"""


def test_code_of_a_source_that_was_edited_after_its_import_is_not_kept_for_the_new_one(tmp_path):
    assert called(tmp_path, 1, 10)[0] == "20.0"
    for file in tmp_path.rglob("*.nb?"):
        file.unlink()
    assert called(tmp_path, 1, 10, call=EDITED)[0] == "20.0"
    assert called(tmp_path, None, 10)[0] == "310.0"


LATE = "import pack.outer; from csstsim.base.process.compiled_cache import init; init(); "


def test_code_has_one_stamp_whether_numba_was_changed_before_or_after_the_import(tmp_path):
    """numba calls `init` when it first compiles: a process has imported some kernels before, and others not."""
    assert called(tmp_path, 1, 10, init=False, call=LATE + CALL) == ["20.0", "1"]
    assert called(tmp_path, None, 10) == ["20.0", "0"]
    assert called(tmp_path, None, 10, init=False, call=LATE + CALL) == ["20.0", "0"]


def test_a_process_knows_when_it_began():
    before = time.time()
    program = "import time; time.sleep(0.7); from csstsim.base.process import reached_sources as r; print(r._start)"
    done = subprocess.run([sys.executable, "-c", program], text=True, capture_output=True, check=True)
    assert before - 0.05 < float(done.stdout) < before + 0.5


def test_numba_itself_would_use_the_old_code(tmp_path):
    """If this fails, numba looks at what a function uses, and the module is not needed any more."""
    assert called(tmp_path, 1, 10, init=False)[0] == "20.0"
    assert called(tmp_path, 22, 100, init=False)[0] == "20.0"
