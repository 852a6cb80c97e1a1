"""HDF5 files compared (PSF sets and their tables), a node at a time."""

from csstsim.base.errors import InputError
from csstsim.base.files.hdf5_file import LARGEST
from csstsim.compare.facts import Fact, array_facts
from csstsim.compare.records import record_facts
from csstsim.optics.psf.psf_file import intact

UNITS = {"nodes_xy": "px", "nodes_uv": "deg", "wavelength": "angstrom", "tilt": "px"}  # optics.psf.psf_file.DATASETS


def hdf5_facts(a, b):
    """Yield Facts about two HDF5 files of numbers. Raises InputError for one that is damaged or holds other things."""
    import h5py

    with intact(a), h5py.File(a, "r") as first, intact(b), h5py.File(b, "r") as second:
        files = [(first, _datasets(first, a)), (second, _datasets(second, b))]
        yield from record_facts("attribute ", *({k: _plain(v) for k, v in file.attrs.items()} for file, _ in files))
        names = [datasets for _, datasets in files]
        for mine, other, side in ((*names, "A"), (*names[::-1], "B")):
            yield from (Fact(f"dataset {name}: only {side} has it") for name in mine if name not in other)
        for name in (name for name in names[0] if name in names[1]):
            place = lambda *index: f"at [{', '.join(map(str, map(int, index)))}]"  # noqa: E731
            pair = (datasets[name] for datasets in names)
            yield from array_facts(f"dataset {name}", *pair, things="values", unit=UNITS.get(name, ""), place=place)


def _datasets(file, path):
    """Return {name: dataset} of a file. Raises InputError for one that cannot be compared."""
    import h5py

    found = {}
    file.visititems(lambda name, item: found.update({name: item}) if isinstance(item, h5py.Dataset) else None)
    for name, item in found.items():
        if item.shape is None or item.dtype.kind not in "biuf" or item.external or item.is_virtual:
            raise InputError("not numbers in this file", file=path, key=name, value=str(item.dtype))
        row = item.dtype.itemsize * (item.size // max(1, len(item)) if item.ndim else 1)
        if row > LARGEST:
            raise InputError("too large", file=path, key=name, value=item.shape, allowed=f"{LARGEST >> 20} MB a row")
    return found


def _plain(value):
    value = value.tolist() if hasattr(value, "tolist") else value
    return value.decode("utf-8", "backslashreplace") if isinstance(value, bytes) else value
