"""Compiled code of an earlier version that cannot be read is compiled again.

The index of a function that numba has compiled names the classes of its arguments. If one was renamed since, numba 0.68
ends with an AttributeError before it compares the file's date. numba calls `init` before it compiles anything (entry
point `numba_extensions` of pyproject.toml).
"""

from functools import wraps
from typing import Any

UNREADABLE = AttributeError, ImportError  # raised by pickle for what is not there any more


def init() -> None:
    """Let numba pass over an index, or compiled code, that names what is not there any more."""
    from numba.core.caching import IndexDataCacheFile

    load_index, load_data = IndexDataCacheFile._load_index, IndexDataCacheFile._load_data
    if hasattr(load_index, "__wrapped__"):
        return

    @wraps(load_index)
    def index(self: Any) -> Any:
        try:
            return load_index(self)
        except UNREADABLE:
            return {}

    @wraps(load_data)
    def data(self: Any, name: str) -> Any:
        try:
            return load_data(self, name)
        except UNREADABLE as error:
            raise FileNotFoundError(name) from error  # which numba takes for code that was removed

    IndexDataCacheFile._load_index = index  # type: ignore[method-assign]
    IndexDataCacheFile._load_data = data  # type: ignore[method-assign]
