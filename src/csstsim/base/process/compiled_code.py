"""The folder of numba's compiled code, if neither the package nor the home folder can be written.

numba writes next to the package, or else below the home folder, or else raises. Without stored code, each process
compiles for 50 CPU-seconds.
"""

from __future__ import annotations

import os
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import MutableMapping

_NAME = "csstsim-compiled"


def choose_folder(environment: MutableMapping[str, str], package: str) -> str | None:
    """Set NUMBA_CACHE_DIR to a temporary folder if numba has no writable folder; call it before numba's import.

    environment: as os.environ. Returns the folder; None if numba needs none. Only the user may write to the folder,
    because numba executes its content.
    """
    if "NUMBA_CACHE_DIR" in environment or os.access(package, os.W_OK):
        return None
    import tempfile

    home = environment.get("XDG_CACHE_HOME") or os.path.join(environment.get("HOME") or "/", ".cache")
    try:
        if not os.path.isabs(home):
            raise NotADirectoryError(home)  # it would be made in the current folder of each command
        os.makedirs(home, exist_ok=True)
        with tempfile.TemporaryFile(dir=home):
            return None
    except OSError:
        pass
    folder = os.path.join(tempfile.gettempdir(), f"{_NAME}-{os.getuid()}")
    try:
        os.makedirs(folder, mode=0o700, exist_ok=True)
        about = os.lstat(folder)
    except OSError:
        return None
    if about.st_uid != os.getuid() or about.st_mode & 0o077:
        return None
    environment["NUMBA_CACHE_DIR"] = folder
    return folder


def is_chosen(folder: str) -> bool:
    """Return whether a folder of compiled code is, or is below, one of `choose_folder`."""
    return any(part.startswith(_NAME) for part in folder.split(os.sep))
