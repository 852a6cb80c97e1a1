"""Paths in a file, relative to the folder of the file."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from csstsim.base.types import PathLike


def relative_to_file(file: PathLike, path: PathLike) -> Path:
    """Return a path that is given in `file`; a relative path is relative to the folder of that file."""
    folder = Path(file).parent
    if ".." in Path(path).parts and folder.resolve() != Path(os.path.abspath(folder)):
        folder = folder.resolve()  # the folder is reached by a link, to which `..` must not apply
    return Path(os.path.normpath(folder / path))
