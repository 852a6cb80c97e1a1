"""The sources that a module reaches by its imports, as one digest: code compiled from others is not this module's.

numba compiles the functions and constants that a function uses into it, but looks at the function's own file alone to
see whether stored code is of today's source. A change of a function in another file would leave it as it was.

Imports are absolute in csstsim: relative ones are not followed. tests/base/process compare what is found with Python's
own reading of every source.
"""

from __future__ import annotations

import hashlib
import os
import re
import time
from functools import cache

_IMPORT = rb"(?:from|import) +([\w.]+)(?: +import +(\([^)]*\)|[^\n#]*))?"
_TOP_LEVEL = re.compile(rb"^" + _IMPORT, re.MULTILINE)
# Where the types of a kernel's arguments come from: its code knows the fields of named tuples by their place
_TYPES = re.compile(rb"^if TYPE_CHECKING:[^\n]*\n((?:[ \t]+[^\n]*\n|\n)+)", re.MULTILINE)
_INDENTED = re.compile(rb"^[ \t]+" + _IMPORT, re.MULTILINE)
_NAME = re.compile(rb"(\w+)(?: +as +\w+)?")


def _process_start() -> float:
    """Return when this process began [s since the epoch]; now, if the system does not tell."""
    try:
        with open("/proc/self/stat") as stream:
            ticks = int(stream.read().rpartition(")")[2].split()[19])  # since the machine began; man proc_pid_stat
        ticks += 2  # 0.02 s: they are rounded, and the interpreter imports nothing of ours sooner
        age = time.clock_gettime(time.CLOCK_BOOTTIME) - ticks / os.sysconf("SC_CLK_TCK")
    except (OSError, ValueError, AttributeError, IndexError):
        age = 0.0
    return time.time() - age


_start = _process_start()


@cache
def sources_digest(file: str) -> str:
    """Return the digest of a source file and of all that it reaches by imports within its package, at any depth.

    Of imports for types alone, those of the file itself count. A source that changed since the process began may be
    another one than the process has imported: the digest is then one that no other process has.
    """
    reached = {os.path.abspath(file)}
    todo = list(reached)
    for path in _source(todo[0]).types - reached:
        reached.add(path)
        todo.append(path)
    while todo:
        new = _source(todo.pop()).imports - reached
        reached |= new
        todo += new
    digest = hashlib.sha256()
    for path in sorted(reached):
        digest.update(_source(path).digest)
    return digest.hexdigest()


class _Source:
    """A source file: the digest of its content, and the files of its package that it imports, for use and for types."""

    def __init__(self, file: str) -> None:
        with open(file, "rb") as stream:
            changed = os.stat(stream.fileno()).st_mtime > _start
            content = stream.read()
        self.digest = os.urandom(32) if changed else hashlib.sha256(content).digest()
        root, package = _top(file)
        blocks = _TYPES.findall(content)
        self.imports = _reached(root, package, _TOP_LEVEL.findall(content))
        self.types = _reached(root, package, [found for block in blocks for found in _INDENTED.findall(block)])


_source = cache(_Source)


def _top(file: str) -> tuple[str, str]:
    """Return (folder that contains the top-level package of a source file, name of the package)."""
    folder = os.path.dirname(file)
    name = ""
    while os.path.exists(os.path.join(folder, "__init__.py")):
        folder, name = os.path.split(folder)
    return folder, name


def _reached(root: str, package: str, found: list[tuple[bytes, bytes]]) -> set[str]:
    """Return the files of imports (module, names) that belong to the package."""
    return {
        path
        for module, names in found
        if module.decode().split(".")[0] == package
        for path in _files(root, module.decode(), [name.decode() for name in _NAME.findall(names)])
    }


def _files(root: str, module: str, names: list[str]) -> list[str]:
    """Return the existing files of a module and, if it is a package, of those of `names` that are its modules."""
    path = os.path.join(root, *module.split("."))
    candidates = [f"{path}.py", os.path.join(path, "__init__.py")]
    for name in names:
        candidates += [os.path.join(path, f"{name}.py"), os.path.join(path, name, "__init__.py")]
    return [candidate for candidate in candidates if os.path.isfile(candidate)]
