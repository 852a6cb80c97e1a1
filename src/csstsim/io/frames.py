"""Intermediate frames between the stages of a chip: named planes and a dictionary, in one FITS file.

One image extension a plane (float32, int32, uint16, uint8; bit-exact), then META, the dictionary as JSON bytes. Each
HDU carries DATASUM and CHECKSUM, which reading verifies, and the file appears under its name only when complete.
"""

import json

import numpy as np

from csstsim.base.errors import InputError
from csstsim.base.files.atomic import atomic_path
from csstsim.io.fits import open_fits, read_pixels, verify_hdu, write_hdus

DTYPES = ("float32", "int32", "uint16", "uint8")
META = "META"


def save_frame(path, planes, meta):
    """Write `planes` {name: 2-D array, or None to leave it out} and `meta` (JSON-like) to `path`.

    Raises ValueError for an array of another type than DTYPES or of other than two dimensions.
    """
    planes = {name: plane for name, plane in planes.items() if plane is not None}
    for name, plane in planes.items():
        if plane.ndim != 2 or plane.dtype.name not in DTYPES or not plane.size:
            raise ValueError(f"plane {name!r}: {plane.dtype} of shape {plane.shape}; allowed: 2-D {', '.join(DTYPES)}")
    text = np.frombuffer(json.dumps(meta, sort_keys=True, allow_nan=False).encode(), np.uint8)
    hdus = [("", [], None), *((name.upper(), [], plane) for name, plane in planes.items()), (META, [], text)]
    with atomic_path(path) as temporary:
        write_hdus(temporary, hdus)


def load_frame(path, expect=None):
    """Return (planes, meta) as given to `save_frame`.

    `expect` {key: value} names what must stand in `meta`, or, for the key 'shape', the shape of every plane.
    Raises InputError if the file is missing, truncated, altered, not a frame, or not what is expected.
    """
    planes, meta = {}, None
    with open_fits(path) as file:
        for hdu in file:
            name = hdu.get_extname()
            if not name:
                verify_hdu(hdu, path)
            elif name == META:
                meta = _record(read_pixels(hdu, path, verify=True), path)
            else:
                planes[name.lower()] = read_pixels(hdu, path, verify=True)
    if meta is None:
        raise InputError("not an intermediate frame of csstsim: it has no META extension", file=path)
    for key, wanted in (expect or {}).items():
        if key == "shape":
            for name, plane in planes.items():
                _compare(path, f"shape of {name}", list(plane.shape), list(wanted))
        else:
            _compare(path, key, meta.get(key), json.loads(json.dumps(wanted)))
    return planes, meta


def _record(pixels, path):
    try:
        meta = json.loads(pixels.tobytes())
    except (ValueError, RecursionError):  # also text that is not UTF-8
        meta = None
    if not isinstance(meta, dict) or not isinstance(meta.get("exposure", {}), dict | None):
        raise InputError("damaged: its record cannot be read", file=path, key=META)
    return meta


def _compare(path, key, found, wanted):
    if found != wanted:
        raise InputError("made for something else; remove the file", file=path, key=key, value=found, allowed=wanted)
