"""Filters: end-to-end throughput, its four PSF sub-bands, and the photometry of the filter.

A curve is the cubic Hermite spline through the nodes of filters.yaml, with PCHIP slopes (Fritsch & Butland 1984)
inside and a slope of 0 at both ends, sampled over 2000-11000 A in steps of 0.5 A. Throughput T is electrons per photon
entering the aperture: optics, filter or grating (1st order), quantum efficiency.

Sub-bands divide the integral of T dlambda into four equal parts. The paper (section 5.1) has four wavelengths per band,
but does not define them. The PSF of a sub-band is computed at its mean wavelength, weighted with T.
"""

from dataclasses import dataclass
from functools import cached_property, lru_cache
from itertools import pairwise
from typing import Annotated, Literal

import numpy as np
from numpy.typing import ArrayLike
from pydantic import AfterValidator, Field

from csstsim.base.model import Data, NotNegative, Number
from csstsim.base.resampling import on_grid
from csstsim.base.types import FloatArray
from csstsim.base.units import ab_photon_density
from csstsim.instrument.telescope import Telescope

GRID = np.arange(2000.0, 11000.25, 0.5)  # angstrom
SUBBANDS = 4


def _curve(nodes: list[tuple[float, float]]) -> list[tuple[float, float]]:
    waves, throughputs = zip(*nodes, strict=True)
    if any(b <= a for a, b in pairwise(waves)) or waves[0] < GRID[0] or waves[-1] > GRID[-1]:
        raise ValueError("wavelengths must rise, within 2000-11000 A")
    if min(throughputs) < 0 or not 0 < max(throughputs) <= 1:
        raise ValueError("throughput must lie in 0..1 and not be zero everywhere")
    return nodes


@dataclass(frozen=True, eq=False, repr=False)
class FilterEntry(Data):
    """An entry of filters.yaml: `nodes` of the curve are pairs (angstrom, throughput); other fields as in Filter."""

    kind: Literal["imaging", "slitless"]
    nodes: Annotated[list[tuple[Number, Number]], Field(min_length=2), AfterValidator(_curve)]
    sky: NotNegative
    saturation_mag: Number
    limiting_mag: Number

    def filter(self, name: str) -> "Filter":
        """Return the Filter of this entry."""
        nodes = tuple(map(tuple, self.nodes))
        return _filter(name, self.kind, nodes, self.sky, self.saturation_mag, self.limiting_mag)


@dataclass(frozen=True, eq=False)
class Filter:
    """One filter or grating. `sky` is the nominal background [e-/s/pixel]; the limits are AB magnitudes."""

    name: str
    kind: str  # "imaging" or "slitless"
    wavelength: FloatArray  # (n,) angstrom
    throughput: FloatArray  # (n,) electron / photon
    sky: float
    saturation_mag: float
    limiting_mag: float

    @cached_property
    def edges(self) -> FloatArray:
        """(5,) angstrom: bounds of the sub-bands; the outer two enclose the complete curve."""
        cumulative = _cumulative(self.throughput, self.wavelength)
        inner = np.interp(cumulative[-1] * np.arange(1, SUBBANDS) / SUBBANDS, cumulative, self.wavelength)
        first, last = np.flatnonzero(self.throughput)[[0, -1]]
        first = max(first - 1, 0)
        last = min(last + 1, len(self.wavelength) - 1)
        return np.array([self.wavelength[first], *inner, self.wavelength[last]])

    @cached_property
    def psf_wavelength(self) -> FloatArray:
        """(4,) angstrom: mean of lambda weighted with T over each sub-band."""
        bands = self.subband(self.wavelength)
        wave = self.wavelength
        return np.asarray(np.trapezoid(bands * wave, wave) / np.trapezoid(bands, wave))

    def at(self, wave: FloatArray) -> FloatArray:
        """Return the throughput at wavelengths [angstrom], of any shape; zero outside the grid."""
        return np.interp(wave, self.wavelength, self.throughput, left=0.0, right=0.0)

    def subband(self, wave: FloatArray) -> FloatArray:
        """Return T_i (4, n): the throughput at rising wavelengths (n,) [angstrom], divided among the sub-bands.

        A sample whose cell (bounded by the mid-points to its neighbours) contains an edge is divided in proportion. So
        the sum of the four is exactly T, and coarse grids keep the proportions of the sub-bands.
        """
        wave = np.asarray(wave, dtype=float)
        midpoints = 0.5 * (wave[1:] + wave[:-1])
        cells = np.concatenate([[2 * wave[0] - midpoints[0]], midpoints, [2 * wave[-1] - midpoints[-1]]])
        below = np.clip((self.edges[1:-1, None] - cells[:-1]) / np.diff(cells), 0.0, 1.0)
        below = np.vstack([np.zeros_like(wave), below, np.ones_like(wave)])
        return np.diff(below, axis=0) * self.at(wave)

    @cached_property
    def log_integral(self) -> np.float64:
        """Integral of T d(ln lambda)."""
        return np.float64(np.trapezoid(self.throughput / self.wavelength, self.wavelength))

    @cached_property
    def pivot(self) -> float:
        """Pivot wavelength of the photon-counting response [angstrom]."""
        return float(np.sqrt(np.trapezoid(self.throughput * self.wavelength, self.wavelength) / self.log_integral))

    def zeropoint(self, telescope: Telescope) -> float:
        """Return the AB magnitude of a source that gives 1 electron / s.

        Parameters
        ----------
        telescope : Telescope
            The telescope, for its area.

        Returns
        -------
        float
            AB magnitude [mag] of a source flat in f_nu.
        """
        rate = np.trapezoid(ab_photon_density(self.wavelength) * self.throughput, self.wavelength)
        return float(2.5 * np.log10(telescope.area_m2 * rate))


@lru_cache(maxsize=64)
def _filter(
    name: str, kind: str, nodes: tuple[tuple[float, float], ...], sky: float, saturation_mag: float, limiting_mag: float
) -> Filter:
    """Return a Filter. All cameras of a process share one object for equal parameters, with its computed properties."""
    throughput = curve_on_grid(nodes)
    throughput.flags.writeable = False
    return Filter(name, kind, GRID, throughput, sky, saturation_mag, limiting_mag)


def _cumulative(y: FloatArray, x: FloatArray) -> FloatArray:
    """Return the cumulative trapezoidal integral (n,) of y dx, starting at 0."""
    return np.concatenate([[0.0], np.cumsum(0.5 * (y[1:] + y[:-1]) * np.diff(x))])


def curve_on_grid(nodes: ArrayLike) -> FloatArray:
    """Return the curve of `sample_curve` on GRID (18001,), or its means if nodes are closer than points of the grid.

    nodes: (m, 2), rising (angstrom, electron / photon).
    """
    x = np.asarray(nodes, dtype=float)[:, 0]
    if np.diff(x).min() >= GRID[1] - GRID[0]:
        return sample_curve(nodes)
    at = np.unique(np.concatenate([x, GRID[(x[0] < GRID) & (x[-1] > GRID)]]))
    return on_grid(GRID, at, sample_curve(nodes, at))


def sample_curve(nodes: ArrayLike, grid: FloatArray = GRID) -> FloatArray:
    """Return the monotone cubic with flat ends through `nodes`, (m, 2) of rising (angstrom, T), on `grid` (n,).

    It is zero outside the nodes.
    """
    x, y = np.asarray(nodes, dtype=float).T
    slope = _pchip_slopes(x, y)
    k = np.clip(np.searchsorted(x, grid, side="right") - 1, 0, len(x) - 2)
    h = x[k + 1] - x[k]
    t = (grid - x[k]) / h
    value = (
        y[k] * (1 + 2 * t) * (1 - t) ** 2
        + y[k + 1] * t**2 * (3 - 2 * t)
        + h * t * (1 - t) * (slope[k] * (1 - t) - slope[k + 1] * t)
    )
    return np.where((grid >= x[0]) & (grid <= x[-1]), value, 0.0)


def _pchip_slopes(x: FloatArray, y: FloatArray) -> FloatArray:
    """Return the slopes at the nodes (m,): weighted harmonic means of adjacent secants, 0 at extrema and both ends."""
    h = np.diff(x)
    secant = np.diff(y) / np.diff(x)
    slope = np.zeros_like(y)
    same_sign = secant[1:] * secant[:-1] > 0
    w1 = 2 * h[1:] + h[:-1]
    w2 = h[1:] + 2 * h[:-1]
    w1, w2, before, after = (values[same_sign] for values in (w1, w2, secant[:-1], secant[1:]))
    slope[1:-1][same_sign] = (w1 + w2) / (w1 / before + w2 / after)
    return slope
