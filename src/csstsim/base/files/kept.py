"""What was read from files is kept while the files stay as they are."""

from functools import lru_cache, wraps
from pathlib import Path


def kept(most):
    """Return a decorator of read(name): its result is kept for `most` names, until the file's size or time changes.

    name: a path, with or without [part] behind it.
    """

    def decorated(read):
        @lru_cache(most)
        def known(name, state):
            return read(name)

        @wraps(read)
        def reader(name):
            try:
                status = Path(str(name).partition("[")[0]).stat()
                state = status.st_mtime_ns, status.st_size
            except (OSError, ValueError):
                state = None
            return known(name, state)

        return reader

    return decorated
