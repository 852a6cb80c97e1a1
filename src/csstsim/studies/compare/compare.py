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
from csstsim.studies.compare.varying import NOT_PRODUCTS

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


def compare(a: PathLike, b: PathLike, log: Callable[[str], object], provenance: bool = False) -> int:
    """Log each difference between two folders or two files, then the number of products that differ; return it.

    provenance: differences in how a product was made count, too; otherwise one line lists them. A product that cannot
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
        return _report({a.name: list(facts(a, b))}.items(), 1, log, provenance)
    names = [_products(folder) for folder in (a, b)]
    for folder, products in zip((a, b), names, strict=True):
        if not products:
            raise InputError("holds no product", file=folder, allowed="an output folder")
    all_names = sorted(set().union(*names))
    differing = ((name, _product_facts(a, b, name, names)) for name in progress(all_names, "comparing"))
    return _report(differing, len(all_names), log, provenance)


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


def _report(
    products: Iterable[tuple[str, list[Fact]]], total: int, log: Callable[[str], object], provenance: bool
) -> int:
    """Log the Facts of (product, Facts) pairs, then a summary; return how many products differ."""
    n_different = 0
    products_by_provenance: dict[str | None, set[str]] = {}
    for name, facts_of_product in products:
        counted = [fact for fact in facts_of_product if provenance or not fact.provenance]
        for fact in facts_of_product:
            products_by_provenance.setdefault(fact.provenance, set()).add(name)
        for fact in counted:
            log(f"{name}: {fact.text}")
        n_different += bool(counted)
    products_by_provenance.pop(None, None)
    if products_by_provenance and not provenance:
        n_products = len(set().union(*products_by_provenance.values()))
        names = ", ".join(sorted(filter(None, products_by_provenance)))
        log(f"provenance differs in {number_of(n_products, 'product')}, which does not count: {names}")
    verdict = f"{n_different} {'differs' if n_different == 1 else 'differ'}" if n_different else "all the same"
    log(f"{number_of(total, 'product')} compared, {verdict}")
    return n_different


def _product_facts(a: Path, b: Path, name: str, names: Sequence[set[str]]) -> list[Fact]:
    for side, own, other in (("A", *names), ("B", *names[::-1])):
        if name in own and name not in other:
            return [Fact(f"only {side} has it")]
    try:
        return list(facts(a / name, b / name))
    except InputError as exc:
        return [Fact(f"cannot be compared: {exc}")]


def _products(folder: Path) -> set[str]:
    """Return the names of all products below a folder, without half-written files."""
    products = set()
    for path, folders, files in os.walk(folder):
        folders[:] = [name for name in folders if name not in NOT_PRODUCTS]
        names = (n for n in files if n not in NOT_PRODUCTS and not (n.startswith(".") and ".tmp" in n))
        products |= {(Path(path) / name).relative_to(folder).as_posix() for name in names}
    return products
