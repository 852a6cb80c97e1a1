"""Conversion of exceptions that libraries raise for damaged files to InputErrors with the name of the file."""

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
    """Convert an exception raised inside to an InputError: the file cannot be read as `what`.

    strict: warnings are damage, too (astropy only warns about a truncated file).
    """
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error" if strict else "ignore", UserWarning)
            with logged("read", path):
                yield
    except Exception as exc:
        astropy = sys.modules.get("astropy.io.fits")  # if it is not loaded, it has not raised
        if not isinstance(exc, (*_DAMAGE, *([astropy.VerifyError] if astropy else []))):
            raise
        raise InputError(f"cannot be read as {what}: {type(exc).__name__} {exc}", file=Path(path)) from exc
