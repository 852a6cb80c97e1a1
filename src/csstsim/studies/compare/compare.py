"""`csstsim compare`: two folders or files, product by product."""

from __future__ import annotations

import filecmp
import os
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from csstsim.base.errors import InputError
from csstsim.base.plural import number_of
from csstsim.base.process.progress import progress
from csstsim.studies.compare import hdf5, images, tables, texts
from csstsim.studies.compare.facts import Fact
from csstsim.studies.compare.varying import BESIDE_PRODUCTS

if TYPE_CHECKING:
    from csstsim.base.types import PathLike

BY_SUFFIX = {
    ".fits": images.fits_facts,
    ".h5": hdf5.hdf5_facts,
    ".hdf5": hdf5.hdf5_facts,
    ".parquet": tables.table_facts,
    ".json": texts.json_facts,
    ".html": texts.page_facts,
    ".png": texts.picture_facts,
    ".properties": texts.properties_facts,
}
BY_NAME = dict.fromkeys(("_metadata", "_common_metadata"), tables.footer_facts)


def compare(a: PathLike, b: PathLike, say: Callable[[str], object], provenance: bool = False) -> int:
    """Print each difference between two folders or two files, then the number of products that differ; return it.

    `provenance`: differences in how a product was made count, too; otherwise one line lists them. A product that cannot
    be read counts as different. Raises InputError for files that cannot be compared.
    """
    a = Path(a)
    b = Path(b)
    for path in (a, b):
        if not path.exists():
            raise InputError("no such file or folder", file=path)
    if a.is_dir() != b.is_dir():
        raise InputError("one is a folder, the other a file", file=a if a.is_dir() else b, allowed="two of a kind")
    if not a.is_dir():
        return _tell({a.name: list(facts(a, b))}.items(), 1, say, provenance)
    names = [_products(folder) for folder in (a, b)]
    for folder, found in zip((a, b), names, strict=True):
        if not found:
            raise InputError("holds no product", file=folder, allowed="an output folder")
    every = sorted(set().union(*names))
    return _tell(
        ((name, _found(a, b, name, names)) for name in progress(every, "comparing")), len(every), say, provenance
    )


def facts(a: Path, b: Path) -> Iterator[Fact]:
    """Yield the Facts that differ between two files. Raises InputError for one that cannot be read."""
    for path in (a, b):
        if not path.is_file():
            raise InputError("not a file", file=path)
    if a.suffix != b.suffix:
        raise InputError("files of two kinds", file=b, value=b.suffix, allowed=a.suffix or "no suffix")
    try:
        same = filecmp.cmp(a, b, shallow=False)
    except OSError as exc:
        raise InputError(f"cannot be read: {exc.strerror}", file=exc.filename or a) from None
    if not same:
        yield from (BY_NAME.get(a.name) or BY_SUFFIX.get(a.suffix.lower(), texts.text_facts))(a, b)


def _tell(found: Iterable[tuple[str, list[Fact]]], total: int, say: Callable[[str], object], provenance: bool) -> int:
    """Print the Facts of (product, Facts) pairs, then a summary; return how many products differ."""
    unlike = 0
    made: dict[str | None, set[str]] = {}
    for name, facts in found:
        counted = [fact for fact in facts if provenance or not fact.provenance]
        for fact in facts:
            made.setdefault(fact.provenance, set()).add(name)
        for fact in counted:
            say(f"{name}: {fact.text}")
        unlike += bool(counted)
    made.pop(None, None)
    if made and not provenance:
        products = len(set().union(*made.values()))
        names = ", ".join(sorted(filter(None, made)))
        say(f"provenance differs in {number_of(products, 'product')}, which does not count: {names}")
    verdict = f"{unlike} {'differs' if unlike == 1 else 'differ'}" if unlike else "all the same"
    say(f"{number_of(total, 'product')} compared, {verdict}")
    return unlike


def _found(a: Path, b: Path, name: str, names: Sequence[set[str]]) -> list[Fact]:
    for side, mine, other in (("A", *names), ("B", *names[::-1])):
        if name in mine and name not in other:
            return [Fact(f"only {side} has it")]
    try:
        return list(facts(a / name, b / name))
    except InputError as exc:
        return [Fact(f"cannot be compared: {exc}")]


def _products(folder: Path) -> set[str]:
    """Return the names of all products below a folder, without half-written files."""
    found = set()
    for place, below, files in os.walk(folder):
        below[:] = [name for name in below if name not in BESIDE_PRODUCTS]
        names = (n for n in files if n not in BESIDE_PRODUCTS and not (n.startswith(".") and ".tmp" in n))
        found |= {(Path(place) / name).relative_to(folder).as_posix() for name in names}
    return found
