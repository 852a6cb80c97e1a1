"""A cache of values read from files, valid until the files change."""

from __future__ import annotations

from functools import lru_cache, wraps
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable
    from typing import TypeVar

    NameT = TypeVar("NameT")
    ResultT = TypeVar("ResultT")


def lru_by_file_state(maxsize: int) -> Callable[[Callable[[NameT], ResultT]], Callable[[NameT], ResultT]]:
    """Return a decorator of read(name) that caches `maxsize` results, until the size or time of the file changes.

    name: a path, optionally followed by [part].
    """

    def decorated(read: Callable[[NameT], ResultT]) -> Callable[[NameT], ResultT]:
        @lru_cache(maxsize)
        def cached(name: NameT, state: tuple[int, int] | None) -> ResultT:
            return read(name)

        @wraps(read)
        def reader(name: NameT) -> ResultT:
            try:
                status = Path(str(name).partition("[")[0]).stat()
                state = status.st_mtime_ns, status.st_size
            except (OSError, ValueError):
                state = None
            return cached(name, state)

        return reader

    return decorated
