"""Reads small text files (YAML, JSON, tables, configurations) completely, up to a size limit."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING

from csstsim.base.errors import InputError
from csstsim.base.files.file_log import logged

if TYPE_CHECKING:
    from typing import Any

    from csstsim.base.types import PathLike

MAX_BYTES = 64_000_000  # the survey table of 73,260 files has 2 MB


def read_text(path: PathLike, encoding: str = "utf-8", max_bytes: int = MAX_BYTES) -> str:
    """Return the text of a file of at most `max_bytes` bytes.

    Raises InputError if it is missing, not a plain file, too large or not in the encoding.
    """
    path = Path(path)
    try:
        if path.exists() and not (path.is_file() or path.is_dir()):
            raise InputError("a pipe or device, which might never end", file=path)
        if path.is_dir():
            raise InputError("is a folder, not a file", file=path)
        with logged("read", path), path.open("rb") as file:
            content = file.read(max_bytes + 1)
    except OSError as exc:
        raise InputError(f"cannot read the file: {exc.strerror}", file=path) from exc
    except ValueError as exc:  # a NUL in its name
        raise InputError(f"cannot read the file: {exc}", file=path) from exc
    if len(content) > max_bytes:
        raise InputError("too large a file", file=path, allowed=f"{max_bytes // 1_000_000} MB")
    try:
        return content.decode(encoding).replace("\r\n", "\n").replace("\r", "\n")
    except UnicodeDecodeError as exc:
        raise InputError("cannot read the file: not UTF-8 text", file=path) from exc


def read_json(path: PathLike) -> Any:
    """Return the content of a JSON file. Raises InputError as `read_text`, and for text that is not JSON."""
    text = read_text(path)
    try:
        return json.loads(text)
    except (ValueError, RecursionError) as exc:
        raise InputError(f"not readable as JSON: {exc}", file=path) from None
