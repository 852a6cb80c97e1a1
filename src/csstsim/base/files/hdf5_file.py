"""Reads numbers from HDF5 files of any origin, and checks each dataset first.

A dataset may claim more bytes than any machine holds, or take its bytes from another file or device.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from csstsim.base.errors import InputError

if TYPE_CHECKING:
    import h5py

    from csstsim.base.types import AnyArray, PathLike

LARGEST = 1 << 28  # bytes of a dataset that is read whole


def group(parent: h5py.Group, name: str, path: PathLike) -> h5py.Group:
    """Return the group `name` of an h5py group in the file `path`. Raises InputError if there is none."""
    import h5py

    found = parent.get(name)
    if not isinstance(found, h5py.Group):
        raise InputError("group is missing", file=path, key=f"{parent.name}/{name}".strip("/"))
    return found


def numbers(parent: h5py.Group, name: str, path: PathLike) -> AnyArray:
    """Return the dataset `name` of an h5py group in the file `path`, an array of integers or floats.

    Raises InputError if it is missing, not of numbers, larger than LARGEST, or kept elsewhere.
    """
    import h5py

    key = f"{parent.name}/{name}".strip("/")
    found = parent.get(name)
    if not isinstance(found, h5py.Dataset) or found.shape is None:
        raise InputError("dataset is missing", file=path, key=key)
    if found.dtype.kind not in "iuf":
        raise InputError("must be numbers", file=path, key=key, value=str(found.dtype))
    if found.size * found.dtype.itemsize > LARGEST:
        raise InputError("too large", file=path, key=key, value=found.shape, allowed=f"{LARGEST >> 20} MB")
    if found.external or found.is_virtual:
        raise InputError("its numbers lie in another file", file=path, key=key)
    return found[()]
