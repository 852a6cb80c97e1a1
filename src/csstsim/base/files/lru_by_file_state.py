"""A cache of what was read from files, valid while the files stay as they are."""

from __future__ import annotations

from functools import lru_cache, wraps
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable
    from typing import TypeVar

    NameT = TypeVar("NameT")
    ResultT = TypeVar("ResultT")


def lru_by_file_state(most: int) -> Callable[[Callable[[NameT], ResultT]], Callable[[NameT], ResultT]]:
    """Return a decorator of read(name): its result is kept for `most` names, until the file's size or time changes.

    name: a path, with or without [part] behind it.
    """

    def decorated(read: Callable[[NameT], ResultT]) -> Callable[[NameT], ResultT]:
        @lru_cache(most)
        def known(name: NameT, state: tuple[int, int] | None) -> ResultT:
            return read(name)

        @wraps(read)
        def reader(name: NameT) -> ResultT:
            try:
                status = Path(str(name).partition("[")[0]).stat()
                state = status.st_mtime_ns, status.st_size
            except (OSError, ValueError):
                state = None
            return known(name, state)

        return reader

    return decorated
