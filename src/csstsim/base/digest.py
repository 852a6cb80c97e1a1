"""Short digests of the inputs of a product: data, files, and the source code of a user's layers and catalogues."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from types import ModuleType
    from typing import Any

    from csstsim.base.types import PathLike

_PIECES = 256  # of a large file that are read
_PIECE_SIZE = 1 << 16  # bytes


def digest(data: Any) -> str:
    """Return 16 hex digits of the SHA-256 of JSON-like data, independent of key order."""
    return hashlib.sha256(json.dumps(data, sort_keys=True, default=str).encode()).hexdigest()[:16]


def file_digest(path: PathLike) -> str:
    """Return 16 hex digits of a file's content. Raises OSError if it cannot be read."""
    return hashlib.sha256(Path(path).read_bytes()).hexdigest()[:16]


def large_file_digest(path: PathLike) -> str:
    """Return 16 hex digits of a large file: of its size and of 256 pieces, evenly spaced. Raises OSError."""
    size = Path(path).stat().st_size
    sha = hashlib.sha256(str(size).encode())
    with open(path, "rb") as file:
        for number in range(_PIECES):
            file.seek(max(size - _PIECE_SIZE, 0) * number // (_PIECES - 1))
            sha.update(file.read(_PIECE_SIZE))
    return sha.hexdigest()[:16]


def module_digest(module: ModuleType) -> str | None:
    """Return 16 hex digits of the file of an imported module; None for modules of csstsim or without a file."""
    if module.__name__.startswith("csstsim."):
        return None  # recipes have the release instead
    try:
        return file_digest(module.__file__)  # type: ignore[arg-type]  # None is caught below
    except (AttributeError, TypeError, OSError):
        return None
