"""What csstsim raises when the input, not the program, is at fault.

Raise `InputError` for anything a user can mend: it prints as one line that names the file, the key,
the value and what is allowed, and the command ends with exit code 2 and no traceback. Let every other
exception through: it is a bug.
"""

LONGEST = 160  # characters of a value in a message


class CsstsimError(Exception):
    """Base of the errors that end a command with exit code 2 and one line."""


class InputError(CsstsimError):
    """A value in a file, table or command line that cannot be used."""

    def __init__(self, message, *, file=None, key=None, value=None, allowed=None):
        where = ": ".join(str(part) for part in (file, key) if part is not None)
        text = f"{where}: {message}" if where else message
        if value is not None:
            text += f" (got {_shown(value)})"
        if allowed is not None:
            text += f"; allowed: {allowed}"
        super().__init__(" ".join(text.split()))


def _shown(value):
    """Return repr(value), cut to a length that can be read."""
    try:
        text = repr(value)
    except (ValueError, RecursionError):  # an integer of thousands of digits, a list nested without end
        return f"a {type(value).__name__}"
    return text if len(text) <= LONGEST else f"{text[: LONGEST - 4]} ..."
