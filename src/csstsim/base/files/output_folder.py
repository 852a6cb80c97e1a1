"""Checks whether a command can write to its output folder, before any work."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING

from csstsim.base.errors import InputError

if TYPE_CHECKING:
    from csstsim.base.types import PathLike


def nearest_existing_parent(path: PathLike) -> Path:
    """Return the absolute path itself if it exists, else its nearest parent that exists."""
    path = Path(path).absolute()
    return next(folder for folder in (path, *path.parents) if folder.exists())


def output_folder(folder: PathLike, key: str = "--output") -> Path:
    """Return a folder's Path; it is not made. Raises InputError, naming the option `key`, if it cannot be written."""
    existing = nearest_existing_parent(folder)
    if not existing.is_dir() or not os.access(existing, os.W_OK | os.X_OK):
        reason = "cannot be written" if existing.is_dir() else "is not a folder"
        raise InputError(
            f"{existing} {reason}", key=key, value=str(folder), allowed="a folder, new or old, that can be written"
        )
    return Path(folder)
