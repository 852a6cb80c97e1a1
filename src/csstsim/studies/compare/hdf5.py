"""HDF5 files compared (PSF sets and their tables), a node at a time."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING

from csstsim.base.errors import InputError
from csstsim.base.files.hdf5_file import LARGEST
from csstsim.optics.psf.psf_file import intact
from csstsim.studies.compare.facts import alone, array_facts
from csstsim.studies.compare.records import record_facts

if TYPE_CHECKING:
    from h5py import Dataset, File

    from csstsim.studies.compare.facts import Fact

UNITS = {"nodes_xy": "px", "nodes_uv": "deg", "wavelength": "angstrom", "tilt": "px"}  # optics.psf.psf_file.DATASETS


def hdf5_facts(a: Path, b: Path) -> Iterator[Fact]:
    """Yield Facts about two HDF5 files of numbers. Raises InputError for one that is damaged or holds other things."""
    with ExitStack() as stack:
        (attributes_a, first), (attributes_b, second) = (_opened(path, stack) for path in (a, b))
        yield from record_facts("attribute ", attributes_a, attributes_b)
        yield from alone("datasets", first, second)
        for name in (name for name in first if name in second):
            pair = (first[name], second[name])
            unit = UNITS.get(name, "")
            yield from array_facts(f"dataset {name}", *pair, things="values", unit=unit, place=_place)


def _opened(path: Path, stack: ExitStack) -> tuple[dict[str, object], dict[str, Dataset]]:
    """Return ({name: attribute}, {name: dataset}) of a file that `stack` closes. Raises InputError if it is damaged."""
    import h5py

    with intact(path):
        file = stack.enter_context(h5py.File(path, "r"))
        found = _datasets(file, path)
        for item in found.values():
            if item.chunks:  # has checksums
                item[()]
        return {name: _plain(value) for name, value in file.attrs.items()}, found


def _datasets(file: File, path: Path) -> dict[str, Dataset]:
    """Return {name: dataset} of a file. Raises InputError for one that cannot be compared."""
    import h5py

    found = {}
    file.visititems(lambda name, item: found.update({name: item}) if isinstance(item, h5py.Dataset) else None)
    for name, item in found.items():
        kept_elsewhere = item.external or item.is_virtual
        if item.shape is None or item.dtype.kind not in "biuf" or item.dtype.itemsize > 8 or kept_elsewhere:
            raise InputError("not numbers in this file", file=path, key=name, value=str(item.dtype))
        at_once = item.size if item.chunks or not item.ndim else item.size // max(1, len(item))
        if at_once * item.dtype.itemsize > LARGEST:
            raise InputError("too large", file=path, key=name, value=item.shape, allowed=f"{LARGEST >> 20} MB")
    return found


def _place(*index: int) -> str:
    return f"at [{', '.join(str(int(i)) for i in index)}]"


def _plain(value: object) -> object:
    value = value.tolist() if hasattr(value, "tolist") else value
    return value.decode("utf-8", "backslashreplace") if isinstance(value, bytes) else value
