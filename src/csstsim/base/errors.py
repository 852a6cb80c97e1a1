"""Exceptions for faults in the input, as opposed to bugs.

`InputError` is for anything that a user can correct. It is printed as one line with the file, the key, the value and
what is allowed; the command ends with exit code 2 and without traceback. Any other exception is a bug and is not
caught.
"""

from __future__ import annotations

from pathlib import PurePath
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from typing import Any

MAX_VALUE = 160  # characters of a key or value in a message
MAX_MESSAGE = 1500  # characters of a message


class CsstsimError(Exception):
    """Base of the errors that end a command with exit code 2 and one line."""

    page: str | None = None  # page that explains the input: csstsim.base.help_page


class InputError(CsstsimError):
    """A value in a file, table or command line that cannot be used."""

    def __init__(
        self, message: str, *, file: object = None, key: object = None, value: object = None, allowed: object = None
    ) -> None:
        self.message = message
        self.file = file
        self.key = key
        self.value = value
        self.allowed = allowed
        where = ": ".join(text for part, text in ((file, str(file)), (key, _shortened(str(key)))) if part is not None)
        text = f"{where}: {message}" if where else message
        if value is not None:
            text += f" (got {_short_repr(value)})"
        if allowed is not None:
            text += f"; allowed: {allowed}"
        super().__init__(_single_line(text))


class BlockedError(InputError):
    """An exposure to which a layer cannot be applied. The cause may be the observation file or the survey table."""


def _single_line(text: str) -> str:
    """Return text as one printable line: names read from files may contain any characters."""
    text = _shortened(" ".join(text.split()), MAX_MESSAGE)
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)


def _short_repr(value: Any) -> str:
    """Return repr(value), shortened; that of its text for a path."""
    if isinstance(value, PurePath):
        value = str(value)
    try:
        text = repr(value.item() if getattr(value, "ndim", None) == 0 else value)  # a NumPy number as Python's
    except (ValueError, RecursionError):  # an integer of thousands of digits, an infinitely nested list
        return f"a {type(value).__name__}"
    return _shortened(text)


def _shortened(text: str, length: int = MAX_VALUE) -> str:
    return text if len(text) <= length else f"{text[: length - 4]} ..."


def first_line(exc: BaseException) -> str:
    """Return what an exception says, in one line.

    Parameters
    ----------
    exc : BaseException
        Any exception.

    Returns
    -------
    str
        First line of its message; if that is empty, as of MemoryError, the name of its type.
    """
    lines = str(exc).strip().splitlines()
    return lines[0] if lines else type(exc).__name__
