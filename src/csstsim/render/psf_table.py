"""The PSF of a chip as a density for drawing photons: splines through the stored cell integrals, and alias tables.

A stored number is the light in a cell (optics.psf.psf_file). The density is a sum of quadratic B-splines on the cells,
f(x) = sum_k c_k B_2(x - k), with c such that its integral over each cell is the stored number: since a box times
B_2 is B_3, c follows from the numbers by the cubic B-spline prefilter (Unser 1999, IEEE SPM 16, 22). A photon is a draw
of k with probability c_k plus a B_2 variate (three uniforms); stamps are sums of c_k over pixels
(render.imaging.stamps). Both sample the same density. Negative coefficients, of which a smooth PSF has hardly any, are
set to zero and the others scaled to keep the sum; `negative` is the light removed.

Alias tables (Walker 1977; Vose 1991, IEEE TSE 17, 972): a word has 16 bits of probability and 16 bits of index. The
middle of a PSF, which receives 96% of the photons, has its own table, which stays in cache. Rounding errors, up to
2^-17 of a mean cell's light, are carried over from cell to cell; the last cell keeps their sum, about 1e-7 of the
light.

On disk: HDF5, with /words (contiguous, so that it can be memory-mapped), /share, /negative and /crc as below. The
coefficients are not stored (they would double the file): `node_coefficients` computes them in milliseconds. The file
identifies its PSF set by a digest of the set's attributes, nodes and fluxes.
"""

import hashlib
import math
import zlib
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import h5py
import numba
import numpy as np

from csstsim.base.errors import InputError
from csstsim.base.files.atomic import atomic_path
from csstsim.base.types import FloatArray, IntArray, PathLike
from csstsim.optics.psf.psf_file import WAVELENGTHS, PsfSet, intact

INNER_PX = 8  # half the side of the middle, in pixel
FORMAT = 2
_MAX_CELLS = 256  # along a side: an alias is a 16-bit number
_POLE = np.sqrt(3.0) - 2.0  # of the cubic B-spline's prefilter
_AGAIN = "remove the file, then run csstsim psf again"
_HORIZON = 28  # cells after which the pole's power is below 1e-16


@dataclass(frozen=True, eq=False)
class PsfTable:
    """Sampling tables of the n nodes of a PsfSet. A table has 2^bits cells to a side, row by row, starting at the
    first cell of the middle (inner table) or of the box (outer table)."""

    psf: PsfSet
    words: IntArray  # (n, 4, 4^inner + 4^outer) uint32: alias table of the middle, then of the box without the middle
    share: FloatArray  # (n, 4, 2) light of middle and rest; the remainder to 1 lies outside the box
    negative: FloatArray  # (n, 4) light of the coefficients that were below zero
    crc: IntArray  # (n,) uint32 CRC-32 of a node's words
    path: Path | None = None  # of the file, if there is one
    verified: set[int] = field(default_factory=set)  # nodes whose words have been checked against their CRC

    @property
    def bits(self) -> tuple[int, int]:
        """Base-2 logarithms of the sides of the inner and the outer table."""
        return _bits(self.psf)

    @property
    def per_pixel(self) -> int:
        """Cells to a pixel, along a side."""
        return self.psf.oversampling

    @property
    def cells(self) -> int:
        """Cells to a side of the box."""
        return self.psf.image.shape[-1]

    def verify(self, nodes: IntArray) -> None:
        """Check the words of nodes used for the first time against their CRC. Raises InputError if they differ."""
        if self.path is None:
            return
        for node in set(np.unique(nodes).tolist()) - self.verified:
            if zlib.crc32(self.words[node]) != self.crc[node]:
                raise InputError(f"damaged at node {node}; {_AGAIN}", file=self.path, key="words")
            self.verified.add(node)

    def node_coefficients(self, node: int) -> FloatArray:
        """Return (4, cells, cells) float64: c >= 0 of a live node, as a fraction of a star's light."""
        return np.stack([spline_coefficients(image)[0] for image in self.psf.node(node)])


def make_table(psf: PsfSet, nodes: Iterable[int] | None = None) -> PsfTable:
    """Return the PsfTable of a PsfSet in memory, with tables for `nodes` (indices; None: all live ones), else zeros."""
    arrays: dict[str, Any] = {name: np.zeros(*layout) for name, layout in _layout(psf).items()}
    for node, values in _live(psf, nodes):
        for name, value in values.items():
            arrays[name][node] = value
    for array in arrays.values():
        array.flags.writeable = False  # as a mapped file is
    return PsfTable(psf, **arrays)


def write_tables(path: PathLike, psf: PsfSet) -> None:
    """Write the tables of all live nodes of a PsfSet to `path`, node by node; dead nodes stay zero."""
    with atomic_path(path) as temporary, h5py.File(temporary, "w", libver=("v110", "v110")) as file:
        file.attrs["format"] = FORMAT
        file.attrs["digest"] = np.bytes_(_digest(psf))
        for name, layout in _layout(psf).items():
            file.create_dataset(name, *layout)
        for node, values in _live(psf):
            for name, value in values.items():
                file[name][node] = value


def read_tables(path: PathLike, psf: PsfSet) -> PsfTable:
    """Return the PsfTable of a PsfSet from its file, with the words memory-mapped.

    Raises InputError if the file is missing, damaged, of another format, or made of another PSF set.
    """
    with intact(path), h5py.File(path, "r") as file:
        for name, expected in (("format", FORMAT), ("digest", np.bytes_(_digest(psf)))):
            if name not in file.attrs or file.attrs[name] != expected:
                raise InputError(f"not the tables of this PSF set; {_AGAIN}", file=path, key=name)
        arrays: dict[str, Any] = {}
        for name, (shape, dtype) in _layout(psf).items():
            data = file[name]
            if data.shape != shape or data.dtype != dtype:
                raise InputError("wrong shape or type", file=path, key=name, value=data.shape, allowed=shape)
            mapped = name == "words"
            arrays[name] = np.memmap(path, dtype, "r", data.id.get_offset(), shape) if mapped else data[()]
            arrays[name].flags.writeable = False
    wrong = np.abs(arrays["share"].sum(axis=2) - psf.flux) > 1e-6
    if (~(arrays["share"] >= 0) | wrong[:, :, None])[~psf.dead].any():
        raise InputError(f"the light of a node is not that of the PSF set; {_AGAIN}", file=path, key="share")
    return PsfTable(psf, **arrays, path=Path(path))


def spline_coefficients(image: FloatArray) -> tuple[FloatArray, float]:
    """Return (c >= 0, light below zero) of one image of cell integrals (cells, cells); c sums to the image's light."""
    c = image.astype(np.float64)
    for _ in range(2):
        _prefilter(c)
        c = np.ascontiguousarray(c.T)
    below = np.maximum(-c, 0).sum()
    total = image.sum(dtype=np.float64)
    c = np.maximum(c, 0)
    return (c * (total / c.sum()) if total > 0 else c), below


def _bits(psf: PsfSet) -> tuple[int, int]:
    """Return the base-2 logarithms of the sides of inner and outer tables."""
    cells = psf.image.shape[-1]
    if cells > _MAX_CELLS:
        raise InputError("too many cells for photons", file=psf.path, key="image", value=cells, allowed=_MAX_CELLS)
    inner = min(2 * INNER_PX * psf.oversampling, cells)
    return inner.bit_length() - 1, (cells - 1).bit_length()


def _layout(psf: PsfSet) -> dict[str, tuple[tuple[int, ...], np.dtype[Any]]]:
    """Return {name: (shape, dtype)} of the arrays of a PsfTable."""
    n = len(psf.nodes_xy)
    inner, outer = _bits(psf)
    return {
        "words": ((n, WAVELENGTHS, 4**inner + 4**outer), np.dtype(np.uint32)),
        "share": ((n, WAVELENGTHS, 2), np.dtype(np.float64)),
        "negative": ((n, WAVELENGTHS), np.dtype(np.float64)),
        "crc": ((n,), np.dtype(np.uint32)),
    }


def _digest(psf: PsfSet) -> str:
    parts = repr(sorted(psf.attributes.items())), INNER_PX, *(a.tobytes() for a in (psf.nodes_xy, psf.flux))
    return hashlib.sha256(repr(parts).encode()).hexdigest()


def _live(psf: PsfSet, nodes: Iterable[int] | None = None) -> Iterator[tuple[int, dict[str, Any]]]:
    """Yield (node, {name: its rows of the tables})."""
    live: Iterable[int] = np.flatnonzero(~psf.dead) if nodes is None else nodes
    for node in live:
        rows: dict[str, Any] = {name: np.zeros(shape[1:], dtype) for name, (shape, dtype) in _layout(psf).items()}
        for band, image in enumerate(psf.node(node)):
            c, rows["negative"][band] = spline_coefficients(image)
            rows["share"][band] = _fill(c, *_bits(psf), rows["words"][band])
        rows["crc"] = zlib.crc32(rows["words"])
        yield node, rows


def _fill(c: FloatArray, inner_bits: int, outer_bits: int, words: IntArray) -> tuple[float, float]:
    """Fill both alias tables of one image; return the light of the middle and of the rest."""
    first = (len(c) - (1 << inner_bits)) // 2
    middle = slice(first, first + (1 << inner_bits))
    weight = np.ascontiguousarray(c[middle, middle]).ravel()
    _alias(weight, words[: len(weight)])
    rest = np.zeros((1 << outer_bits,) * 2)
    rest[: len(c), : len(c)] = c
    rest[middle, middle] = 0
    _alias(rest.ravel(), words[len(weight) :])
    return weight.sum(), rest.sum()


@numba.njit(cache=True)
def _prefilter(c: FloatArray) -> None:
    """Turn samples of a cubic spline into its coefficients, along axis 0, mirrored at the ends, in place."""
    n, width = c.shape
    power = _POLE
    start = c[0].copy()
    for i in range(1, _HORIZON):
        mirrored = c[min(i % (2 * n - 2), 2 * n - 2 - i % (2 * n - 2))]
        for j in range(width):
            start[j] += power * mirrored[j]
        power *= _POLE
    c[0] = start
    for i in range(1, n):
        for j in range(width):
            c[i, j] += _POLE * c[i - 1, j]
    for j in range(width):
        c[n - 1, j] = _POLE / (_POLE * _POLE - 1) * (c[n - 1, j] + _POLE * c[n - 2, j])
    for i in range(n - 2, -1, -1):
        for j in range(width):
            c[i, j] = _POLE * (c[i + 1, j] - c[i, j])
    c *= 6


@numba.njit(cache=True)
def _alias(weight: FloatArray, table: IntArray) -> None:
    """Fill `table` (n <= 65536) with words: probability x 65536 in the upper, alias in the lower 16 bits."""
    n = len(weight)
    total = weight.sum()
    if total <= 0:
        return
    scaled = weight * (n / total)
    small = np.empty(n, np.int64)
    large = np.empty(n, np.int64)
    ns = 0
    nl = 0
    for i in range(n):
        if scaled[i] < 1.0:
            small[ns] = i
            ns += 1
        else:
            large[nl] = i
            nl += 1
    while ns > 0 and nl > 0:
        ns -= 1
        i = small[ns]
        j = large[nl - 1]
        threshold = min(math.floor(scaled[i] * 65536.0 + 0.5), 65535.0)
        table[i] = (np.uint32(threshold) << np.uint32(16)) | np.uint32(j)
        scaled[j] -= 1.0 - threshold / 65536.0
        if scaled[j] < 1.0:
            nl -= 1
            small[ns] = j
            ns += 1
    for k in range(nl):
        table[large[k]] = (np.uint32(65535) << np.uint32(16)) | np.uint32(large[k])
    for k in range(ns):
        table[small[k]] = (np.uint32(65535) << np.uint32(16)) | np.uint32(small[k])
