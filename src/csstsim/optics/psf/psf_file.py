"""The PSF file of a chip, and the PSF at any position from it (paper, section 5.1.2).

HDF5, one file per chip with n = grid^2 nodes and four wavelengths; its contents are listed in DATASETS and ATTRIBUTES.
The centre of the PSF is the middle of the array, the corner shared by cells 127 and 128 of 256. HDF5 checksums protect
attributes, names and the small datasets; an image is checked against its flux.

Between nodes the PSF is a weighted sum of nodes: optics.psf.interpolation.
"""

import json
import os
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from functools import cache
from typing import Any

import h5py
import numpy as np
from numpy.typing import ArrayLike

from csstsim import __version__
from csstsim.base.errors import InputError
from csstsim.base.files.atomic import atomic_path
from csstsim.base.files.file_log import logged
from csstsim.base.files.hdf5_file import numbers
from csstsim.base.types import BoolArray, FloatArray, IntArray, PathLike
from csstsim.optics.psf.interpolation import Interpolator

FORMAT = 2
WAVELENGTHS = 4
ATTRIBUTES = {
    "format": "number of this layout",
    "sample": "cell_integral: a number is the light in its cell",
    "cell_um": "um, side of a cell",
    "cell_arcsec": "arcsec, side of a cell",
    "oversampling": "cells along the side of a pixel, even",
    "chip": "chip number",
    "filter": "filter or grating",
    "grid": "nodes along a side of the chip",
    "camera_digest": "hash of the camera's data files",
    "version": "of csstsim",
    "provenance": "JSON: what made it",
}
DATASETS = {
    "nodes_xy": ("(n, 2) float64", "px, (x, y) where the light falls, from 0, x fastest"),
    "nodes_uv": (
        "(n, 2) float64",
        "deg, where it comes from: intermediate world coordinates at position angle 0; NaN: not known",
    ),
    "wavelength": ("(4,) float64", "angstrom"),
    "tilt": ("(n, 2) float64", "px, shift (x, y) taken out when the node was centred"),
    "flux": ("(n, 4) float64", "sum of each image; NaN marks a dead node, which is never used"),
    "image": ("(n, 4, cells, cells) float32", "cell integrals [y, x], contiguous: mappable"),
}
_SMALL = tuple(DATASETS)[:-1]  # all but the image; these are read on opening
_VERSIONS = ("v110", "v110")  # readable by HDF5 1.10 or newer; older layouts have no checksums in their headers


def pixel_response(image: FloatArray, oversampling: int) -> FloatArray:
    """Return the integrals over 10 um pixels on the lattice of cells, (..., n-m+1, n-m+1), of cells (..., n, n).

    m = `oversampling` (even) is the number of cells along a pixel. The integrals are exact sums of m x m cells: sample
    [i, j] is the fraction of a star's light in a pixel whose centre is ((j, i) - (n-m)/2) cells from the star; the
    middle sample is a pixel centred on the star. These are point samples of PSF * pixel (draw without a further pixel).
    """
    for axis in (-1, -2):
        windows = np.lib.stride_tricks.sliding_window_view(image, oversampling, axis=axis)
        image = windows.sum(axis=-1)
    return image


def half_pixels(image: FloatArray, oversampling: int) -> FloatArray:
    """Return cell integrals (..., n, n) summed to cells of half a pixel, centred on the middle of the array."""
    return larger_cells(image, oversampling, 2)


def larger_cells(image: FloatArray, oversampling: int, per_pixel: int) -> FloatArray:
    """Return cell integrals (..., n, n) summed to `per_pixel` cells along a pixel, centred on the middle of the array.

    per_pixel: even, a divisor of `oversampling`.
    """
    step = oversampling // per_pixel
    size = image.shape[-1] // (2 * step) * 2
    edge = (image.shape[-1] - size * step) // 2
    inner = image[..., edge : edge + size * step, edge : edge + size * step]
    return inner.reshape(*image.shape[:-2], size, step, size, step).sum(axis=(-3, -1))


def write_psf(
    path: PathLike,
    nodes: FloatArray,
    wavelength: FloatArray,
    images: Iterable[tuple[FloatArray, FloatArray]],
    *,
    cells: int,
    about: dict[str, Any],
    provenance: Mapping[str, Any],
    nodes_uv: FloatArray | None = None,
) -> None:
    """Write a PSF file. `images` yields, node by node, (image (4, cells, cells), tilt (2,)).

    `about`: the attributes of this chip (see ATTRIBUTES); `provenance`: a JSON-like mapping; `nodes_uv`: (n, 2).
    """
    tilt = np.empty((len(nodes), 2))
    flux = np.empty((len(nodes), WAVELENGTHS))
    with atomic_path(path) as temporary, h5py.File(temporary, "w", libver=_VERSIONS) as file:
        store = file.create_dataset("image", (len(nodes), WAVELENGTHS, cells, cells), np.float32)
        for i, (image, shift) in enumerate(images):
            stored = np.asarray(image, np.float32)
            store[i], tilt[i], flux[i] = stored, shift, stored.sum(axis=(1, 2), dtype=np.float64)
        nodes_uv = np.full_like(nodes, np.nan, dtype=float) if nodes_uv is None else nodes_uv
        named = {"nodes_xy": nodes, "nodes_uv": nodes_uv, "wavelength": wavelength, "tilt": tilt, "flux": flux}
        for name, data in named.items():
            file.create_dataset(name, data=np.asarray(data, np.float64), fletcher32=True)
        about = about | {"format": FORMAT, "sample": "cell_integral", "version": __version__}
        about["provenance"] = json.dumps(provenance, sort_keys=True)
        for name, value in about.items():  # fixed-length text, because HDF5 does not checksum variable-length text
            file.attrs[name] = np.bytes_(value.encode()) if isinstance(value, str) else value


def _plain(value: Any) -> Any:
    """Return an attribute as a Python number or str."""
    value = value.item() if isinstance(value, np.generic) else value
    return value.decode() if isinstance(value, bytes) else value


@contextmanager
def intact(path: PathLike) -> Iterator[None]:
    """Turn the exceptions that a damaged file raises in h5py or in the checks into an InputError."""
    try:
        with logged("read", path):
            yield
    except OSError as exc:
        reason = os.strerror(exc.errno) if exc.errno else "truncated, damaged, or not HDF5"
        raise InputError(f"cannot read the PSF file: {reason}", file=path) from exc
    except (AttributeError, LookupError, RuntimeError, TypeError, ValueError, MemoryError) as exc:
        raise InputError(f"the PSF file is damaged: {type(exc).__name__} {exc}", file=path) from exc


class PsfSet:
    """The PSFs of one chip, read as needed from a memory-mapped file.

    Attributes: `nodes_xy` (n, 2) px, `nodes_uv` (n, 2) deg, `image` (n, 4, cells, cells) float32 memory map,
    `wavelength` (4,) angstrom, `tilt` (n, 2) px, `flux` (n, 4), `dead` (n,) bool, `scale` arcsec per cell,
    `oversampling` cells along the side of a pixel, `attributes` (dict).
    """

    def __init__(
        self,
        path: PathLike,
        *,
        chip: int | None = None,
        filter: str | None = None,
        grid: int | None = None,
        oversampling: int | None = None,
        camera_digest: str | None = None,
        **interpolation: Any,
    ) -> None:
        """Open and check a PSF file. Given values of chip (id), filter (name), grid, sampling and digest must match.

        `interpolation`: method, beta, neighbours of optics.psf.interpolation.Interpolator.
        Raises InputError for a missing, truncated or foreign file, wrong shapes, and values that do not match.
        """
        self.path = path
        with intact(path):
            data, offset, shape = self._read()
            self.nodes_xy, self.nodes_uv, self.wavelength, self.tilt, self.flux = (data[k] for k in _SMALL)
            expected = {"format": FORMAT, "sample": "cell_integral", "chip": chip, "filter": filter, "grid": grid}
            expected |= {"oversampling": oversampling, "camera_digest": camera_digest}
            for name, value in expected.items():
                if value is not None and self.attributes[name] != value:
                    raise InputError(
                        "made for another campaign; remove it",
                        file=path,
                        key=name,
                        value=self.attributes[name],
                        allowed=value,
                    )
            self._check(shape)
            self.scale = float(self.attributes["cell_arcsec"])
            self.oversampling = self.attributes["oversampling"]
        self.dead = ~np.isfinite(self.flux).all(axis=1)
        self._seen = np.zeros(len(self.nodes_xy), bool)
        self._mixture = Interpolator(self.nodes_xy, dead=self.dead, file=path, **interpolation)
        try:
            self.image = np.memmap(path, np.float32, "r", offset, shape)
        except ValueError as exc:
            raise InputError("the file is shorter than its image", file=path, key="image") from exc

    def _read(self) -> tuple[dict[str, FloatArray], int, tuple[int, ...]]:
        with h5py.File(self.path, "r") as file:
            self.attributes = {name: _plain(value) for name, value in file.attrs.items()}
            missing = [k for k in ATTRIBUTES if k not in self.attributes]
            missing += [k for k in DATASETS if k not in file]
            if missing:
                raise InputError("not a PSF file", file=self.path, key=missing[0], value="missing")
            image = file["image"]
            offset = file["image"].id.get_offset()
            if image.dtype != np.dtype("<f4") or offset is None:
                raise InputError("must be contiguous float32", file=self.path, key="image", value=str(image.dtype))
            return {k: numbers(file, k, self.path) for k in _SMALL}, offset, image.shape

    def _check(self, shape: tuple[int, ...]) -> None:
        n = self.attributes["grid"] ** 2
        cells = shape[-1]
        wanted = {
            "nodes_xy": (self.nodes_xy.shape, (n, 2)),
            "nodes_uv": (self.nodes_uv.shape, (n, 2)),
            "image": (shape, (n, WAVELENGTHS, cells, cells)),
            "wavelength": (self.wavelength.shape, (WAVELENGTHS,)),
            "tilt": (self.tilt.shape, (n, 2)),
            "flux": (self.flux.shape, (n, WAVELENGTHS)),
        }
        for name, (got, allowed) in wanted.items():
            if got != allowed:
                raise InputError("wrong shape", file=self.path, key=name, value=got, allowed=allowed)
        if cells % 2:
            raise InputError("the number of cells must be even", file=self.path, key="image", value=cells)
        step = self.attributes["oversampling"]
        if type(step) is not int or step not in range(2, cells, 2):
            raise InputError("bad sampling", file=self.path, key="oversampling", value=step, allowed="2, 4")
        for name in ("nodes_xy", "wavelength"):
            if not np.isfinite(getattr(self, name)).all():
                raise InputError("holds a value that is not finite", file=self.path, key=name)
        if np.isfinite(self.flux).all(axis=1).sum() < 3:
            raise InputError("fewer than three nodes are alive", file=self.path, key="flux")

    @property
    def convex(self) -> bool:
        """Whether weights are never negative, so that photons can be drawn from the nodes."""
        return self._mixture.convex

    def node(self, index: int) -> FloatArray:
        """Return the images of one node, (4, cells, cells) float32. Raises InputError if they are damaged."""
        image = self.image[index]
        if not self._seen[index]:
            total = image.sum(axis=(1, 2), dtype=np.float64)
            if not np.allclose(total, self.flux[index], rtol=1e-9, atol=0):
                raise InputError(
                    "does not sum to its flux", file=self.path, key=f"image[{index}]", value=total.tolist()
                )
            self._seen[index] = True
        return image

    def weights(self, x: ArrayLike, y: ArrayLike) -> tuple[IntArray, FloatArray, BoolArray]:
        """Return (index, weight, outside_hull) of the nodes that are mixed for the PSF at pixel positions x, y.

        For scalars the shapes are (k,), (k,), (); for arrays of N positions (N, k), (N, k), (N,). Weights sum to 1,
        and none is negative if `convex` (optics.psf.interpolation).
        """
        return self._mixture(x, y)

    def at(self, x: float, y: float) -> FloatArray:
        """Return the PSF at one pixel position, (4, cells, cells) float64 cell integrals."""
        index, weight, _ = self.weights(float(x), float(y))
        used = weight != 0
        return sum(w * self.node(i).astype(np.float64) for i, w in zip(index[used], weight[used], strict=True))

    def mixed(self, function: Callable[[FloatArray], FloatArray]) -> Callable[[float, float], FloatArray]:
        """Return a function of one pixel position x, y: `function` of the PSF there, for linear functions of images.

        function: of a node's images (4, cells, cells) float32, to an array. It is called once for each node in use.
        """
        of_node = cache(lambda index: function(self.node(index)))

        def at(x: float, y: float) -> FloatArray:
            index, weight, _ = self.weights(float(x), float(y))
            used = weight != 0
            return sum(w * of_node(i) for i, w in zip(index[used].tolist(), weight[used], strict=True))

        return at
