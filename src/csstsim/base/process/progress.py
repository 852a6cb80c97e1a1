"""Progress bars of long loops, on a terminal only."""

from __future__ import annotations

import sys
from contextlib import contextmanager
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Mapping
    from pathlib import Path
    from typing import Any, TypeVar

    from rich.progress import Progress

    ItemT = TypeVar("ItemT")

_screen: dict[str, Any] = {"hidden": False, "bars": None}  # one per process: rich draws one set of bars at a time


def progress(items: Iterable[ItemT], what: str, total: int | None = None) -> Iterator[ItemT]:
    """Yield the items; on a terminal, show a bar named `what` on standard error, below the bars of outer loops.

    Text printed with `print` appears above the bars (not with click.echo). total: the number of items, if they have no
    length.
    """
    if _screen["hidden"] or not (sys.stderr and sys.stderr.isatty()):
        yield from items
        return
    with _bars() as bars:
        task = bars.add_task(what, total=total)
        try:
            yield from bars.track(items, total=total, task_id=task)
        finally:
            bars.remove_task(task)


@contextmanager
def hidden() -> Iterator[None]:
    """Show no bars inside."""
    before = _screen["hidden"]
    _screen["hidden"] = True
    try:
        yield
    finally:
        _screen["hidden"] = before


@contextmanager
def _bars() -> Iterator[Progress]:
    """Yield the rich.progress.Progress on the screen; it is started if there is none."""
    if _screen["bars"]:
        yield _screen["bars"]
        return
    from rich.console import Console
    from rich.progress import Progress

    # soft_wrap: a long path that is printed stays on one line. Output to a file must not be redirected to the screen
    redirect = sys.stdout is not None and sys.stdout.isatty()
    with Progress(console=Console(stderr=True, soft_wrap=True), transient=True, redirect_stdout=redirect) as bars:
        _screen["bars"] = bars
        try:
            yield bars
        finally:
            _screen["bars"] = None


def make_missing(wanted: Mapping[Path, Callable[[], object]], log: Callable[[str], object]) -> None:
    """Make the missing files of {path: function that makes it}."""
    for path in progress([path for path in wanted if not path.exists()], "made first"):
        if not path.exists():  # tables are written with a new PSF set
            log(f"missing, made first: {path}")
            wanted[path]()
