"""Dispersion of a chip's light by its two gratings, as arrays (paper, section 4.2, equations 1 to 4).

Light of wavelength lambda that would fall on x, y without the grating reaches, in order k, the pixel

    x + p + q lambda,   y + r + s lambda         [px]

with p, q, r, s functions of x, y (instrument.grating.DiffractionOrder.lines). Spectra are means over bins (`edges`), at
most a quarter of a first-order pixel wide. An order's electrons in a bin are the mean density times `rates`, the exact
integral of the throughput. The PSF at lambda is a mixture, linear in lambda, of the two nearest of the PSF set's four
wavelengths; outside their range it is that of the nearest one. `Disperser.coarse` has bins of a pixel, for objects so
faint that the position of a line within a pixel is not visible.
"""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from csstsim.base.types import BoolArray, FloatArray, IntArray
from csstsim.instrument.filter import GRID, Filter

if TYPE_CHECKING:
    from csstsim.instrument.grating import Gratings
    from csstsim.instrument.telescope import Telescope

_BINS_PER_PX = 4, 1  # smallest number of bins per pixel of the first order: in general, in `coarse`
_STEP = GRID[1] - GRID[0]


class Disperser:
    """Dispersion and throughput of the two gratings of a chip; piece 0 is the left one, piece 1 the right one."""

    def __init__(
        self, gratings: Gratings, filter: Filter, telescope: Telescope, bins_per_px: int = _BINS_PER_PX[0]
    ) -> None:
        self._made_of = (gratings, filter, telescope)
        self._bins_per_px = bins_per_px
        self.gratings = gratings
        self.filter = filter
        self.area = telescope.area_m2
        self.orders = gratings.numbers
        self.rectangles = np.array([rectangle for _, rectangle in gratings.pieces])
        self.wavelengths = filter.psf_wavelength
        self._pieces = [grating for grating, _ in gratings.pieces]

    @cached_property
    def coarse(self) -> Disperser:
        """A Disperser of the same gratings with fewer bins, for faint objects."""
        return Disperser(*self._made_of, _BINS_PER_PX[1])

    @cached_property
    def edges(self) -> FloatArray:
        """(bins + 1,) angstrom: edges of the bins, samples of filter.GRID."""
        lit = np.any([order.throughput > 0 for piece in self._pieces for order in piece.orders.values()], axis=0)
        first, last = np.flatnonzero(lit)[[0, -1]]
        middles = 0.5 * (self.rectangles[:, ::2] + self.rectangles[:, 1::2])
        pairs = zip(self._pieces, middles, strict=True)
        per_px = min(1 / abs(piece.orders[1].lines(*middle)[1]) for piece, middle in pairs)  # angstrom
        step = max(int(per_px / self._bins_per_px / _STEP), 1)
        first = max(first - 1, 0)
        count = min(-(-(last + 1 - first) // step), (len(GRID) - 1 - first) // step)
        return GRID[first : first + count * step + 1 : step]

    @cached_property
    def length(self) -> float:
        """Length of the first order of a spectrum [px]."""
        middles = 0.5 * (self.rectangles[:, ::2] + self.rectangles[:, 1::2])
        pairs = zip(self._pieces, middles, strict=True)
        return max(abs(g.orders[1].lines(*at)[1]) * np.ptp(g.orders[1].range) for g, at in pairs)

    @cached_property
    def rates(self) -> FloatArray:
        """(2, orders, bins): electron / s for a mean density of 1 photon / s / m2 / angstrom in the bin."""
        at = np.searchsorted(GRID, self.edges)
        out = np.zeros((2, len(self.orders), len(self.edges) - 1))
        for i, piece in enumerate(self._pieces):
            for number, order in piece.orders.items():
                t = order.throughput
                running = np.concatenate([[0.0], np.cumsum(0.5 * (t[1:] + t[:-1]) * _STEP)])
                out[i, self.orders.index(number)] = self.area * np.diff(running[at])
        return out

    @cached_property
    def psf_mixture(self) -> tuple[IntArray, FloatArray]:
        """(bins,) int64 and (bins,): the lower of two wavelengths of the PSF set, and the weight of the upper one."""
        index = np.interp(0.5 * (self.edges[1:] + self.edges[:-1]), self.wavelengths, np.arange(4.0))
        lower = np.minimum(index.astype(np.int64), 2)
        return lower, index - lower

    @cached_property
    def psf_weights(self) -> FloatArray:
        """(4, bins): `psf_mixture` as a matrix, the weight of each wavelength of the PSF set."""
        out, (lower, upper) = np.zeros((4, len(self.edges) - 1)), self.psf_mixture
        bins = np.arange(len(lower))
        out[lower, bins] = 1 - upper
        out[lower + 1, bins] = upper
        return out

    def lines(self, visits: IntArray, x: FloatArray, y: FloatArray) -> FloatArray:
        """Return (v, orders, 4): p, q, r, s of objects at x, y [px] in each of their visits; 0 for a missing order."""
        out = np.zeros((len(visits), len(self.orders), 4))
        for piece, grating in enumerate(self._pieces):
            mine = np.flatnonzero(visits[:, 1] == piece)
            at = visits[mine, 0]
            for number, order in grating.orders.items():
                out[mine, self.orders.index(number)] = order.lines(x[at], y[at])
        return out

    def visits(self, x: FloatArray, y: FloatArray, reach: FloatArray) -> IntArray:
        """Return (v, 3) int64, rows of object, piece, cut: the pieces that light within `reach` (n,) px of x, y meets.

        `cut` is 1 if part of that square lies outside the piece; light there must be left out.
        """
        found = []
        for piece, (x0, x1, y0, y1) in enumerate(self.rectangles):
            rows = np.flatnonzero((x + reach > x0) & (x - reach < x1) & (y + reach > y0) & (y - reach < y1))
            found.append(np.stack([rows, np.full(len(rows), piece), np.zeros(len(rows))], axis=1))
        visits = np.concatenate(found).astype(np.int64)
        visits[:, 2] = self.cut(visits, x, y, reach)
        return visits

    def cut(self, visits: IntArray, x: FloatArray, y: FloatArray, reach: FloatArray) -> BoolArray:
        """Return (v,) bool: part of the square of half side `reach` (n,) px about the object lies beyond the piece."""
        (x0, x1, y0, y1), at = self.rectangles[visits[:, 1]].T, visits[:, 0]
        x = x[at]
        y = y[at]
        reach = reach[at]
        return (x - reach < x0) | (x + reach > x1) | (y - reach < y0) | (y + reach > y1)

    def boxes(self, visits: IntArray, x: FloatArray, y: FloatArray) -> FloatArray:
        """Return (visits, orders, 4): x0, x1, y0, y1 [px] that a point's light reaches; NaN: no such order."""
        out = np.full((len(visits), len(self.orders), 4), np.nan)
        for piece, grating in enumerate(self._pieces):
            mine = np.flatnonzero(visits[:, 1] == piece)
            at = visits[mine, 0]
            for number, order in grating.orders.items():
                p, q, r, s = order.lines(x[at], y[at]).T
                ends = np.array(order.range)[:, None]
                along = x[at] + p + q * ends
                across = y[at] + r + s * ends
                box = np.stack([along.min(axis=0), along.max(axis=0), across.min(axis=0), across.max(axis=0)], axis=1)
                out[mine, self.orders.index(number)] = box
        return out
