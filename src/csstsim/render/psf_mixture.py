"""The PSF at an object's position, as cells or as a transform: the sum over nodes and sub-bands of weight x electrons.

The transform is that of the PSF integrated over the pixel and sampled every half pixel (sums of spline coefficients,
render.pixel_sums), so it reaches 1 cycle per pixel; above that, the optics, jitter, diffusion and the pixel leave less
than 1e-4 of any band. It is computed at the frequencies j / size of a periodic image of `size` pixels.
"""

from __future__ import annotations

from functools import cached_property, lru_cache
from typing import TYPE_CHECKING

import numba
import numpy as np
import scipy.fft

from csstsim.render.pixel_sums import pixel_sums
from csstsim.render.psf_table import spline_coefficients
from csstsim.render.wings import core_fraction

if TYPE_CHECKING:
    from csstsim.base.types import ComplexArray, FloatArray, IntArray
    from csstsim.optics.psf.psf_file import PsfSet

BINS = np.geomspace(1e-4, 1.0, 64)  # cycles a pixel
_NODES_CACHED = 128  # at least one row of the finest grids; 1 MB each
_TRANSFORMS_KEPT = 64


class Mixer:
    """The nodes of a PsfSet as spline coefficients and as transforms; the most recently used ones are cached."""

    def __init__(self, psf: PsfSet) -> None:
        self.psf = psf
        self.per_pixel = psf.oversampling
        self.cells = psf.image.shape[-1]
        self._flux = psf.flux

        @lru_cache(_NODES_CACHED)
        def coefficients(node: int) -> FloatArray:
            return np.stack([spline_coefficients(image)[0].astype(np.float32) for image in psf.node(node)])

        @lru_cache(_TRANSFORMS_KEPT)
        def transforms(node: int, size: int, cored: bool = False) -> ComplexArray:
            core = self.core if cored else np.float32(1)
            return np.stack([transform(c * core, size, self.per_pixel, size) for c in coefficients(node)])

        @lru_cache(_NODES_CACHED)
        def core_flux(node: int) -> FloatArray:
            return (coefficients(node) * self.core).sum(axis=(1, 2), dtype=np.float64)

        @lru_cache(_NODES_CACHED)
        def envelope(node: int) -> FloatArray:
            return _envelope(transforms(node, 2 * self.cells // self.per_pixel))

        self.coefficients = coefficients
        self.transforms = transforms
        self._envelope = envelope
        self._core_flux = core_flux

    @property
    def half(self) -> float:
        """Half the side of the PSF's box [px]."""
        return self.cells / 2 / self.per_pixel

    def envelope(self, node: IntArray, node_electrons: FloatArray) -> FloatArray:
        """Return the largest modulus of an object's transforms at or beyond each of BINS, of light 1."""
        return np.max([self._envelope(k) for k in node[node_electrons.any(axis=1)].tolist()], axis=0)

    @cached_property
    def core(self) -> FloatArray:
        """Return the fraction of each cell that is kept where the box fades into the wing, (cells, cells) float32."""
        return core_fraction(self.cells, self.per_pixel).astype(np.float32)

    def mixed_cells(
        self, node: IntArray, node_electrons: FloatArray, rows: slice | None = None, columns: slice | None = None
    ) -> FloatArray:
        """Return the mixture of one object, float32 (rows, columns) of spline coefficients in electrons.

        node (k,), node_electrons (k, 4): electrons from each node and sub-band; rows, columns: of cells, None: all.
        """
        every = slice(0, self.cells)
        parts = [self.coefficients(k) for k in node[node_electrons.any(axis=1)].tolist()]
        return _mixed(parts, node_electrons, every if rows is None else rows, every if columns is None else columns)

    def light(self, node: IntArray, node_electrons: FloatArray, cored: bool) -> float:
        """Return the electrons of an object within the box; cored: times `core`, the part not replaced by the wing."""
        flux = self._core_flux if cored else self._flux.__getitem__
        return sum(
            float((row * flux(k)).sum()) for k, row in zip(node.tolist(), node_electrons, strict=True) if row.any()
        )

    def mixed_transforms(
        self, node: IntArray, node_electrons: FloatArray, size: int, last: int, cored: bool = False
    ) -> ComplexArray:
        """Return the mixture of one object as a transform (see `transform`), times `core` if `cored`."""
        parts = [self.transforms(k, size, cored).view(np.float32) for k in node[node_electrons.any(axis=1)].tolist()]
        rows = slice(size - last, size + last + 1)
        return _mixed(parts, node_electrons, rows, slice(0, 2 * (last + 1))).view(np.complex64)


def mixer_of(psf: PsfSet | Mixer) -> Mixer:
    """Return the Mixer of a PsfSet; a Mixer is returned as it is (keeping it between calls saves about 10 ms)."""
    return psf if isinstance(psf, Mixer) else Mixer(psf)


def _envelope(transforms: ComplexArray) -> FloatArray:
    """Return the largest modulus of transforms (4, 2 J + 1, J + 1) of light 1 at or beyond each of BINS."""
    last = transforms.shape[2] - 1
    f = np.hypot(np.arange(-last, last + 1)[:, None], np.arange(last + 1)) / last
    modulus = np.abs(transforms).max(axis=0)
    at = np.searchsorted(BINS, f.ravel())
    largest = np.zeros(len(BINS) + 1)
    np.maximum.at(largest, at, modulus.ravel())
    return np.maximum.accumulate(largest[::-1])[::-1][: len(BINS)]


def _mixed(parts: list[FloatArray], node_electrons: FloatArray, rows: slice, columns: slice) -> FloatArray:
    """Return the sum of node_electrons (k, 4) x parts, of the nodes with electrons, in these rows and columns."""
    out = np.zeros((rows.stop - rows.start, columns.stop - columns.start), np.float32)
    for part, electrons in zip(parts, node_electrons[node_electrons.any(axis=1)].astype(np.float32), strict=True):
        _add(out, part, electrons, rows.start, columns.start)
    return out


def transform(cells: FloatArray, size: int, per_pixel: int, last: int) -> ComplexArray:
    """Return the transform, complex64 (2 last + 1, last + 1): rows j_y = -last..last, columns j_x = 0..last <= size.

    cells: (n, n) float32 spline coefficients with the star at their centre, which is the origin of the transform.
    """
    reach = len(cells) // per_pixel + 2  # half pixels
    start = len(cells) / 2 - 0.5 * per_pixel * (reach + 1)
    samples = pixel_sums(cells, start, start, per_pixel, per_pixel // 2, np.empty((2 * reach + 1,) * 2, np.float32))
    period = 2 * size
    if period < len(samples):
        samples = _folded(samples, period)
    columns = scipy.fft.rfft(samples, period, axis=1)[:, : last + 1]
    rows = np.arange(-last, last + 1)
    turn = (0.5 * np.exp(1j * np.pi * rows * (reach / size))).astype(np.complex64)
    return scipy.fft.fft(columns, period, axis=0, overwrite_x=True)[rows] * turn[:, None] * turn[last:]


@numba.njit(cache=True)
def _add(out: FloatArray, parts: FloatArray, electrons: FloatArray, first_row: int, first_column: int) -> None:
    """Add to `out` the sum of electrons (4,) x sub-band of parts (4, rows, columns), from a row and column on."""
    a, b, c, d = electrons
    last_column = first_column + out.shape[1]
    for row in range(out.shape[0]):
        at = first_row + row
        one = parts[0, at, first_column:last_column]
        two = parts[1, at, first_column:last_column]
        three = parts[2, at, first_column:last_column]
        four = parts[3, at, first_column:last_column]
        line = out[row]
        for column in range(len(line)):
            line[column] += a * one[column] + b * two[column] + c * three[column] + d * four[column]


@numba.njit(cache=True)
def _folded(cells: FloatArray, period: int) -> FloatArray:
    """Return the cells summed modulo `period`."""
    out = np.zeros((period, period), np.float32)
    for row in range(len(cells)):
        for column in range(len(cells)):
            out[row % period, column % period] += cells[row, column]
    return out
