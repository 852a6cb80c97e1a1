"""Intermediate frames between the stages of a chip: named planes and a dictionary, in one FITS file.

Each plane is an image extension (float32, int32, uint16, uint8; bit-exact); META has the dictionary as JSON bytes. A
plane of mostly zeros, such as the counted photons, may be stored as two extensions of one row: NAME_AT, the flat
indices of the nonzero pixels, and NAME_IS, their values; META has its shape. Each HDU has DATASUM and CHECKSUM, which
reading verifies. The file gets its name only when it is complete.
"""

import json
import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Literal, cast, overload

import numpy as np

from csstsim.base.errors import InputError
from csstsim.base.files.atomic import atomic_path
from csstsim.base.types import AnyArray, PathLike
from csstsim.detector.sparse_plane import SparsePlane
from csstsim.io.fits import PIXELS_MAX, open_fits, read_pixels, verify_hdu
from csstsim.io.fits_writing import write_hdus

DTYPES = ("float32", "int32", "uint16", "uint8")
META = "META"
# Suffixes of the names of a sparse plane's two extensions
_INDICES = "_at"
_VALUES = "_is"


def save_frame(
    path: PathLike, planes: Mapping[str, AnyArray | None], meta: dict[str, Any], sparse: Iterable[str] = ()
) -> None:
    """Write `planes` {name: 2-D array, or None to leave it out} and `meta` (JSON-like) to `path`.

    sparse: names of int32 planes of which only the nonzero pixels are written, if that is shorter.
    Raises ValueError for an array of another type than DTYPES or of other than two dimensions.
    """
    stored = {name: plane for name, plane in planes.items() if plane is not None}
    for name, plane in stored.items():
        if plane.ndim != 2 or plane.dtype.name not in DTYPES or not plane.size:
            raise ValueError(f"plane {name!r}: {plane.dtype} of shape {plane.shape}; allowed: 2-D {', '.join(DTYPES)}")
    shapes = {name: stored[name].shape for name in sparse if name in stored and _mostly_zero(stored[name])}
    for name in shapes:
        stored |= _split(name, stored.pop(name))
    meta = meta | {"sparse": shapes} if shapes else meta
    text = np.frombuffer(json.dumps(meta, sort_keys=True, allow_nan=False).encode(), np.uint8)
    hdus: list[tuple[str, list[str], AnyArray | None]]
    hdus = [("", [], None), *((name.upper(), [], plane) for name, plane in stored.items()), (META, [], text)]
    with atomic_path(path) as temporary:
        write_hdus(temporary, hdus)


def _mostly_zero(plane: AnyArray) -> bool:
    return bool(np.count_nonzero(plane) < plane.size / 4)


def _split(name: str, plane: AnyArray) -> dict[str, AnyArray]:
    indices = np.flatnonzero(plane).astype(np.int32)
    indices = indices if indices.size else np.zeros(1, np.int32)  # FITS has no empty image
    return {name + _INDICES: indices[None], name + _VALUES: plane.reshape(-1)[indices][None]}


def _join(planes: dict[str, Any], shapes: Mapping[str, Sequence[int]], path: PathLike) -> None:
    """Replace the two parts of each plane of `shapes` by a SparsePlane. Raises InputError for parts that do not fit."""
    for name, shape in shapes.items():
        indices = planes.pop(name + _INDICES, None)
        values = planes.pop(name + _VALUES, None)
        size = math.prod(shape)
        valid = (
            indices is not None
            and values is not None
            and indices.dtype == values.dtype == np.int32
            and indices.size == values.size
        )
        if not (
            valid
            and size <= PIXELS_MAX
            and indices[0, 0] >= 0
            and indices[0, -1] < size
            and (indices[0, 1:] > indices[0, :-1]).all()
        ):
            raise InputError("damaged: the parts of a plane do not fit it", file=path, key=name)
        planes[name] = SparsePlane(cast("tuple[int, int]", tuple(shape)), indices[0], values[0])


@overload
def load_frame(
    path: PathLike, expect: Mapping[str, Any] | None = None, sparse: Literal[False] = False
) -> tuple[dict[str, AnyArray], dict[str, Any]]: ...


@overload
def load_frame(
    path: PathLike, expect: Mapping[str, Any] | None = None, *, sparse: Literal[True]
) -> tuple[dict[str, AnyArray | SparsePlane], dict[str, Any]]: ...


def load_frame(
    path: PathLike, expect: Mapping[str, Any] | None = None, sparse: bool = False
) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return the planes and the dictionary of an intermediate frame.

    Parameters
    ----------
    path : str or Path
        File of `save_frame`.
    expect : mapping, optional
        Required entries {key: value} of the dictionary; the key 'shape' is the shape of every plane.
    sparse : bool
        Whether planes that are stored as two extensions are returned as SparsePlanes.

    Returns
    -------
    planes : dict
        {name: (ny, nx) array}.
    meta : dict
        {name: JSON-like value}.

    Raises
    ------
    InputError
        If the file is missing, truncated, altered, not a frame, or not what is expected.
    """
    planes: dict[str, Any] = {}
    meta = None
    with open_fits(path) as file:
        for hdu in file:
            name = hdu.get_extname()
            if not name:
                verify_hdu(hdu, path)
            elif name == META:
                meta = _metadata(read_pixels(hdu, path, verify=True), path)
            else:
                planes[name.lower()] = read_pixels(hdu, path, verify=True)
    if meta is None:
        raise InputError("not an intermediate frame of csstsim: it has no META extension", file=path)
    shapes = meta.pop("sparse", {})
    _join(planes, shapes, path)
    if not sparse:
        planes |= {name: planes[name].dense() for name in shapes}
    for key, expected in (expect or {}).items():
        if key == "shape":
            for name, plane in planes.items():
                _compare(path, f"shape of {name}", list(plane.shape), list(expected))
        else:
            _compare(path, key, meta.get(key), json.loads(json.dumps(expected)))
    return planes, meta


def _metadata(pixels: AnyArray, path: PathLike) -> dict[str, Any]:
    try:
        meta = json.loads(pixels.tobytes())
    except (ValueError, RecursionError):  # also text that is not UTF-8
        meta = None
    valid = isinstance(meta, dict) and isinstance(meta.get("exposure", {}), dict | None)
    if not (valid and _are_shapes(meta.get("sparse", {}))):
        raise InputError("damaged: its metadata cannot be read", file=path, key=META)
    return meta


def _are_shapes(value: object) -> bool:
    shapes = value.values() if isinstance(value, dict) else [None]
    return all(
        isinstance(shape, list) and len(shape) == 2 and all(type(n) is int and n > 0 for n in shape) for shape in shapes
    )


def _compare(path: PathLike, key: str, value: object, expected: object) -> None:
    if value != expected:
        raise InputError("made from another recipe; remove the file", file=path, key=key, value=value, allowed=expected)
