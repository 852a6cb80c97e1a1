"""The sources that a module reaches by its imports, as one digest: code compiled from others is not this module's.

numba compiles the functions and constants that a function uses into it, but looks at the function's own file alone to
see whether stored code is of today's source. A change of a function in another file would leave it as it was.
"""

from __future__ import annotations

import hashlib
import os
import re
from functools import cache

# An import at the top level of a module. Those below a condition or in a function give nothing to compiled code
_IMPORT = re.compile(rb"^(?:from|import) +([\w.]+)(?: +import +(\([^)]*\)|[^\n#]*))?", re.MULTILINE)
_NAME = re.compile(rb"(\w+)(?: +as +\w+)?")


def sources_digest(file: str) -> str:
    """Return the digest of a source file and of all that it reaches by imports within its package, at any depth."""
    reached = {os.path.abspath(file)}
    todo = list(reached)
    while todo:
        new = set(_source(todo.pop()).imports) - reached
        reached |= new
        todo += new
    digest = hashlib.sha256()
    for path in sorted(reached):
        digest.update(_source(path).digest)
    return digest.hexdigest()


class _Source:
    """A source file: the digest of its content, and the files of its package that it imports at its top level."""

    def __init__(self, file: str) -> None:
        with open(file, "rb") as stream:
            content = stream.read()
        self.digest = hashlib.sha256(content).digest()
        root, package = _top(file)
        start = package.encode()
        self.imports = {
            path
            for module, names in _IMPORT.findall(content)
            if module == start or module.startswith(start + b".")
            for path in _files(root, module.decode(), [name.decode() for name in _NAME.findall(names)])
        }


_source = cache(_Source)


def _top(file: str) -> tuple[str, str]:
    """Return (folder that contains the top-level package of a source file, name of the package)."""
    folder = os.path.dirname(file)
    name = ""
    while os.path.exists(os.path.join(folder, "__init__.py")):
        folder, name = os.path.split(folder)
    return folder, name


def _files(root: str, module: str, names: list[str]) -> list[str]:
    """Return the existing files of a module and, if it is a package, of those of `names` that are its modules."""
    path = os.path.join(root, *module.split("."))
    candidates = [f"{path}.py", os.path.join(path, "__init__.py")]
    for name in names:
        candidates += [os.path.join(path, f"{name}.py"), os.path.join(path, name, "__init__.py")]
    return [candidate for candidate in candidates if os.path.isfile(candidate)]
