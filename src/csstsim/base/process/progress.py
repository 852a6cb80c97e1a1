"""Progress bars of long loops, on a terminal and in a notebook only."""

from __future__ import annotations

import sys
import time
from collections.abc import Sized
from contextlib import contextmanager
from functools import cache
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Mapping
    from pathlib import Path
    from typing import Any, TypeVar

    from rich.progress import Progress

    ItemT = TypeVar("ItemT")

_screen: dict[str, Any] = {"hidden": False, "bars": None}  # one per process: rich draws one set of bars at a time

UPDATED = 0.2  # s between two updates of a notebook's bar


def progress(items: Iterable[ItemT], what: str, total: int | None = None) -> Iterator[ItemT]:
    """Yield the items; on a terminal, show a bar named `what` on standard error, below the bars of outer loops.

    Text printed with `print` appears above the bars (not with click.echo). In a notebook the bar is below the cell, and
    goes at the end. total: the number of items, if they have no length.
    """
    if _screen["hidden"] or not (_terminal() or _notebook()):
        yield from items
        return
    if not _terminal():
        yield from _below_cell(items, what, total)
        return
    with _bars() as bars:
        task = bars.add_task(what, total=total)
        try:
            yield from bars.track(items, total=total, task_id=task)
        finally:
            bars.remove_task(task)


@cache
def tell_once(text: str) -> None:
    """Write a line on standard error, if it is a terminal or a notebook's, once in a process."""
    if not _screen["hidden"] and (_terminal() or _notebook()):
        print(text, file=sys.stderr, flush=True)


def _terminal() -> bool:
    return sys.stderr is not None and sys.stderr.isatty()


def _notebook() -> bool:
    """Return whether the process is the kernel of a notebook."""
    shell = sys.modules["IPython"].get_ipython() if "IPython" in sys.modules else None
    return hasattr(shell, "kernel")


def _below_cell(items: Iterable[ItemT], what: str, total: int | None) -> Iterator[ItemT]:
    """Yield the items, and show an HTML bar below the cell."""
    from html import escape

    from IPython.display import HTML, display

    if total is None and isinstance(items, Sized):
        total = len(items)
    known = "" if total is None else f' max="{total}"'
    shown = None
    due = time.monotonic() + UPDATED  # a short loop shows no bar
    try:
        for done, item in enumerate(items):
            if time.monotonic() > due:
                shown = shown or display(HTML(""), display_id=True)
                value = "" if total is None else f' value="{done}"'
                shown.update(HTML(f"{escape(what)} <progress{value}{known}></progress> {done} of {total or '?'}"))
                due = time.monotonic() + UPDATED
            yield item
    finally:
        if shown:
            shown.update(HTML(""))


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
