"""What csstsim raises when the input, not the program, is at fault.

Raise `InputError` for anything a user can mend: it prints as one line that names the file, the key,
the value and what is allowed, and the command ends with exit code 2 and no traceback. Let every other
exception through: it is a bug.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from typing import Any

LONGEST = 160  # characters of a key or value in a message
LINE = 1500  # ... of the whole message


class CsstsimError(Exception):
    """Base of the errors that end a command with exit code 2 and one line."""

    page: str | None = None  # the page that explains what is allowed: csstsim.base.help_page


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
        where = ": ".join(text for part, text in ((file, str(file)), (key, _cut(str(key)))) if part is not None)
        text = f"{where}: {message}" if where else message
        if value is not None:
            text += f" (got {_shown(value)})"
        if allowed is not None:
            text += f"; allowed: {allowed}"
        super().__init__(_in_a_line(text))


class BlockedError(InputError):
    """An exposure that a layer of the observation cannot have: the survey table, too, may be at fault."""


def _in_a_line(text: str) -> str:
    """Return text as one printable line: names read from files may hold any characters."""
    text = _cut(" ".join(text.split()), LINE)
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)


def _shown(value: Any) -> str:
    """Return repr(value), cut to a length that can be read."""
    try:
        text = repr(value.item() if getattr(value, "ndim", None) == 0 else value)  # a NumPy number as Python's
    except (ValueError, RecursionError):  # an integer of thousands of digits, a list nested without end
        return f"a {type(value).__name__}"
    return _cut(text)


def _cut(text: str, most: int = LONGEST) -> str:
    return text if len(text) <= most else f"{text[: most - 4]} ..."
