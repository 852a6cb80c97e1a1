"""Light of galaxies in whole bands, from tables in redshift: a fifth of the time of GalaxySeds.rates, or less.

A spectrum is a sum of components, so its light in a band is the sum of theirs, which depends on redshift alone:

    rate_b = sum_k c_k exp(-d m_b) sum_n (-d)^n / n! R_nbk(z)
    R_nbk(z) = sum_i w_b(lambda_i) (curve_i - m_b)^n IGM(lambda_i, z) P_k(lambda_i / (1 + z))

w: weights behind the dust of the table, d: optical depth of the galaxy's dust beyond that, m_b: mean of the dust's
curve over the band. Bands need soft edges, as those of CSST: behind a sharp one a line appears within less than a step
of redshift, and light in a band of 100 A with sharp edges errs by up to 3%.
Spectra with negative sums of components, which count as 0, are summed by GalaxySeds.rates: some 2% of all.
"""

from __future__ import annotations

from functools import lru_cache
from typing import TYPE_CHECKING

import numba
import numpy as np

from csstsim.base.arrays.polynomial_weights import cubic_weights
from csstsim.base.types import BoolArray, FloatArray, IntArray
from csstsim.universe.galaxies.galaxy_rates import Cells
from csstsim.universe.galaxies.galaxy_sed import used_range
from csstsim.universe.galaxies.igm import IgmTables, absorb

if TYPE_CHECKING:
    from csstsim.universe.galaxies.galaxy_sed import GalaxySeds

_STEP = 1e-3  # of ln(1 + z): cubic interpolation errs by 1e-3 where the forest's edge leaves a band, by 1e-4 elsewhere
_BLOCK = 128  # steps of a table
_TAPS = 4
_DUST = 1.0  # mag of A(V) between tables
_MOMENTS = 3  # terms of the exponential: 1e-4 half way between tables
_TABLES = 48  # kept; a brick without much dust has 17
_BLUE = 2000.0  # A: a sum of components that is negative anywhere is so below
_FEWEST = 1000  # galaxies for which a table costs less than each sum by itself
_cubic = numba.njit()(cubic_weights)


class BandRates:
    """`seds`: galaxy_sed.GalaxySeds; weights: (bands, 18001) on the paper's grid, of whole bands.

    fewest: of galaxies that share a table; fewer are summed by GalaxySeds.rates.
    """

    def __init__(self, seds: GalaxySeds, weights: FloatArray, fewest: int = _FEWEST) -> None:
        self.seds = seds
        self.weights = np.asarray(weights, dtype=float)
        self._fewest = fewest
        nodes, basis = seds.cells
        self._signs = np.ascontiguousarray(basis[:, nodes < _BLUE], np.float32)
        self._table = lru_cache(maxsize=_TABLES)(self._make)
        self._behind = lru_cache(maxsize=1)(self._moments)

    def rates(self, z: FloatArray, coefficients: FloatArray, av: FloatArray) -> FloatArray:
        """Return (n, bands): int S w dlambda at unit scale; z, av [mag] (n,), coefficients (n, 20)."""
        z = np.asarray(z, dtype=float)
        av = np.asarray(av, dtype=float)
        coefficients = np.ascontiguousarray(coefficients, dtype=float)
        out = np.empty((len(z), len(self.weights)))
        exact = ~(positive(coefficients.astype(np.float32), self._signs) & np.isfinite(z + av))
        rows = np.flatnonzero(~exact)
        screen = np.rint(av[rows] / _DUST).astype(int)
        part = np.floor(np.log1p(z[rows]) / (_STEP * _BLOCK)).astype(int)
        for dust, block in sorted(set(zip(screen.tolist(), part.tolist(), strict=True))):
            some = rows[(screen == dust) & (part == block)]
            if len(some) < self._fewest:
                exact[some] = True
                continue
            table, mean = self._table(dust, block)
            interpolate(out, some, table, block * _BLOCK, z, coefficients, self.seds.depth(av - dust * _DUST), mean)
        out[exact] = self.seds.rates(z[exact], coefficients[exact], av[exact], self.weights)
        return out

    def _make(self, dust: int, block: int) -> tuple[FloatArray, FloatArray]:
        """Return R (nodes, k, bands x moments) for A(V) of `dust` steps, and the mean of the curve (bands,)."""
        moments, mean = self._behind(dust)
        ranges = np.array([used_range(row) for row in self.weights]).reshape(len(self.weights), 2)
        stretch = np.exp(_STEP * (block * _BLOCK + np.arange(-1, _BLOCK + _TAPS - 2)))
        table = tabulate(stretch, moments, ranges, self.seds.cells, self.seds.forest.tables)
        return table.reshape(*table.shape[:2], -1), mean

    def _moments(self, dust: int) -> tuple[FloatArray, FloatArray]:
        """Return w (curve - m)^n (bands, moments, samples) behind dust, and m (bands,)."""
        curve = self.seds.extinction
        weights = self.weights * np.exp(-self.seds.depth(dust * _DUST) * curve)
        total = weights.sum(axis=1)
        mean = np.divide(weights @ curve, total, out=np.zeros(len(total)), where=total > 0)
        factors = np.repeat((curve - mean[:, None])[:, None], _MOMENTS, axis=1)
        factors[:, 0] = weights
        return np.cumprod(factors, axis=1), mean


@numba.njit(cache=True)
def positive(coefficients: FloatArray, basis: FloatArray) -> BoolArray:
    """Return a mask (n,) of galaxies whose sum of components is positive at all nodes of `basis` (k, nodes)."""
    out = np.empty(len(coefficients), np.bool_)
    total = np.empty(basis.shape[1], basis.dtype)
    for g in range(len(coefficients)):
        total[:] = 0
        for k in range(0, len(basis), 2):
            a = coefficients[g, k]
            b = coefficients[g, k + 1]
            one = basis[k]
            two = basis[k + 1]
            for j in range(len(total)):
                total[j] += a * one[j] + b * two[j]
        below = 0
        for j in range(len(total)):
            below += total[j] < 0
        out[g] = below == 0 and np.isfinite(total[0])
    return out


@numba.njit(cache=True)
def tabulate(
    stretches: FloatArray,
    weights: FloatArray,
    ranges: IntArray,
    cells: Cells,
    igm: IgmTables,
) -> FloatArray:
    """Return (nodes of redshift, k, bands, moments): sums of components at 1 + z = `stretches` times the weights.

    weights: (bands, moments, samples), used in `ranges` (bands, 2); cells: as of GalaxySeds; igm: at the samples.
    """
    nodes = cells.nodes
    basis = cells.basis
    grid = igm.wavelength
    bands, terms, samples = weights.shape
    clear = np.zeros((bands, terms, 2, samples + 1))
    behind = np.zeros((terms, 2, samples + 1))
    through = np.ones(samples)
    hats = np.empty((len(nodes) + 1, terms))
    last = len(nodes) - 1
    for b in range(bands):
        _running(clear[b], weights[b], through, grid, ranges[b, 0], ranges[b, 1])
    out = np.zeros((len(stretches), len(basis), bands, terms))
    for row in range(len(stretches)):
        stretch = stretches[row]
        for b in range(bands):
            begin, end = ranges[b]
            running = clear[b]
            if begin < end and grid[begin] < igm.edges[0] * stretch:
                through[begin:end] = 1.0
                absorb(through, begin, end, stretch - 1.0, igm)
                running = behind
                _running(running, weights[b], through, grid, begin, end)
            start = max(begin, np.searchsorted(grid, nodes[0] * stretch))
            first = j = max(np.searchsorted(nodes, grid[min(start, samples - 1)] / stretch, side="right") - 1, 0)
            hats[j:] = 0.0  # of the light, how much each node's value counts
            while start < end:  # in a cell the spectrum is linear; beyond the last node it is constant
                stop = start + 1
                while stop < end and (j == last or grid[stop] < nodes[j + 1] * stretch):
                    stop += 1
                for n in range(terms):
                    left = running[n, 0, stop] - running[n, 0, start]
                    right = 0.0
                    if j < last:
                        moment = (running[n, 1, stop] - running[n, 1, start]) / stretch
                        right = (moment - nodes[j] * left) / (nodes[j + 1] - nodes[j])
                    hats[j, n] += left - right
                    hats[j + 1, n] += right
                start = stop
                while j < last and start < end and nodes[j + 1] * stretch <= grid[start]:
                    j += 1
            for k in range(len(basis)):
                part = basis[k]
                one = 0.0
                two = 0.0
                three = 0.0
                for node in range(first, min(j, last - 1) + 2):
                    one += hats[node, 0] * part[node]
                    two += hats[node, 1] * part[node]
                    three += hats[node, 2] * part[node]
                out[row, k, b] = one, two, three
    return out


@numba.njit(cache=True)
def _running(
    running: FloatArray, weights: FloatArray, through: FloatArray, grid: FloatArray, begin: int, end: int
) -> None:
    """Put into `running` the sums before each sample of weights (moments, samples) x through, and of these x lambda."""
    for n in range(len(weights)):
        total = 0.0
        moment = 0.0
        for i in range(begin, end):
            running[n, 0, i] = total
            running[n, 1, i] = moment
            light = weights[n, i] * through[i]
            total += light
            moment += light * grid[i]
        running[n, 0, end] = total
        running[n, 1, end] = moment


@numba.njit(cache=True)
def interpolate(
    out: FloatArray,
    rows: IntArray,
    table: FloatArray,
    first: int,
    z: FloatArray,
    coefficients: FloatArray,
    depth: FloatArray,
    mean: FloatArray,
) -> None:
    """Fill out[rows] (bands); table: of _make, from step `first` - 1 on; depth (n,), mean (bands,): d and m_b."""
    w = np.empty(_TAPS)
    terms = table.shape[2] // len(mean)
    light = np.empty(table.shape[2])
    for g in rows:
        x = np.log1p(z[g]) / _STEP - first + 1.0
        at = min(max(int(x), 1), len(table) - _TAPS + 1) - 1
        t = x - at  # 1 to 2
        w[0], w[1], w[2], w[3] = _cubic(t - 1.0)  # the difference is exact
        light[:] = 0.0
        for k in range(table.shape[1]):
            one = table[at, k]
            two = table[at + 1, k]
            three = table[at + 2, k]
            four = table[at + 3, k]
            c = coefficients[g, k]
            for m in range(len(light)):
                light[m] += c * (w[0] * one[m] + w[1] * two[m] + w[2] * three[m] + w[3] * four[m])
        d = depth[g]
        for b in range(len(mean)):
            total = 0.0
            factor = np.exp(-d * mean[b])
            for n in range(terms):
                total += factor * light[b * terms + n]
                factor *= -d / (n + 1)
            out[g, b] = max(total, 0.0)
