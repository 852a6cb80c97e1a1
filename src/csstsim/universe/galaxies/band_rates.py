"""Fluxes of galaxies in bands, from tables in redshift: they take at most a fifth of the time of GalaxySeds.rates.

A spectrum is a sum of components, so its flux in a band is a sum over components, which depend only on redshift:

    rate_b = sum_k c_k exp(-d m_b) sum_n (-d)^n / n! R_nbk(z)
    R_nbk(z) = sum_i w_b(lambda_i) (curve_i - m_b)^n IGM(lambda_i, z) P_k(lambda_i / (1 + z))

w: weights behind the dust of the table, d: optical depth of the galaxy's further dust, m_b: mean of the dust's curve
over the band. Bands need soft edges, such as those of CSST. A line crosses a sharp edge within less than a step of
redshift, and the flux in a band of 100 A with sharp edges errs by up to 3%.
GalaxySeds.rates sums spectra in which a sum of components is negative, and counts as 0: some 2% of all.
"""

from __future__ import annotations

from functools import lru_cache
from typing import TYPE_CHECKING

import numba
import numpy as np

from csstsim.base.arrays.polynomial_weights import cubic_weights
from csstsim.base.types import BoolArray, FloatArray, IntArray
from csstsim.universe.galaxies.galaxy_rates import Cells
from csstsim.universe.galaxies.galaxy_sed import nonzero_range
from csstsim.universe.galaxies.igm import IgmTables, absorb

if TYPE_CHECKING:
    from csstsim.universe.galaxies.galaxy_sed import GalaxySeds

_STEP = 1e-3  # of ln(1 + z): cubic interpolation errs by 1e-4, by 1e-3 where the edge of the forest leaves a band
_BLOCK_STEPS = 128  # steps of a table
_TAPS = 4
_DUST = 1.0  # mag of A(V) between tables
_MOMENTS = 3  # terms of the exponential: 1e-4 half way between tables
_TABLES_CACHED = 48  # a brick without much dust uses 17
_BLUE = 2000.0  # A: a sum of components that is negative anywhere is negative below this wavelength
_GALAXIES_MIN = 1000  # number for which a table costs less than single sums
_cubic = numba.njit()(cubic_weights)


class BandRates:
    """`seds`: galaxy_sed.GalaxySeds; weights: (bands, 18001) on the paper's grid, of whole bands.

    galaxies_min: minimum number of galaxies for which a table is made; GalaxySeds.rates sums fewer.
    """

    def __init__(self, seds: GalaxySeds, weights: FloatArray, galaxies_min: int = _GALAXIES_MIN) -> None:
        self.seds = seds
        self.weights = np.asarray(weights, dtype=float)
        self._galaxies_min = galaxies_min
        nodes, components = seds.cells
        self._signs = np.ascontiguousarray(components[:, nodes < _BLUE], np.float32)
        self._table = lru_cache(maxsize=_TABLES_CACHED)(self._make_table)
        self._behind = lru_cache(maxsize=1)(self._moments)

    def rates(self, z: FloatArray, coefficients: FloatArray, av: FloatArray) -> FloatArray:
        """Return (n, bands): int S w dlambda at unit scale; z, av [mag] (n,), coefficients (n, 20)."""
        z = np.asarray(z, dtype=float)
        av = np.asarray(av, dtype=float)
        coefficients = np.ascontiguousarray(coefficients, dtype=float)
        out = np.empty((len(z), len(self.weights)))
        exact = ~(all_positive(coefficients.astype(np.float32), self._signs) & np.isfinite(z + av))
        rows = np.flatnonzero(~exact)
        dust_of = np.rint(av[rows] / _DUST).astype(int)
        block_of = np.floor(np.log1p(z[rows]) / (_STEP * _BLOCK_STEPS)).astype(int)
        for dust, block in sorted(set(zip(dust_of.tolist(), block_of.tolist(), strict=True))):
            group = rows[(dust_of == dust) & (block_of == block)]
            if len(group) < self._galaxies_min:
                exact[group] = True
                continue
            table, mean = self._table(dust, block)
            interpolate(
                out, group, table, block * _BLOCK_STEPS, z, coefficients, self.seds.depth(av - dust * _DUST), mean
            )
        out[exact] = self.seds.rates(z[exact], coefficients[exact], av[exact], self.weights)
        return out

    def _make_table(self, dust: int, block: int) -> tuple[FloatArray, FloatArray]:
        """Return R (nodes, k, bands x moments) for A(V) of `dust` steps, and the mean of the curve (bands,)."""
        moments, mean = self._behind(dust)
        ranges = np.array([nonzero_range(row) for row in self.weights]).reshape(len(self.weights), 2)
        stretches = np.exp(_STEP * (block * _BLOCK_STEPS + np.arange(-1, _BLOCK_STEPS + _TAPS - 2)))
        table = tabulate(stretches, moments, ranges, self.seds.cells, self.seds.forest.tables)
        return table.reshape(*table.shape[:2], -1), mean

    def _moments(self, dust: int) -> tuple[FloatArray, FloatArray]:
        """Return w (curve - m)^n (bands, moments, samples) behind `dust` steps of dust, and m (bands,)."""
        curve = self.seds.extinction
        weights = self.weights * np.exp(-self.seds.depth(dust * _DUST) * curve)
        total = weights.sum(axis=1)
        mean = np.divide(weights @ curve, total, out=np.zeros(len(total)), where=total > 0)
        factors = np.repeat((curve - mean[:, None])[:, None], _MOMENTS, axis=1)
        factors[:, 0] = weights
        return np.cumprod(factors, axis=1), mean


@numba.njit(cache=True)
def all_positive(coefficients: FloatArray, basis: FloatArray) -> BoolArray:
    """Return a mask (n,) of galaxies whose sum of components is positive at all nodes of `basis` (k, nodes)."""
    out = np.empty(len(coefficients), np.bool_)
    total = np.empty(basis.shape[1], basis.dtype)
    for g in range(len(coefficients)):
        total[:] = 0
        for k in range(0, len(basis), 2):
            c_even = coefficients[g, k]
            c_odd = coefficients[g, k + 1]
            even = basis[k]
            odd = basis[k + 1]
            for j in range(len(total)):
                total[j] += c_even * even[j] + c_odd * odd[j]
        negative = 0
        for j in range(len(total)):
            negative += total[j] < 0
        out[g] = negative == 0 and np.isfinite(total[0])
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
    absorbed = np.zeros((terms, 2, samples + 1))
    transmission = np.ones(samples)
    hat_weights = np.empty((len(nodes) + 1, terms))
    last = len(nodes) - 1
    for b in range(bands):
        _running_sums(clear[b], weights[b], transmission, grid, ranges[b, 0], ranges[b, 1])
    out = np.zeros((len(stretches), len(basis), bands, terms))
    for row in range(len(stretches)):
        stretch = stretches[row]
        for b in range(bands):
            begin, end = ranges[b]
            sums = clear[b]
            if begin < end and grid[begin] < igm.edges[0] * stretch:
                transmission[begin:end] = 1.0
                absorb(transmission, begin, end, stretch - 1.0, igm)
                sums = absorbed
                _running_sums(sums, weights[b], transmission, grid, begin, end)
            start = max(begin, np.searchsorted(grid, nodes[0] * stretch))
            first = j = max(np.searchsorted(nodes, grid[min(start, samples - 1)] / stretch, side="right") - 1, 0)
            hat_weights[j:] = 0.0  # of the value at each node in the flux
            while start < end:  # in a cell the spectrum is linear; beyond the last node it is constant
                stop = start + 1
                while stop < end and (j == last or grid[stop] < nodes[j + 1] * stretch):
                    stop += 1
                for n in range(terms):
                    left = sums[n, 0, stop] - sums[n, 0, start]
                    right = 0.0
                    if j < last:
                        moment = (sums[n, 1, stop] - sums[n, 1, start]) / stretch
                        right = (moment - nodes[j] * left) / (nodes[j + 1] - nodes[j])
                    hat_weights[j, n] += left - right
                    hat_weights[j + 1, n] += right
                start = stop
                while j < last and start < end and nodes[j + 1] * stretch <= grid[start]:
                    j += 1
            for k in range(len(basis)):
                component = basis[k]
                sum0 = 0.0
                sum1 = 0.0
                sum2 = 0.0
                for node in range(first, min(j, last - 1) + 2):
                    sum0 += hat_weights[node, 0] * component[node]
                    sum1 += hat_weights[node, 1] * component[node]
                    sum2 += hat_weights[node, 2] * component[node]
                out[row, k, b] = sum0, sum1, sum2
    return out


@numba.njit(cache=True)
def _running_sums(
    sums: FloatArray, weights: FloatArray, transmission: FloatArray, grid: FloatArray, begin: int, end: int
) -> None:
    """Fill `sums` with sums before each sample of weights (moments, samples) x transmission, and of these x lambda."""
    for n in range(len(weights)):
        total = 0.0
        moment = 0.0
        for i in range(begin, end):
            sums[n, 0, i] = total
            sums[n, 1, i] = moment
            product = weights[n, i] * transmission[i]
            total += product
            moment += product * grid[i]
        sums[n, 0, end] = total
        sums[n, 1, end] = moment


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
    """Fill out[rows] (bands); table: of _make_table, from step `first` - 1; depth (n,), mean (bands,): d and m_b."""
    taps = np.empty(_TAPS)
    terms = table.shape[2] // len(mean)
    summed = np.empty(table.shape[2])
    for g in rows:
        x = np.log1p(z[g]) / _STEP - first + 1.0
        first_row = min(max(int(x), 1), len(table) - _TAPS + 1) - 1
        t = x - first_row  # 1 to 2
        taps[0], taps[1], taps[2], taps[3] = _cubic(t - 1.0)  # the difference is exact
        summed[:] = 0.0
        for k in range(table.shape[1]):
            row0 = table[first_row, k]
            row1 = table[first_row + 1, k]
            row2 = table[first_row + 2, k]
            row3 = table[first_row + 3, k]
            c = coefficients[g, k]
            for m in range(len(summed)):
                summed[m] += c * (taps[0] * row0[m] + taps[1] * row1[m] + taps[2] * row2[m] + taps[3] * row3[m])
        d = depth[g]
        for b in range(len(mean)):
            total = 0.0
            factor = np.exp(-d * mean[b])
            for n in range(terms):
                total += factor * summed[b * terms + n]
                factor *= -d / (n + 1)
            out[g, b] = max(total, 0.0)
