"""The parameters of changing objects: config/changing/, or files of the same names in a universe's folder.

They are not in config/universe/, because truth bricks do not depend on them.
"""

from __future__ import annotations

from collections.abc import Iterable
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from csstsim.base.digest import file_digest
from csstsim.base.errors import InputError
from csstsim.base.shipped import SHIPPED
from csstsim.instrument.load import read_data

if TYPE_CHECKING:
    from csstsim.base.types import PathLike

KINDS = ("variable_stars", "variable_quasars", "asteroids", "satellites")  # keys of `catalog`, and file names


def file_of(folder: PathLike, kind: str) -> Path:
    """Return the file of a kind's numbers for a universe's folder."""
    file = Path(folder) / f"{kind}.yaml"
    return file if file.is_file() else SHIPPED / "changing" / f"{kind}.yaml"


@cache
def numbers_of(folder: PathLike, kind: str) -> dict[str, Any]:
    """Return the numbers of a kind. Raises InputError for an unreadable file, or a number without source."""
    return read_data(file_of(folder, kind))


def digest_of(folder: PathLike, kinds: Iterable[str]) -> dict[str, str]:
    """Return {kind: digest of the file of its numbers}."""
    return {kind: file_digest(file_of(folder, kind)) for kind in kinds}


def number_error(folder: PathLike, kind: str, exc: Exception) -> InputError:
    """Return the InputError for a number that is missing or invalid; exc: what reading it raised."""
    return InputError(f"a number is missing or wrong: {type(exc).__name__} {exc}", file=file_of(folder, kind))
