"""Compiled code: each function is compiled once, by one process, and read by all others.

numba calls `init` before it compiles anything (entry point `numba_extensions` of pyproject.toml). It mends seven
things:

- The index of a function names the classes of its arguments. If one was renamed since, numba 0.68 ends with an
  AttributeError before it compares the file's date. Such code is compiled again.
- The index of a function says of which source file its code was compiled. Functions and constants of other files are in
  the code, too: the files that are reached by imports count as well.
- Processes that start together compile the same functions. A lock for each function makes them wait and read.
- Two processes that store two signatures of a function at once may take one name for both files. The lock forbids it.
- numba ignores code beside a package that its user may not write. It is read here, and never changed.
- numba takes stored code for that of a file by the file's time. Code that comes with the package is taken by content
  (base.process.shipped_kernels).
- Each process that compiles `rows[i] = row` spends 1.7 s on the text of an error: two shapes, written by compiled code.
  The text here is without shapes.
"""

from __future__ import annotations

import fcntl
import os
import zlib
from contextlib import contextmanager
from functools import partial, wraps
from typing import TYPE_CHECKING, Any

from csstsim.base.process.compiled_code import is_chosen
from csstsim.base.process.progress import tell_once
from csstsim.base.process.reached_sources import sources_digest
from csstsim.base.process.shipped_kernels import load_shipped

if TYPE_CHECKING:
    from collections.abc import Iterator

UNREADABLE = AttributeError, ImportError  # raised by pickle for what is not there any more
LOCK = "compiling.lock"  # in each folder of compiled code; a byte of it stands for a function
COMPILING = "csstsim compiles its code for this machine: once for an installation, up to two minutes"
_BYTES = 1 << 31
# {(process, path): descriptor}; closing one would release all locks of the process, and a fork has none of them
_open: dict[tuple[int, str], int] = {}


def init() -> None:
    """Change how numba reads, writes and shares compiled code."""
    from numba.core.caching import IndexDataCacheFile
    from numba.core.compiler_lock import global_compiler_lock
    from numba.core.dispatcher import Dispatcher

    load_index, load_data, load = IndexDataCacheFile._load_index, IndexDataCacheFile._load_data, IndexDataCacheFile.load
    compile_ = Dispatcher.compile
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

    @wraps(load)
    def either(self: Any, key: Any) -> Any:
        found = load(self, key)
        if found is None and (beside := getattr(self, "beside", None)):
            found = load(beside, key)
        if found is None and (shipped := getattr(self, "shipped", None)):
            found = shipped(key)
        if found is None:
            tell_once(COMPILING)
        return found

    @wraps(compile_)
    def once(self: Any, sig: Any) -> Any:
        cache = self._cache
        file = getattr(cache, "_cache_file", None)
        if file is None:  # without cache=True
            return compile_(self, sig)
        if not hasattr(file, "beside"):
            source = self.py_func.__code__.co_filename
            # numba's own is of the time of decoration, which may be before `init`
            digest = sources_digest(source) if os.path.isfile(source) else ""
            file._source_stamp = file._source_stamp, digest
            file.beside = _beside(source, cache)
            file.shipped = partial(load_shipped, source, cache._impl.filename_base, digest)
        with global_compiler_lock, _locked(cache, file._index_name):
            return compile_(self, sig)

    def _beside(source: str, cache: Any) -> Any:
        """Return the code beside the source, if numba keeps the user's elsewhere by its own choice or csstsim's."""
        folder = os.path.join(os.path.dirname(source), "__pycache__")
        elsewhere = type(cache._impl.locator).__name__ == "UserWideCacheLocator" or is_chosen(cache.cache_path)
        if not elsewhere or not os.path.isdir(folder):
            return None
        return IndexDataCacheFile(folder, cache._impl.filename_base, cache._cache_file._source_stamp)

    IndexDataCacheFile._load_index = index  # type: ignore[method-assign]
    IndexDataCacheFile._load_data = data  # type: ignore[method-assign]
    IndexDataCacheFile.load = either  # type: ignore[method-assign]
    Dispatcher.compile = once  # type: ignore[method-assign]
    _leave_out_shapes()


def _leave_out_shapes() -> None:
    """Give the error of an assignment to a part of an array a text without shapes."""
    from numba.extending import overload
    from numba.np import arrayobj

    def differ(source_shapes: Any, index_shape: Any) -> None:
        raise NotImplementedError

    @overload(differ)
    def _(source_shapes: Any, index_shape: Any) -> Any:
        def impl(source_shapes: Any, index_shape: Any) -> None:
            raise ValueError("an array cannot be assigned to a part of another: their shapes differ")

        return impl

    arrayobj.raise_with_shape_context = differ


@contextmanager
def _locked(cache: Any, name: str) -> Iterator[None]:
    """Hold the lock of a function in its folder of compiled code; nothing is locked where locks do not work.

    The lock is one of POSIX: it belongs to the process, also on network file systems, and ends with it.
    """
    byte = zlib.crc32(name.encode()) % _BYTES
    try:
        file = _lock_file(cache)
        fcntl.lockf(file, fcntl.LOCK_EX, 1, byte)
    except OSError:
        yield
        return
    try:
        yield
    finally:
        fcntl.lockf(file, fcntl.LOCK_UN, 1, byte)


def _lock_file(cache: Any) -> int:
    """Return the descriptor of the file of locks in the folder of a function's compiled code."""
    key = os.getpid(), os.path.join(cache.cache_path, LOCK)
    if key not in _open:
        cache._impl.locator.ensure_cache_path()
        _open[key] = os.open(key[1], os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o666)
    return _open[key]
