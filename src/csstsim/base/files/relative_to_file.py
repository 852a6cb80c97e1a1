"""Paths that a file names, relative to its own folder."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from csstsim.base.types import PathLike


def relative_to_file(file: PathLike, path: PathLike) -> Path:
    """Return the path that `file` names: a relative one is relative to the folder of that file."""
    folder = Path(file).parent
    if ".." in Path(path).parts and folder.resolve() != Path(os.path.abspath(folder)):
        folder = folder.resolve()  # `..` of a folder that is reached by a link
    return Path(os.path.normpath(folder / path))
