"""Files that rows of a table name: images and spectra, with paths relative to the table, read once and checked."""

from __future__ import annotations

import hashlib
import logging
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from csstsim.base.errors import InputError
from csstsim.base.files.lru_by_file_state import lru_by_file_state
from csstsim.base.plural import number_of
from csstsim.catalog.galaxy_shapes.images import read_image, sky_of
from csstsim.catalog.light.file_spectra import load_spectrum, read_spectrum
from csstsim.catalog.table import FILE_COLUMNS, GALAXY
from csstsim.instrument.filter import GRID, Filter

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping
    from typing import TypeVar

    from numpy.typing import ArrayLike

    from csstsim.base.types import AnyArray, PathLike

    ColumnT = TypeVar("ColumnT", bound=ArrayLike)
    ResultT = TypeVar("ResultT")


def file_paths(columns: Mapping[str, ArrayLike], name: str, where: PathLike) -> AnyArray:
    """Return (n,) paths of a column of files, relative ones from the folder of the table `where`; "" for blanks."""
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


def with_images(columns: Mapping[str, ColumnT], obj_type: AnyArray, where: PathLike) -> dict[str, ColumnT | AnyArray]:
    """Return columns with the sizes of images: size_disk, size_bulge (half-light radius) and image_radius [arcsec].

    Raises InputError, which names `where` and the first row with an image that cannot be rendered.
    """
    found: dict[str, ColumnT | AnyArray] = {**columns}
    count = len(obj_type)
    files = found["image_file"] = file_paths(columns, "image_file", where)
    scale, angle = (
        np.nan_to_num(np.asarray(columns.get(name, np.zeros(count)), float)) for name in ("image_scale", "image_pa")
    )
    radius = np.zeros(count)
    found["image_scale"] = scale
    found["image_pa"] = angle
    found["image_radius"] = radius
    disk, bulge = (np.array(columns.get(part, np.zeros(count)), float) for part in ("size_disk", "size_bulge"))
    found["size_disk"] = disk
    found["size_bulge"] = bulge
    for row in np.flatnonzero(files != ""):
        image = _read_for_row(read_image, files[row], row, where)
        if obj_type[row] != GALAXY:
            raise InputError(f"row {row + 1}: only a galaxy has an image", file=where, key="type")
        if not scale[row] > 0 and (scale[row] < 0 or image.sky is None):
            message = f"row {row + 1}: the image has no WCS, so its scale is needed"
            raise InputError(message, file=where, key="image_scale", value=scale[row], allowed="arcsec per pixel")
        sky = sky_of(image, scale[row], angle[row])
        radius[row] = image.radius * np.linalg.norm(sky, 2)
        disk[row] = bulge[row] = image.half_light * np.sqrt(abs(np.linalg.det(sky)))
    return found


def check_spectra(files: AnyArray, mags: Mapping[Filter | str, AnyArray], where: PathLike) -> None:
    """Raise InputError for the first row whose spectrum's file cannot be used; warn of files that end inside a band.

    files (n,); mags {band: (n,)} of all bands, NaN where not known: the keys are Filters, or names; with names the flux
    in the band is not checked.
    """
    values = np.stack(list(mags.values()), axis=1)
    known = np.isfinite(values).sum(axis=1)
    for row in np.flatnonzero(files != ""):
        _read_for_row(read_spectrum, files[row], row, where)
        if known[row] != 1:
            message = f"row {row + 1}: a spectrum from a file has one magnitude"
            raise InputError(message, file=where, key="spectrum_file", value=f"{known[row]} magnitudes")
        band = list(mags)[int(np.flatnonzero(np.isfinite(values[row]))[0])]
        if not isinstance(band, str) and not (read_spectrum(files[row]) * band.at(GRID)).any():
            message = f"row {row + 1}: the spectrum has no flux in the band of the row's magnitude"
            raise InputError(message, file=where, key="spectrum_file", value=f"{files[row]}, {band.name}")
    _warn_of_ends(sorted(set(files) - {""}), [band for band in mags if not isinstance(band, str)], where)


def _warn_of_ends(names: list[str], bands: list[Filter], where: PathLike) -> None:
    """Warn if spectra end where a band still has a hundredth of its highest throughput: beyond, they have no flux."""
    ends = {band.name: GRID[band.at(GRID) > 0.01 * band.at(GRID).max()][[0, -1]] for band in bands}
    cut = {}
    for name in names:
        _, first, last = load_spectrum(name)
        if missed := [band for band, (blue, red) in ends.items() if first > blue or last < red]:
            cut[name] = f"{name}: {first:g} to {last:g} angstrom, not all of {', '.join(missed)}"
    if cut:
        text = "%s: %s not cover all bands, and no flux beyond their ends is rendered (%s)"
        files = number_of(len(cut), "spectrum file") + (" does" if len(cut) == 1 else " do")
        logging.getLogger("csstsim").warning(text, where, files, next(iter(cut.values())))


def _read_for_row(read: Callable[[str], ResultT], name: str, row: np.intp, where: PathLike) -> ResultT:
    try:
        return read(name)
    except InputError as error:
        raise InputError(f"row {row + 1}: {error}", file=where) from None


def files_of(columns: Mapping[str, ArrayLike], where: PathLike) -> tuple[str, ...]:
    """Return the files, each once, that a table's columns name."""
    found = set()
    for name in FILE_COLUMNS:
        if name in columns:
            found |= {text.split("[")[0] for text in file_paths(columns, name, where).tolist() if text}
    return tuple(sorted(found))


@lru_by_file_state(4096)
def digest_of(name: str) -> str:
    """Return a hash of the content of a named file, with the name of its extension or dataset; "" for no name."""
    if not name:
        return ""
    path, _, part = name.partition("[")
    return hashlib.sha256(Path(path).read_bytes()).hexdigest()[:16] + part
