"""The log "csstsim.files" of files read and written, with size and time; `csstsim -v` shows it."""

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
    """Log that a file was read or written inside, unless that failed. verb: in the past tense."""
    start = time.perf_counter()
    yield
    if _LOG.isEnabledFor(logging.DEBUG):
        size = os.path.getsize(path)
        seconds = time.perf_counter() - start
        amount, unit = (size / 1e6, "MB") if size >= 1e6 else (size / 1e3, "kB")
        _LOG.debug("%s %s: %.3g %s in %.3f s", verb, path, amount, unit, seconds)
