"""Progress of long loops, for a person at a terminal; logs stay free of it."""

import sys


def progress(items, what, total=None):
    """Yield the items; on a terminal, with a bar named `what` on standard error."""
    if not sys.stderr.isatty():
        yield from items
        return
    from rich.console import Console
    from rich.progress import track

    yield from track(items, what, total=total, console=Console(stderr=True), transient=True)
