"""`csstsim verify`: every product is in the output folder, undamaged, and of this campaign; nothing else is."""

from __future__ import annotations

import os
import stat
from typing import TYPE_CHECKING

from csstsim.base.errors import InputError
from csstsim.base.plural import number_of
from csstsim.base.process.progress import progress
from csstsim.delivery.contents import MAYBE, of_campaign
from csstsim.delivery.folder import of_folder
from csstsim.delivery.manifest import CRATE, FILES, HASHES, SIZES, manifest_faults, write_manifest
from csstsim.delivery.products import products
from csstsim.io.output_owner import OWNER_FILE

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
    from pathlib import Path

    from csstsim.base.types import PathLike
    from csstsim.campaign.opened import OpenCampaign
    from csstsim.delivery.contents import Contents
    from csstsim.delivery.products import Product

# Files and folders of the workflow (benchmarks: of an older one), neither products nor foreign
WORKFLOW_FILES = ("logs", "benchmarks", ".snakemake", "chosen", "look", "variants", OWNER_FILE)

# What a reader raises for a file of good checksums and wrong content: a column of text, a record that is no number
WRONG = (ArithmeticError, AttributeError, LookupError, TypeError, ValueError, MemoryError)


def verify(run: OpenCampaign | None, folder: PathLike, log: Callable[[str], object], manifest: bool = False) -> int:
    """Print each fault of an output folder in a line, then their number; return it.

    run: campaign.opened.OpenCampaign; None: the `folder` is checked by its own products. `manifest`: write one if there
    is no fault; otherwise an existing one is checked. Raises InputError if there is nothing to verify.
    """
    contents = of_folder(folder) if run is None else of_campaign(run)
    root = contents.paths.output
    if not root.is_dir():
        raise InputError("no such folder: nothing was made yet", file=root)
    expected = products(contents)
    names = {product.path: product.path.relative_to(root).as_posix() for product in expected}
    count = 0
    for name, fault in _all_faults(contents, root, expected, names, check_manifest=not manifest):
        count += 1
        log(printable(f"{name}: {fault}"))
    present = [product for product in expected if product.path.is_file()]
    size = sum(product.path.stat().st_size for product in present)
    verdict = number_of(count, "fault") if count else "sound"
    log(f"{root}: {number_of(len(present), 'product')}, {size / 1e9:.3g} GB: {verdict}")
    if manifest and not count:
        missing = {} if run is None else run.declared_missing
        rows = [(obsid, chip, " ".join(reason.split())) for (obsid, chip), reason in sorted(missing.items())]
        write_manifest(root, {names[product.path]: product.kind for product in present}, rows)
        log(f"{root / HASHES} and {SIZES}: for the receiver, `sha256sum -c {HASHES}` in that folder")
    elif manifest:
        log("no manifest was written: the folder has faults")
    return count


def printable(text: str) -> str:
    """Return a text on one line, control characters of a terminal written as escapes."""
    return "".join(c if c.isprintable() else ascii(c)[1:-1] for c in text)


def _all_faults(
    contents: Contents, root: Path, expected: Sequence[Product], names: Mapping[Path, str], *, check_manifest: bool
) -> Iterator[tuple[str, str]]:
    """Yield (path below the folder, fault)."""
    for path, fault in contents.faults:
        yield path.relative_to(root).as_posix(), fault
    for product in progress(expected, "verifying", len(expected)):
        for fault in _product_faults(product):
            yield names[product.path], fault
    yield from _foreign(root, set(names.values()))
    if check_manifest:
        present = {names[product.path] for product in expected if product.path.is_file()}
        required = {names[product.path] for product in expected if product.need != MAYBE}
        yield from manifest_faults(root, present, required)


def _product_faults(product: Product) -> Iterator[str]:
    """Yield the faults of one product."""
    try:
        mode = product.path.lstat().st_mode
    except FileNotFoundError:
        if product.need != MAYBE:
            yield f"missing ({product.kind})"
        return
    except OSError as exc:
        yield f"cannot be read: {exc.strerror}"
        return
    if not stat.S_ISREG(mode):  # reading a pipe would never end; the target of a link is not delivered
        yield "is a link, a folder or a device, not a file"
        return
    if product.check is None or not all(path.is_file() for path in product.requires):
        return
    try:
        yield from product.check()
    except InputError as exc:
        yield str(exc).removeprefix(" ".join(f"{product.path}: ".split()) + " ")
    except OSError as exc:
        yield f"cannot be read: {exc.strerror or exc}"
    except WRONG as exc:
        yield f"is inconsistent: {type(exc).__name__}: {exc!s:.100}"


def _foreign(root: Path, known: Collection[str]) -> Iterator[tuple[str, str]]:
    """Yield (path, fault) of files in the folder that are not products; a whole folder of them once."""
    folders = {"."} | {name.rsplit("/", depth)[0] for name in known for depth in range(1, name.count("/") + 1)}
    for folder, subfolders, files in os.walk(root):
        relative = os.path.relpath(folder, root)
        prefix = "" if relative == "." else relative.replace(os.sep, "/") + "/"
        for name in sorted(files):
            if prefix + name not in known and prefix + name not in (*FILES, *WORKFLOW_FILES, *CRATE):
                yield prefix + name, _why_foreign(prefix + name)
        for name in sorted(subfolders):
            path = os.path.join(folder, name)
            if prefix + name in known or (relative == "." and name in (*WORKFLOW_FILES, *CRATE)):
                continue
            if os.path.islink(path):
                yield prefix + name, "foreign: a link to a folder"
            elif prefix + name not in folders and any(contained for _, _, contained in os.walk(path)):
                yield prefix + name, _why_foreign(prefix + name + "/")
        subfolders[:] = sorted(
            n for n in subfolders if prefix + n in folders and not (relative == "." and n in (*WORKFLOW_FILES, *CRATE))
        )


def _why_foreign(name: str) -> str:
    if name.startswith("chips/"):
        return "intermediates of chips: not finished, or made by hand"
    if name.rsplit("/", 1)[-1].startswith(".") and ".tmp" in name:
        return "an incomplete file: its writing was interrupted"
    return "foreign: not a product of this campaign"
