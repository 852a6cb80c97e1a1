"""Turns the exceptions that libraries raise for a damaged file into one line that names the file."""

from __future__ import annotations

import lzma
import sys
import warnings
import zlib
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from csstsim.base.errors import InputError
from csstsim.base.files.file_log import logged

if TYPE_CHECKING:
    from collections.abc import Iterator

    from csstsim.base.types import PathLike

_DAMAGE = (
    AssertionError, OSError, EOFError, LookupError, AttributeError, TypeError, ValueError, ArithmeticError, zlib.error,
    lzma.LZMAError, UserWarning,
)  # fmt: skip


@contextmanager
def reading(path: PathLike, what: str, strict: bool = True) -> Iterator[None]:
    """Turn an exception raised inside into an InputError: the file cannot be read as `what`.

    `strict`: a warning counts as damage, too (astropy only warns of a truncated file).
    """
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error" if strict else "ignore", UserWarning)
            with logged("read", path):
                yield
    except Exception as exc:
        astropy = sys.modules.get("astropy.io.fits")  # not loaded, it cannot have complained
        if not isinstance(exc, (*_DAMAGE, *([astropy.VerifyError] if astropy else []))):
            raise
        raise InputError(f"cannot be read as {what}: {type(exc).__name__} {exc}", file=Path(path)) from exc
