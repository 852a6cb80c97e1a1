"""Conversion of an external PSF library in the layout of CSST's cycle 9 to csstsim's PSF files.

The library has one HDF5 file per chip, `psfCube_{chip}.h5`, with groups `w_<i>`, one per wavelength. Each has a group
`psf_<j>` per position with the dataset `psfMat`. This much is public: github DUT-astro/make_c9_star_cat (accee8d),
make_constant_psfcube.py and README.md (`w_2`, `psf_0`, `psf_450` of chip 6; the positions are in the file). A public
script that runs the official simulator gets 256 x 256 samples of 5 um from it. The paper has four wavelengths, 30 x 30
positions and, before a reduction, 512 x 512 samples of 2.5 um, which are accepted. No public text says the following,
so it is assumed:

* position: datasets or attributes of `psf_<j>`: `image_x`, `image_y` in mm from the boresight along the mosaic's axes,
  else `x`, `y` in 0-based pixels of the chip. The positions form a square grid.
* wavelength: `wavelength` of `psf_<j>` or of `w_<i>`, in um, nm or angstrom, recognised by its size; if it is missing,
  the filter's own.
* psfMat is [y, x] and contains all the light of the star; it is divided by its sum.
* the campaign states what a sample is: "cell_integral", or "point" (the brightness at the centre of a cell, which is
  convolved with the cell). The wrong choice is an error of 2-4% in size^2.

Each position is centred as in optics.psf.psf_set; the file's provenance records these choices.
"""

from __future__ import annotations

import hashlib
import math
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import h5py
import numpy as np

from csstsim.base.errors import InputError
from csstsim.base.files.hdf5_file import numbers
from csstsim.base.types import FloatArray, IntArray, PathLike
from csstsim.base.units import UM_PER_MM
from csstsim.optics.psf.chip_errors import chip_position
from csstsim.optics.psf.diffraction import windowed_centroid
from csstsim.optics.psf.psf_file import WAVELENGTHS, intact, pixel_response, write_psf
from csstsim.optics.psf.sampling import LIBRARY_PX, WINDOW_PX, psf_cube

if TYPE_CHECKING:
    from csstsim.instrument.chip import Chip
    from csstsim.instrument.filter import Filter

SAMPLES = ("cell_integral", "point")
_OVERSAMPLING = {samples: samples // LIBRARY_PX for samples in (256, 512)}
_POSITION_NAMES = (("image_x", "image_y"), ("x", "y"))
_ANGSTROM = ((2.0, 1e4), (2000.0, 10.0), (math.inf, 1.0))  # (upper limit, angstrom per unit) for um, nm, angstrom
_MARGIN_PX = 500  # largest distance of a position from the chip


def convert(folder: Path, path: PathLike, chip: Chip, filter: Filter, *, sample: str, camera_digest: str) -> None:
    """Read `psfCube_{chip}.h5` of a library `folder` and write the PSF file `path` (layout: optics.psf.psf_file).

    `sample`: what a sample of psfMat is, one of `SAMPLES`. Raises InputError for a missing, damaged or foreign file.
    """
    source = psf_cube(folder, chip.id)
    with intact(source), source.open("rb") as content:
        checksum = hashlib.file_digest(content, "sha256").hexdigest()
    with intact(source), h5py.File(source, "r") as file:
        cubes, nodes, unit, grid, cells = _layout(file, chip, source)
        oversampling = _OVERSAMPLING[cells]
        order = _row_by_row(nodes, grid)
        names = np.array(list(cubes[0]))[order]
        wavelength, known = _wavelengths(file, cubes, filter)
        about = {
            "cell_um": chip.detector.pixel_um / oversampling,
            "cell_arcsec": chip.telescope.pixel_scale / oversampling,
            "oversampling": oversampling,
            "chip": chip.id,
            "filter": filter.name,
            "grid": grid,
            "camera_digest": camera_digest,
        }
        provenance = {
            "library": source.name,
            "library_sha256": checksum,
            "read_as": f"{sample}; places: {unit}; wavelengths: {known}; sums set to 1; centred",
        }
        images = (_centred(_read(cubes, name, cells, source), sample, oversampling) for name in names)
        write_psf(path, nodes[order], wavelength, images, cells=cells, about=about, provenance=provenance)


def check_library(folder: Path, chip: Chip, filter: Filter) -> None:
    """Check the layout of `psfCube_{chip}.h5`: all that `convert` needs but the values of the images.

    Raises InputError as `convert`.
    """
    source = psf_cube(folder, chip.id)
    with intact(source), h5py.File(source, "r") as file:
        cubes, _, _, _, cells = _layout(file, chip, source)
        _wavelengths(file, cubes, filter)
        for name in cubes[0]:
            _check_sizes(cubes, name, cells, source)


class _Layout(NamedTuple):
    """The contents of a library's file.

    cubes: {name: group} of each wavelength; nodes (n, 2) px, n = grid^2; unit: how they are read; cells: samples along
    an image.
    """

    cubes: list[dict[str, h5py.Group]]
    nodes: FloatArray
    unit: str
    grid: int
    cells: int


def _layout(file: h5py.File, chip: Chip, source: Path) -> _Layout:
    """Return the _Layout of an opened file. Raises InputError if it is not that of a library."""
    cubes = [_places(file[name], source) for name in _numbered(file, "w", source)]
    if len(cubes) != WAVELENGTHS or len({tuple(c) for c in cubes}) != 1:
        raise InputError("not four wavelengths with the same positions", file=source, key="w_0 ... w_3")
    nodes, unit = _positions(cubes[0], chip, source)
    grid = math.isqrt(len(nodes))
    if grid < 2 or grid**2 != len(nodes):
        raise InputError("the positions form no square grid", file=source, key="psf_<j>", value=len(nodes))
    cells = next(iter(cubes[0].values()))["psfMat"].shape[-1]
    if cells not in _OVERSAMPLING:
        raise InputError("unknown sampling", file=source, key="psfMat", value=cells, allowed="256, 512 samples")
    return _Layout(cubes, nodes, unit, grid, cells)


def _numbered(group: h5py.Group, prefix: str, source: Path) -> list[str]:
    """Return the names `prefix`_<number> in a group, by number."""
    found = sorted((int(m[1]), name) for name in group if (m := re.fullmatch(rf"{prefix}_(\d+)", name)))
    if not found:
        raise InputError("not a PSF library", file=source, key=f"{group.name.strip('/')}/{prefix}_0".strip("/"))
    return [name for _, name in found]


def _places(group: h5py.Group, source: Path) -> dict[str, h5py.Group]:
    return {name: group[name] for name in _numbered(group, "psf", source)}


def _number(node: h5py.Group, name: str) -> float | None:
    """Return the number stored as a dataset or attribute of a group, or None."""
    if name in node:
        return float(numbers(node, name, node.file.filename).reshape(()))
    return float(np.asarray(node.attrs[name]).reshape(())) if name in node.attrs else None


def _positions(nodes: Mapping[str, h5py.Group], chip: Chip, source: Path) -> tuple[FloatArray, str]:
    """Return chip pixels (n, 2) and a text with the names and units they were read from."""
    for names in _POSITION_NAMES:
        found = [[_number(node, name) for name in names] for node in nodes.values()]
        if None not in (value for pair in found for value in pair):
            break
    else:
        raise InputError(
            "no positions", file=source, key="psf_<j>", allowed=" or ".join(map(", ".join, _POSITION_NAMES))
        )
    xy = np.array(found)
    unit = f"{', '.join(names)} in px of the chip"
    if names == _POSITION_NAMES[0]:
        px_per_mm = UM_PER_MM / chip.detector.pixel_um
        xy = np.stack(chip_position(chip, *(xy.T * px_per_mm)), axis=-1)
        unit = f"{', '.join(names)} in mm from the boresight"
    limit = np.array([chip.detector.nx, chip.detector.ny]) + _MARGIN_PX
    bad = ~((xy > -_MARGIN_PX) & (xy < limit)).all(axis=1)
    if bad.any():
        outside = xy[bad][0].tolist()
        raise InputError(f"not on chip {chip.id}, read as {unit}", file=source, key="psf_<j>", value=outside)
    return xy, unit


def _row_by_row(nodes: FloatArray, grid: int) -> IntArray:
    """Return the order that sorts the positions of a square grid into rows of increasing y, x fastest."""
    rows = np.argsort(nodes[:, 1], kind="stable").reshape(grid, grid)
    return np.concatenate([row[np.argsort(nodes[row, 0], kind="stable")] for row in rows])


def _wavelengths(file: h5py.File, cubes: Sequence[Mapping[str, h5py.Group]], filter: Filter) -> tuple[FloatArray, str]:
    """Return the four wavelengths (angstrom) and where they come from."""
    found = []
    for name, nodes in zip(_numbered(file, "w", file.filename), cubes, strict=True):
        value = _number(next(iter(nodes.values())), "wavelength") or _number(file[name], "wavelength")
        if value is None:
            return filter.psf_wavelength, "the filter's"
        found.append(value * next(factor for limit, factor in _ANGSTROM if value < limit))
    return np.array(found), "the library's"


def _check_sizes(cubes: Sequence[Mapping[str, h5py.Group]], name: str, cells: int, source: Path) -> None:
    """Raise InputError unless the images at one position are (cells, cells)."""
    if any(cube[name]["psfMat"].shape != (cells, cells) for cube in cubes):
        raise InputError("not square images of one size", file=source, key=f"{name}/psfMat")


def _read(cubes: Sequence[Mapping[str, h5py.Group]], name: str, cells: int, source: Path) -> FloatArray:
    """Return the images at one position, (4, cells, cells) float64, each of sum 1."""
    _check_sizes(cubes, name, cells, source)
    images = np.stack([numbers(cube[name], "psfMat", source).astype(float) for cube in cubes])
    total = images.sum(axis=(1, 2))
    if not (np.isfinite(total) & (total > 0)).all():
        raise InputError("an image has no light or a value that is not finite", file=source, key=f"{name}/psfMat")
    return images / total[:, None, None]


def _centred(images: FloatArray, sample: str, oversampling: int) -> tuple[FloatArray, FloatArray]:
    """Return (cell integrals, shift (x, y) in px that was removed)."""
    frequency = np.fft.fftfreq(images.shape[-1])
    spectrum = np.fft.fft2(images)
    if sample == "point":
        cell = np.sinc(frequency)
        spectrum *= cell[:, None] * cell
        images = np.fft.ifft2(spectrum).real
    shift = np.array(windowed_centroid(pixel_response(images.mean(axis=0), oversampling), WINDOW_PX * oversampling))
    turn_x, turn_y = (np.exp(2j * np.pi * frequency * s) for s in shift)
    moved = np.maximum(np.fft.ifft2(spectrum * turn_y[:, None] * turn_x).real, 0.0)  # undersampled images ring
    return moved / moved.sum(axis=(1, 2), keepdims=True), shift / oversampling
