"""HDF5 files compared (PSF sets and their tables), a node at a time."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING

from csstsim.base.errors import InputError
from csstsim.base.files.hdf5_file import MAX_BYTES
from csstsim.optics.psf.psf_file import intact
from csstsim.studies.compare.facts import array_facts, only_in_one
from csstsim.studies.compare.records import record_facts

if TYPE_CHECKING:
    from h5py import Dataset, File

    from csstsim.studies.compare.facts import Fact

UNITS = {"nodes_xy": "px", "nodes_uv": "deg", "wavelength": "angstrom", "tilt": "px"}  # optics.psf.psf_file.DATASETS


def hdf5_facts(a: Path, b: Path) -> Iterator[Fact]:
    """Yield Facts about two HDF5 files of numbers. Raises InputError for one that is damaged or has other contents."""
    with ExitStack() as stack:
        (attributes_a, datasets_a), (attributes_b, datasets_b) = (_opened(path, stack) for path in (a, b))
        yield from record_facts("attribute ", attributes_a, attributes_b)
        yield from only_in_one("datasets", datasets_a, datasets_b)
        for name in (name for name in datasets_a if name in datasets_b):
            pair = (datasets_a[name], datasets_b[name])
            unit = UNITS.get(name, "")
            yield from array_facts(f"dataset {name}", *pair, noun="values", unit=unit, position=_position)


def _opened(path: Path, stack: ExitStack) -> tuple[dict[str, object], dict[str, Dataset]]:
    """Return ({name: attribute}, {name: dataset}) of a file that `stack` closes. Raises InputError if it is damaged."""
    import h5py

    with intact(path):
        file = stack.enter_context(h5py.File(path, "r"))
        datasets = _datasets(file, path)
        for item in datasets.values():
            if item.chunks:  # reading tests its checksums
                item[()]
        return {name: _python_value(value) for name, value in file.attrs.items()}, datasets


def _datasets(file: File, path: Path) -> dict[str, Dataset]:
    """Return {name: dataset} of a file. Raises InputError for one that cannot be compared."""
    import h5py

    datasets = {}
    file.visititems(lambda name, item: datasets.update({name: item}) if isinstance(item, h5py.Dataset) else None)
    for name, item in datasets.items():
        is_external = item.external or item.is_virtual
        if item.shape is None or item.dtype.kind not in "biuf" or item.dtype.itemsize > 8 or is_external:
            raise InputError("not numbers in this file", file=path, key=name, value=str(item.dtype))
        values_read = item.size if item.chunks or not item.ndim else item.size // max(1, len(item))
        if values_read * item.dtype.itemsize > MAX_BYTES:
            raise InputError("too large", file=path, key=name, value=item.shape, allowed=f"{MAX_BYTES >> 20} MB")
    return datasets


def _position(*index: int) -> str:
    return f"at [{', '.join(str(int(i)) for i in index)}]"


def _python_value(value: object) -> object:
    value = value.tolist() if hasattr(value, "tolist") else value
    return value.decode("utf-8", "backslashreplace") if isinstance(value, bytes) else value
