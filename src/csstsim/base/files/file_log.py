"""Which files are read and written, how large and how fast: the log "csstsim.files", which `csstsim -v` shows."""

from __future__ import annotations

import logging
import os
import time
from contextlib import contextmanager
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterator

    from csstsim.base.types import PathLike

_LOG = logging.getLogger("csstsim.files")


@contextmanager
def logged(verb: str, path: PathLike) -> Iterator[None]:
    """Log that a file was read or written in here, unless that failed. verb: in the past tense."""
    start = time.perf_counter()
    yield
    if _LOG.isEnabledFor(logging.DEBUG):
        size = os.path.getsize(path)
        seconds = time.perf_counter() - start
        large, unit = (size / 1e6, "MB") if size >= 1e6 else (size / 1e3, "kB")
        _LOG.debug("%s %s: %.3g %s in %.3f s", verb, path, large, unit, seconds)
