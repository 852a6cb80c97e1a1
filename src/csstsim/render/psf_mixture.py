"""The PSF at an object's place, as cells or as a transform: the sum over nodes and sub-bands of weight x electrons.

A node's spline coefficients (render.psf_table), transformed, times sinc^3 (a quadratic B-spline) and sinc (the pixel)
are the transform of the pixel-integrated PSF. It is wanted at the frequencies j / size cycles a pixel of an image that
repeats itself after `size` pixels, up to 1.25 cycles a pixel (1 where two cells make a pixel): beyond, the optics,
jitter, diffusion and the pixel leave nothing of it.
"""

from functools import cached_property, lru_cache

import numba
import numpy as np
import scipy.fft

from csstsim.render.psf_table import spline_coefficients
from csstsim.render.wings import box_share

FREQUENCY_MAX = 1.25  # cycles a pixel


BINS = np.geomspace(1e-4, FREQUENCY_MAX, 64)  # cycles a pixel
_NODES_KEPT = 128  # a row or more of the finest grids; 1 MB each
_TRANSFORMS_KEPT = 64


class Mixer:
    """The nodes of a PsfSet as spline coefficients and as transforms, the last used ones kept."""

    def __init__(self, psf):
        self.per_pixel, self.cells, self._flux = psf.oversampling, psf.image.shape[-1], psf.flux

        @lru_cache(_NODES_KEPT)
        def coefficients(node):
            return np.stack([spline_coefficients(image)[0].astype(np.float32) for image in psf.node(node)])

        @lru_cache(_TRANSFORMS_KEPT)
        def transforms(node, size):
            last = last_frequency(size, self.per_pixel)
            return np.stack([transform(c, size, self.per_pixel, last) for c in coefficients(node)])

        self.coefficients, self.transforms = coefficients, transforms
        self.envelope = _envelope(transforms(int(np.flatnonzero(~psf.dead)[0]), 2 * self.cells // self.per_pixel))

    @cached_property
    def core(self):
        """Return the share of each cell that counts where a wing brings the rest, (cells, cells) float32."""
        return box_share(self.cells, self.per_pixel).astype(np.float32)

    def mixed_cells(self, node, share, first=(0, 0), last=None):
        """Return the mixture of one object, float32 (rows, columns) of spline coefficients in electrons.

        node (k,), share (k, 4): electrons from each node and sub-band; first, last: cells (row, column), half-open.
        """
        last = (self.cells, self.cells) if last is None else last
        cut = (slice(None), *(slice(*pair) for pair in zip(first, last, strict=True)))
        return _mixed([self.coefficients(k)[cut] for k in node[share.any(axis=1)].tolist()], share)

    def light(self, node, share, core=None):
        """Return the electrons of an object within the box, times `core` (cells, cells) if given."""
        if core is not None:
            return float((self.mixed_cells(node, share) * core).sum(dtype=np.float64))
        return sum(float(row @ self._flux[k]) for k, row in zip(node.tolist(), share, strict=True))

    def mixed_transforms(self, node, share, size, last):
        """Return the same as a transform, like `transform`'s, from those of the nodes."""
        middle = last_frequency(size, self.per_pixel)
        cut = (slice(None), slice(middle - last, middle + last + 1), slice(last + 1))
        parts = [self.transforms(k, size)[cut].view(np.float32) for k in node[share.any(axis=1)].tolist()]
        return _mixed(parts, share).view(np.complex64)


def _envelope(transforms):
    """Return the largest modulus of transforms (4, 2 J + 1, J + 1) of light 1 at or beyond each of BINS."""
    last = transforms.shape[2] - 1
    f = np.hypot(np.arange(-last, last + 1)[:, None], np.arange(last + 1)) / last * FREQUENCY_MAX
    modulus = np.abs(transforms).max(axis=0)
    at = np.searchsorted(BINS, f.ravel())
    largest = np.zeros(len(BINS) + 1)
    np.maximum.at(largest, at, modulus.ravel())
    return np.maximum.accumulate(largest[::-1])[::-1][: len(BINS)]


def _mixed(parts, share):
    out = np.zeros(parts[0].shape[1:], np.float32)
    for part, light in zip(parts, share[share.any(axis=1)].astype(np.float32), strict=True):
        _add(out, part, light)
    return out


def last_frequency(size, per_pixel):
    """Return J, the largest j that is kept of a period of `size` pixels."""
    return int(min(FREQUENCY_MAX, per_pixel / 2) * size)


def transform(cells, size, per_pixel, last):
    """Return the transform, complex64 (2 last + 1, last + 1): rows j_y = -last..last, columns j_x = 0..last.

    cells: (n, n) float32 spline coefficients, the star in their middle, which is the origin of the result.
    """
    period, middle = size * per_pixel, len(cells) // 2
    if period < len(cells):
        cells = _folded(cells, period)
    columns = scipy.fft.rfft(cells, period, axis=1)[:, : last + 1]
    rows = np.arange(-last, last + 1)
    f = rows / period  # cycles a cell
    turn = np.exp(2j * np.pi * f * (middle - 0.5)) * np.sinc(f) ** 3 * np.sinc(f * per_pixel)
    turn = turn.astype(np.complex64)
    return scipy.fft.fft(columns, period, axis=0, overwrite_x=True)[rows] * turn[:, None] * turn[last:]


@numba.njit(cache=True)
def _add(out, parts, share):
    a, b, c, d = share
    for row in range(out.shape[0]):
        for column in range(out.shape[1]):
            out[row, column] += (
                a * parts[0, row, column] + b * parts[1, row, column]
                + c * parts[2, row, column] + d * parts[3, row, column]
            )  # fmt: skip


@numba.njit(cache=True)
def _folded(cells, period):
    """Return the cells summed modulo `period`."""
    out = np.zeros((period, period), np.float32)
    for row in range(len(cells)):
        for column in range(len(cells)):
            out[row % period, column % period] += cells[row, column]
    return out
