"""A copy of the tree, warm caches, and one process for each mutant.

numba and Python recognise a fresh compiled file by the source's time and size. So in the copy each module ends in a
comment as padding, a mutant has the size and the time of the original, and the files that the mutation makes stale are
deleted by name (code_graph): only those are compiled again. Libraries are imported once, in the process that others are
forked from.
"""

import gc
import importlib.util
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

from code_graph import CodeGraph, forget
from entries import PACKAGE

_ROOM = 400  # bytes at a module's end
_LIMIT = 60.0, 6.0  # s, and times what the tests take without a fault: longer is a mutant that hangs, caught
SELECTED = "not slow and not slurm and not faults"  # thorough ones, too
_LIBRARIES = (
    "pytest", "hypothesis", "scipy.fft", "scipy.interpolate", "scipy.ndimage", "scipy.optimize", "scipy.stats",
    "scipy.special", "scipy.signal", "numba", "astropy.io.fits", "astropy.wcs", "astropy.table", "astropy.units",
    "astropy.coordinates", "astropy.io.ascii", "galsim", "pydantic", "yaml", "h5py", "fitsio", "pyarrow.parquet",
    "click", "sep", "healpy", "hpgeom", "erfa", "matplotlib.pyplot", "rich.table", "PIL.Image",
)  # fmt: skip


class Bench:
    """Runs mutations in a scratch folder; `results` are those known, {name: {caught, seconds, by}}."""

    def __init__(self, root, scratch):
        self.root, self.scratch, self.tree = root, scratch, scratch / "tree"
        self.warm, self.cache = scratch / "warm", scratch / "cache"
        for folder in (self.tree, self.warm, self.cache):
            folder.mkdir(parents=True, exist_ok=True)
        self._file = scratch / "results.json"
        self.results = json.loads(self._file.read_text()) if self._file.exists() else {}
        self._base = {}
        self.graph = CodeGraph(root / PACKAGE)
        changed = self._copy()
        stale = set().union(*(self.graph.all_names(_module(name)) for name in changed))
        forget(self.warm, self.graph.users(stale))
        os.environ |= {
            "NUMBA_CACHE_DIR": str(self.cache), "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1",
            "MPLBACKEND": "agg", "PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1",
            "PYTHONPATH": f"{self.tree / 'src'}:{self.tree / 'tests'}:{self.tree / 'builders'}",
        }  # fmt: skip
        os.environ["PATH"] = f"{Path(sys.executable).parent}:{os.environ['PATH']}"
        os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
        sys.dont_write_bytecode = False
        signal.signal(signal.SIGTERM, lambda *_: sys.exit(1))
        for name in _LIBRARIES:
            __import__(name)
        _wake_numba()

    def _copy(self):
        """Bring the copy up to date; return the modules that changed, as paths."""
        listed = subprocess.run(
            ["git", "ls-files", "-co", "--exclude-standard"], cwd=self.root, capture_output=True, check=True, text=True
        )
        changed, names = [], set(listed.stdout.split("\n")) - {""}
        for name in sorted(names):
            source, copy = self.root / name, self.tree / name
            if not source.is_file():
                continue
            content = source.read_bytes()
            if source.is_relative_to(self.root / PACKAGE) and source.suffix == ".py":
                content = _roomy(content, len(content) + _ROOM)
            if not copy.exists() or copy.read_bytes() != content:
                copy.parent.mkdir(parents=True, exist_ok=True)
                copy.write_bytes(content)
                changed.append(name)
        for copy in (self.tree / PACKAGE).rglob("*.py"):
            if str(copy.relative_to(self.tree)) not in names:
                copy.unlink()
        if not (self.tree / ".git").exists():
            subprocess.run(["git", "init", "-q"], cwd=self.tree, check=True)
        return [name for name in changed if name.startswith(str(PACKAGE)) and name.endswith(".py")]

    def run(self, mutations, which="new", whole=False):
        """Run mutations and keep their results. which: new, survivors or all; whole: all tests of their folders."""
        for mutation in mutations:
            known = self.results.get(mutation.name)
            if not {"new": known is None, "survivors": known and not known["caught"], "all": True}[which]:
                continue
            tests = (mutation.folder,) if whole and "/" in mutation.file else mutation.tests
            limit = _LIMIT[0] + _LIMIT[1] * self._baseline(tests)
            start = time.monotonic()
            ended, said = self._mutant(mutation, tests, limit)
            caught, seconds = ended != 0, round(time.monotonic() - start, 1)
            self.results[mutation.name] = {"caught": caught, "seconds": seconds, "by": said}
            self._file.write_text(json.dumps(self.results, indent=1))
            print(f"{'caught  ' if caught else 'SURVIVES'} {seconds:6.1f} s  {mutation.name}  [{said}]", flush=True)

    def _baseline(self, tests):
        """Return the seconds tests take without a fault, which they must pass; compiles what they need."""
        if tests not in self._base:
            start = time.monotonic()
            ended, said = self._pytest(tests, 1800.0, self.warm)
            if ended:
                raise SystemExit(f"{' '.join(tests)} fail without a fault: {said}")
            self._base[tests] = time.monotonic() - start
        return self._base[tests]

    def _mutant(self, mutation, tests, limit):
        path = self.tree / PACKAGE / mutation.file
        original, stamp, compiled = path.read_bytes(), path.stat(), Path(importlib.util.cache_from_source(str(path)))
        text = original[:-_ROOM].decode()
        line = text[: text.index(mutation.old)].count("\n") + 1
        names = self.graph.names_at(mutation.module, line, line + mutation.old.count("\n"))
        aside = compiled.with_suffix(".aside")
        shutil.rmtree(self.cache)
        shutil.copytree(self.warm, self.cache, copy_function=os.link)
        forget(self.cache, self.graph.users(names))
        if compiled.exists():
            compiled.rename(aside)
        try:
            path.write_bytes(_roomy(text.replace(mutation.old, mutation.new).encode(), len(original)))
            os.utime(path, ns=(stamp.st_atime_ns, stamp.st_mtime_ns))
            return self._pytest(tests, limit, None)
        finally:
            path.write_bytes(original)
            os.utime(path, ns=(stamp.st_atime_ns, stamp.st_mtime_ns))
            compiled.unlink(missing_ok=True)
            if aside.exists():
                aside.rename(compiled)

    def _pytest(self, tests, limit, warm):
        """Run tests in a process; return (exit code, the first failure). warm: the cache to work on, or None."""
        if warm:
            shutil.rmtree(self.cache)
            shutil.copytree(warm, self.cache, copy_function=os.link)
        log = self.scratch / "log"
        child = os.fork()
        if child == 0:
            os.setsid()
            signal.signal(signal.SIGTERM, signal.SIG_DFL)
            os.chdir(self.tree)
            out = os.open(log, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
            os.dup2(out, 1)
            os.dup2(out, 2)
            sys.path[:0] = [str(self.tree / "src"), str(self.tree / "tests")]
            if not warm:
                os.environ["PYTHONDONTWRITEBYTECODE"] = "1"
                sys.dont_write_bytecode = True
            import pytest

            files = [str(self.tree / "tests" / name) for name in tests]
            base = self.scratch / "tmp"
            options = ["-x", "-q", "--tb=line", "--assert=plain", "-p", "no:cacheprovider", f"--basetemp={base}"]
            code = pytest.main([*options, "-m", SELECTED, *files])
            sys.stdout.flush()
            os._exit(int(code))
        code = _wait(child, limit)
        if warm:
            shutil.rmtree(warm)
            shutil.copytree(self.cache, warm, copy_function=os.link)
        lines = log.read_text(errors="replace").splitlines()
        said = [line for line in lines if line.startswith(("FAILED", "ERROR"))]
        last = said[0].split(" - ")[0] if said else (lines[-1] if lines else "")
        return code, f"time limit of {limit:.0f} s" if code == -1 else last[:160]


def _wake_numba():
    """Compile something, so that what numba sets up on its first use is there in each process.

    numba then imports the installed csstsim (entry point `numba_extensions`). It is removed: each process imports the
    copy with the fault.
    """
    import numba
    import numpy as np

    numba.njit(lambda a: np.sqrt(a).sum() + np.searchsorted(a, 0.5))(np.ones(3))
    for name in [name for name in sys.modules if name.partition(".")[0] == "csstsim"]:
        del sys.modules[name]
    gc.freeze()


def _wait(child, limit):
    end, ended = time.monotonic() + limit, 0
    try:
        while time.monotonic() < end:
            ended, status = os.waitpid(child, os.WNOHANG)
            if ended:
                return os.waitstatus_to_exitcode(status)
            time.sleep(0.05)
        return -1
    finally:
        if not ended:
            os.killpg(child, signal.SIGKILL)
            os.waitpid(child, 0)


def _roomy(content, size):
    """Return a module's text with a comment at its end that makes it `size` bytes."""
    return content + b"#" + b"." * (size - len(content) - 2) + b"\n"


def _module(name):
    parts = Path(name).relative_to(PACKAGE.parent).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)
