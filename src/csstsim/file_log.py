"""Which files are read and written, how large and how fast: the log "csstsim.files", which `csstsim -v` shows."""

import logging
import os
import time
from contextlib import contextmanager

_LOG = logging.getLogger("csstsim.files")


@contextmanager
def logged(verb, path):
    """Log that a file was read or written in here, unless that failed. verb: in the past tense."""
    start = time.perf_counter()
    yield
    if _LOG.isEnabledFor(logging.DEBUG):
        size, seconds = os.path.getsize(path) / 1e6, time.perf_counter() - start
        _LOG.debug("%s %s: %.3g MB in %.3f s", verb, path, size, seconds)
