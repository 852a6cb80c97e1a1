"""Reads numbers from HDF5 files of any origin, and checks each dataset before it is read.

A dataset may declare more bytes than fit into memory, or be stored in another file or device.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from csstsim.base.errors import InputError

if TYPE_CHECKING:
    import h5py

    from csstsim.base.types import AnyArray, PathLike

MAX_BYTES = 1 << 28  # of a dataset


def group(parent: h5py.Group, name: str, path: PathLike) -> h5py.Group:
    """Return the group `name` of an h5py group in the file `path`. Raises InputError if there is none."""
    import h5py

    member = parent.get(name)
    if not isinstance(member, h5py.Group):
        raise InputError("group is missing", file=path, key=f"{parent.name}/{name}".strip("/"))
    return member


def numbers(parent: h5py.Group, name: str, path: PathLike) -> AnyArray:
    """Return the dataset `name` of an h5py group in the file `path`, an array of integers or floats.

    Raises InputError if it is missing, does not contain numbers, is larger than MAX_BYTES, or is stored elsewhere.
    """
    import h5py

    key = f"{parent.name}/{name}".strip("/")
    dataset = parent.get(name)
    if not isinstance(dataset, h5py.Dataset) or dataset.shape is None:
        raise InputError("dataset is missing", file=path, key=key)
    if dataset.dtype.kind not in "iuf":
        raise InputError("must be numbers", file=path, key=key, value=str(dataset.dtype))
    if dataset.size * dataset.dtype.itemsize > MAX_BYTES:
        raise InputError("too large", file=path, key=key, value=dataset.shape, allowed=f"{MAX_BYTES >> 20} MB")
    if dataset.external or dataset.is_virtual:
        raise InputError("its numbers are stored in another file", file=path, key=key)
    return dataset[()]
