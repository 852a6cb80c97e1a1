"""The manifest of a delivery: what a receiver can check without csstsim.

MANIFEST.sha256   hash and path of every product, as `sha256sum -c MANIFEST.sha256` reads it
MANIFEST.tsv      path, size in bytes and kind of every product, with a heading
MANIFEST.content  hash of what each product holds, without dates and timings (compare.content)
MANIFEST.missing  exposure, chip and reason of each frame that the campaign declares missing; no file if there is none

The hashes of the others are in MANIFEST.sha256.
"""

from __future__ import annotations

import hashlib
import re
from typing import TYPE_CHECKING

from csstsim.base.errors import InputError
from csstsim.base.files.atomic import atomic_path
from csstsim.base.process.progress import progress

if TYPE_CHECKING:
    from collections.abc import Collection, Container, Iterator, Mapping
    from pathlib import Path

HASHES = "MANIFEST.sha256"
SIZES = "MANIFEST.tsv"
CONTENT = "MANIFEST.content"
MISSING = "MANIFEST.missing"
FILES = HASHES, SIZES, CONTENT, MISSING
# of `csstsim release crate`: what hashes files cannot be hashed with them
CRATE_FILE = "ro-crate-metadata.json"
CRATE_FOLDER = "workflow"
CRATE = CRATE_FILE, CRATE_FOLDER
_LINE = re.compile(r"([0-9a-f]{64}) [ *]([A-Za-z0-9_.=/-]+)")
_HEADING = "path\tbytes\tproduct"


def write_manifest(folder: Path, kinds: Mapping[str, str], missing: Collection[tuple[str, int, str]] = ()) -> None:
    """Write the files about {path below folder: kind of product}, sorted by path. The same files give the same bytes.

    missing: (obsid, chip, reason) of each frame that is declared missing. A path holds no character that sha256sum
    would escape. Raises OSError.
    """
    kinds = dict(sorted(kinds.items()))
    rows = [f"{name}\t{(folder / name).stat().st_size}\t{kind}" for name, kind in kinds.items()]
    with atomic_path(folder / SIZES) as temporary:
        temporary.write_text("\n".join([_HEADING, *rows]) + "\n", encoding="ascii")
    (folder / MISSING).unlink(missing_ok=True)
    if missing:
        lines = ["exposure\tchip\treason", *("\t".join(map(str, row)) for row in missing)]
        with atomic_path(folder / MISSING) as temporary:
            temporary.write_text("\n".join(lines) + "\n", encoding="utf-8")
    names = [*progress(kinds, "hashing", len(kinds)), SIZES, *([MISSING] if missing else [])]
    _write_hashes(folder, {name: file_hash(folder / name) for name in names})


def list_content(folder: Path) -> None:
    """Add the hash of MANIFEST.content to MANIFEST.sha256. Raises OSError, and InputError as `read_manifest`."""
    _write_hashes(folder, read_manifest(folder / HASHES) | {CONTENT: file_hash(folder / CONTENT)})


def _write_hashes(folder: Path, hashes: Mapping[str, str]) -> None:
    with atomic_path(folder / HASHES) as temporary:
        temporary.write_text("".join(f"{value}  {name}\n" for name, value in hashes.items()), encoding="ascii")


def file_hash(path: Path) -> str:
    """Return the SHA-256 of a file, read a piece at a time."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def manifest_faults(folder: Path, present: set[str], expected: Container[str]) -> Iterator[tuple[str, str]]:
    """Yield (path, fault) between the manifest in a folder and its products; nothing if there is no manifest.

    present: paths below the folder of the products that are files; expected: of all that must exist.
    """
    if not (folder / HASHES).is_file():
        return
    try:
        listed = read_manifest(folder / HASHES)
    except InputError as exc:
        yield HASHES, str(exc)
        return
    for name in progress(sorted(listed), "checking the manifest", len(listed)):
        if name not in (SIZES, CONTENT, MISSING) and name not in present:
            if name not in expected:  # one that is expected is missed already
                yield name, f"listed in {HASHES}, but missing" if not (folder / name).exists() else "no product"
        elif not (folder / name).is_file():
            yield name, "missing"
        elif file_hash(folder / name) != listed[name]:
            yield name, f"its SHA-256 is not that of {HASHES}: changed since"
    for name in sorted(present - listed.keys()):
        yield name, f"not listed in {HASHES}: newer"


def read_manifest(path: Path) -> dict[str, str]:
    """Return {path: SHA-256}. Raises InputError for a line that `write_manifest` does not write."""
    listed = {}
    try:
        lines = path.read_text(encoding="ascii").splitlines()
    except ValueError:
        raise InputError("holds bytes that are no text") from None
    for number, line in enumerate(lines, 1):
        match = _LINE.fullmatch(line)
        if not match or match[2].startswith("/") or ".." in match[2].split("/"):
            raise InputError("not a hash and a path below this folder", key=f"line {number}", value=line[:100])
        if match[2] in listed:
            raise InputError("a path is listed twice", key=f"line {number}", value=match[2])
        listed[match[2]] = match[1]
    return listed
