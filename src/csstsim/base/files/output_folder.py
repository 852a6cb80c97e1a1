"""Whether a command can write to the folder that it is given, asked before any work."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING

from csstsim.base.errors import InputError

if TYPE_CHECKING:
    from csstsim.base.types import PathLike


def output_folder(folder: PathLike, key: str = "--output") -> Path:
    """Return a folder's Path; it is not made. Raises InputError, naming the option `key`, if it cannot be written."""
    folder = Path(folder)
    there = next((path for path in (folder, *folder.absolute().parents) if path.exists()), Path("/"))
    if not there.is_dir() or not os.access(there, os.W_OK | os.X_OK):
        reason = "cannot be written" if there.is_dir() else "is not a folder"
        raise InputError(
            f"{there} {reason}", key=key, value=str(folder), allowed="a folder, new or old, that can be written"
        )
    return folder
