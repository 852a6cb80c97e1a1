"""The commit of the code: that of the clone that it runs from, or the one that was noted when the package was built.

No process is started, and nothing is imported that a build does not have: builders/build_package.py uses this module.
"""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING

from csstsim import __version__
from csstsim.base.shipped import ROOT

if TYPE_CHECKING:
    from pathlib import Path

NOTE = "commit.txt"  # in csstsim/_shipped of a wheel, and at the top of a source distribution


@cache
def git_commit() -> str | None:
    """Return the commit of the code that runs, 40 hexadecimal digits; None if it is not known."""
    return commit_of(ROOT)


def version_with_commit() -> str:
    """Return the version, and the commit in brackets if it is known: what `csstsim --version` prints."""
    commit = git_commit()
    return f"{__version__} (commit {commit})" if commit else __version__


def commit_of(folder: Path) -> str | None:
    """Return the commit of a clone, or the one noted in an installed package or a source distribution; or None."""
    try:
        return _of_clone(folder / ".git") if (folder / ".git").exists() else (folder / NOTE).read_text().strip()
    except OSError:
        return None


def _of_clone(git: Path) -> str | None:
    head = (git / "HEAD").read_text().strip()
    if not head.startswith("ref: "):
        return head
    ref = head.removeprefix("ref: ")
    if (git / ref).exists():
        return (git / ref).read_text().strip()
    packed = (line.split() for line in (git / "packed-refs").read_text().splitlines())
    return next((words[0] for words in packed if words[1:] == [ref]), None)
