"""Reading the camera's data files: YAML in which every number has a source and a confidence.

There are two forms; a number in another form is an error:

    gain: {value: 1.1, unit: e-/DN, source: "Paper 5.5", confidence: S}

and a section with `source` and `confidence`, which apply to everything below it. A section with `values` is replaced by
them, another section by its keys without `source`, `confidence`, `unit` and `note`. Confidence is S (seen in a public
source), D (derived from S), K (known from the literature) or E (estimate). '-low' or '-medium' may be added. Codes of
parts that differ are joined by '/' or '+'.
"""

from __future__ import annotations

import hashlib
import re
from pathlib import Path
from typing import TYPE_CHECKING

from csstsim.base.errors import InputError
from csstsim.base.files.yaml_file import read_yaml

if TYPE_CHECKING:
    from collections.abc import Container, Mapping
    from typing import Any

    from csstsim.base.types import PathLike

DATA = ".yaml", ".conf", ".csv"  # suffixes, besides FITS, of data files in the folder of a camera or a universe
_PROVENANCE = ("source", "confidence")
_ABOUT = (*_PROVENANCE, "unit", "note")
_CODE = re.compile(r"[SDKE](-low|-medium)?([/+][SDKE](-low|-medium)?)*")


def read_data(path: PathLike) -> dict[Any, Any]:
    """Return the content of a data file, with the provenance of each number checked and removed.

    Raises InputError, with file and key, for an unreadable file, a number without source and confidence, or an unknown
    confidence code.
    """
    return _unwrap(read_yaml(path), Path(path), key="", sourced=False)


def sections(data: Mapping[Any, Any]) -> dict[Any, Any]:
    """Return {key: value} of the content of a data file without its sections, which only group the keys."""
    return {key: value for section in data.values() if isinstance(section, dict) for key, value in section.items()}


def _unwrap(node: Any, path: Path, key: str, sourced: bool) -> Any:
    """Return a node without provenance. sourced: a section above it has source and confidence."""
    if isinstance(node, dict):
        sourced = _has_provenance(node, path, key) or sourced
        for name in ("value", "values"):
            if name in node:
                if not sourced:
                    raise InputError("source and confidence are missing", file=path, key=key)
                return _unwrap(node[name], path, _join(key, name), sourced)
        inner = {k: v for k, v in node.items() if not (sourced and k in _ABOUT)}
        return {k: _unwrap(v, path, _join(key, k), sourced) for k, v in inner.items()}
    if isinstance(node, list):
        return [_unwrap(item, path, f"{key}[{i}]", sourced) for i, item in enumerate(node)]
    if isinstance(node, int | float) and not isinstance(node, bool) and not sourced:
        raise InputError("a number without source and confidence", file=path, key=key, value=node)
    return node


def _has_provenance(node: Mapping[Any, Any], path: Path, key: str) -> bool:
    """Return whether a mapping has source and confidence. Raises InputError for one of them, or an unknown code."""
    stated = [name for name in _PROVENANCE if node.get(name) not in (None, "")]
    if len(stated) == 1:
        missing = next(name for name in _PROVENANCE if name not in stated)
        raise InputError(f"{stated[0]} is given, but {missing} is missing", file=path, key=key)
    if stated and not _CODE.fullmatch(str(node["confidence"])):
        allowed = "S, D, K, E, each with -low or -medium, joined by / or +"
        raise InputError(
            "unknown code", file=path, key=_join(key, "confidence"), value=node["confidence"], allowed=allowed
        )
    return bool(stated)


def _join(key: str, name: object) -> str:
    return f"{key}.{name}" if key else str(name)


def data_files(folder: PathLike) -> dict[str, Path]:
    """Return {name: path} of every data file below `folder`, sorted, without READMEs, pictures and hidden files."""
    files = sorted(p for p in Path(folder).rglob("*") if p.is_file() and _is_data(p))
    return {path.relative_to(folder).as_posix(): path for path in files}


def _is_data(path: Path) -> bool:
    return not path.name.startswith(".") and (path.suffix in DATA or ".fits" in path.suffixes)


def folder_digest(folder: PathLike, without: Container[str] = ()) -> str:
    """Return 16 hex digits of the SHA-256 of names and bytes of the data files below `folder`, except some names."""
    sha = hashlib.sha256()
    for name, path in data_files(folder).items():
        if name in without:
            continue
        content = path.read_bytes()
        sha.update(f"{name}\0{len(content)}\0".encode())
        sha.update(content)
    return sha.hexdigest()[:16]
