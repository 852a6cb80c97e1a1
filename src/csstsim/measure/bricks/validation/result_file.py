"""The validation of a brick as a JSON file. Its checksum protects the verdict against damaged bytes."""

from __future__ import annotations

import json
import zlib
from typing import TYPE_CHECKING, Any

from csstsim.base.errors import InputError
from csstsim.base.files.atomic import atomic_path
from csstsim.base.files.text_file import read_json

if TYPE_CHECKING:
    from csstsim.base.types import PathLike


def write_result(path: PathLike, result: dict[str, Any]) -> None:
    """Write a JSON-like result (validate.validate_brick), which may have any keys but `checksum`."""
    with atomic_path(path) as temporary:
        temporary.write_text(json.dumps(result | {"checksum": _checksum(result)}, indent=1) + "\n")


def read_result(path: PathLike) -> dict[str, Any]:
    """Return the result in a file of `write_result`. Raises InputError if it is missing, damaged or of another kind."""
    result = read_json(path)
    checksum = result.pop("checksum", None) if isinstance(result, dict) else None
    if checksum is None:
        raise InputError("not the validation of a brick, or an older one; make it again", file=path, key="checksum")
    if checksum != _checksum(result):
        raise InputError("damaged; make it again", file=path, key="checksum", value=checksum, allowed=_checksum(result))
    return result


def _checksum(result: dict[str, Any]) -> int:
    return zlib.crc32(json.dumps(result, sort_keys=True).encode())
