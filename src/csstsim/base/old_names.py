"""The warning of a name that was changed: it works for one minor version (docs/versions.md)."""

from __future__ import annotations

import warnings


def warn_old_name(message: str, goes: str, stacklevel: int = 1) -> None:
    """Warn (DeprecationWarning) of an old name in Python.

    message: what to write instead. goes: the first version without the old name, "0.3.0". stacklevel: 1 if the caller
    is the function that was called with the old name, 2 if that function called the caller.
    """
    warnings.warn(old_name(message, goes), DeprecationWarning, stacklevel=stacklevel + 2)


def old_name(message: str, goes: str) -> str:
    """Return the text of a warning."""
    return f"{message}; the old form goes in {goes}"
