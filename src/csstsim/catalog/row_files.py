"""Files that rows of a table name: images and spectra, found beside the table, read once and checked row by row."""

import hashlib
from pathlib import Path

import numpy as np

from csstsim.base.errors import InputError
from csstsim.base.files.kept import kept
from csstsim.catalog.galaxy_shapes.images import read_picture, sky_of
from csstsim.catalog.light.file_spectra import read_spectrum
from csstsim.catalog.table import FILE_COLUMNS, GALAXY
from csstsim.instrument.filter import GRID


def named(columns, name, where):
    """Return (n,) paths of a column of files, relative ones beside the table `where`; "" for blanks."""
    values = np.asarray(columns[name])
    if values.dtype.kind not in "US":
        blank = not len(values) or (values.dtype.kind == "f" and np.isnan(values).all())
        if not blank:
            raise InputError("must be names of files", file=where, key=name, value=str(values[:1]))
        return np.full(len(values), "", dtype="U1")
    folder = Path(where).parent if Path(where).is_file() else Path()
    found = {
        text: "" if text.strip().lower() in ("", "nan") else str(folder / text.strip())
        for text in np.unique(values).tolist()
    }
    return np.array([found[text] for text in values.tolist()], dtype=str)


def with_images(columns, obj_type, where):
    """Return columns with the sizes of images: size_disk, size_bulge (half-light radius) and image_radius [arcsec].

    Raises InputError, which names `where` and the first row with an image that cannot be drawn.
    """
    columns, count = dict(columns), len(obj_type)
    files = columns["image_file"] = named(columns, "image_file", where)
    scale, angle = (
        np.nan_to_num(np.asarray(columns.get(name, np.zeros(count)), float)) for name in ("image_scale", "image_pa")
    )
    columns["image_scale"], columns["image_pa"], columns["image_radius"] = scale, angle, np.zeros(count)
    for part in ("size_disk", "size_bulge"):
        columns[part] = np.array(columns.get(part, np.zeros(count)), float)
    for row in np.flatnonzero(files != ""):
        picture = _of_row(read_picture, files[row], row, where)
        if obj_type[row] != GALAXY:
            raise InputError(f"row {row + 1}: only a galaxy has an image", file=where, key="type")
        if not scale[row] > 0 and (scale[row] < 0 or picture.sky is None):
            message = f"row {row + 1}: the image has no WCS, so its scale is needed"
            raise InputError(message, file=where, key="image_scale", value=scale[row], allowed="arcsec per pixel")
        sky = sky_of(picture, scale[row], angle[row])
        columns["image_radius"][row] = picture.radius * np.linalg.norm(sky, 2)
        columns["size_disk"][row] = columns["size_bulge"][row] = picture.half_light * np.sqrt(abs(np.linalg.det(sky)))
    return columns


def check_spectra(files, mags, where):
    """Raise InputError for the first row whose spectrum's file cannot be used.

    files (n,); mags {band: (n,)}: the keys are Filters, or names, and then light within the band is not checked.
    """
    values = np.stack(list(mags.values()), axis=1)
    known = np.isfinite(values).sum(axis=1)
    for row in np.flatnonzero(files != ""):
        _of_row(read_spectrum, files[row], row, where)
        if known[row] != 1:
            message = f"row {row + 1}: a spectrum from a file has one magnitude"
            raise InputError(message, file=where, key="spectrum_file", value=f"{known[row]} magnitudes")
        band = list(mags)[int(np.flatnonzero(np.isfinite(values[row]))[0])]
        if not isinstance(band, str) and not (read_spectrum(files[row]) * band.at(GRID)).any():
            message = f"row {row + 1}: the spectrum has no light in the band of the row's magnitude"
            raise InputError(message, file=where, key="spectrum_file", value=f"{files[row]}, {band.name}")


def _of_row(read, name, row, where):
    try:
        return read(name)
    except InputError as error:
        raise InputError(f"row {row + 1}: {error}", file=where) from None


def files_of(columns, where):
    """Return the files, each once, that a table's columns name."""
    found = set()
    for name in FILE_COLUMNS:
        if name in columns:
            found |= {text.split("[")[0] for text in named(columns, name, where).tolist() if text}
    return tuple(sorted(found))


@kept(4096)
def digest_of(name):
    """Return a hash of the content of a named file, with the part of it that is meant; "" of no name."""
    if not name:
        return ""
    path, _, part = name.partition("[")
    return hashlib.sha256(Path(path).read_bytes()).hexdigest()[:16] + part
