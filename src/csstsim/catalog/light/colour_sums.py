"""Sums over spectra that are power laws between pivots, without sampling them.

Between two pivots, of magnitudes a and b, the flux is 10^(-0.2 (a + b)) exp(c u): c = 0.4 ln 10 (a - b), and u goes
from -1/2 to 1/2 with the logarithm of wavelength. Its sum with weights w is a power series in c whose coefficients, the
moments sum(w u^n) / n!, depend only on the band. They are computed once; an object costs some 30 products per band.
The series is exact to 1e-10 for steps of up to STEEPEST mag from pivot to pivot. Newton's method may try steeper ones,
which no object has; they are summed sample by sample.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numba
import numpy as np

if TYPE_CHECKING:
    from csstsim.base.types import FloatArray, IntArray

TERMS = 34
STEEPEST = 10.0  # mag
WORST_CONDITION = 1e6  # of Newton's matrix, Frobenius norm: above it no spectrum has such colours
_C = 0.4 * np.log(10.0)


class PivotMoments:
    """Moments of weights (m, len(wave)) over the segments between pivots (b,), which are logarithms of wavelength."""

    def __init__(self, pivots: FloatArray, wave: FloatArray, weights: FloatArray) -> None:
        """wave: (w,) angstrom, of the weights; of the b + 1 segments the first and last lie beyond the pivots."""
        at = np.log(wave)
        self.segment = np.searchsorted(pivots, at)
        inner = np.clip(self.segment, 1, max(len(pivots) - 1, 1))
        low = pivots[np.minimum(inner - 1, len(pivots) - 1)]
        high = pivots[np.minimum(inner, len(pivots) - 1)]
        between = (self.segment > 0) & (self.segment < len(pivots))
        self.offset = np.where(between, (at - low) / np.where(between, high - low, 1.0) - 0.5, 0.0)
        self.weights = np.ascontiguousarray(weights, dtype=float)
        self.moments = _moments(self.segment, self.offset, self.weights, len(pivots) + 1)

    @property
    def arrays(self) -> tuple[FloatArray, IntArray, FloatArray, FloatArray]:
        """The arguments of compiled loops: moments, segment, offset, weights."""
        return self.moments, self.segment, self.offset, self.weights

    def sums(self, nodes: FloatArray) -> FloatArray:
        """Return (n, m): sums of the flux for magnitudes at pivots (n, b); magnitude 0 is flux density 1."""
        return _sums(np.ascontiguousarray(nodes, dtype=float), *self.arrays)


@numba.njit(cache=True)
def _moments(segment: IntArray, offset: FloatArray, weights: FloatArray, segments: int) -> FloatArray:
    out = np.zeros((len(weights), segments, TERMS))
    for m in range(len(weights)):
        for i in range(len(offset)):
            term = weights[m, i]
            if term != 0.0:
                for n in range(TERMS):
                    out[m, segment[i], n] += term
                    term *= offset[i] / (n + 1)
    return out


@numba.njit(cache=True, error_model="numpy")
def _segment(
    m: int, s: int, nodes: FloatArray, moments: FloatArray, segment: IntArray, offset: FloatArray, weights: FloatArray
) -> tuple[float, float]:
    """Return the sum of a segment's flux, and its derivative in c."""
    last = len(nodes) - 1
    if s == 0 or s > last:
        return 10.0 ** (-0.4 * nodes[min(s, last)]) * moments[m, s, 0], 0.0
    c = _C * (nodes[s - 1] - nodes[s])
    level = 10.0 ** (-0.2 * (nodes[s - 1] + nodes[s]))
    total = slope = 0.0
    if abs(c) <= _C * STEEPEST:
        for n in range(TERMS - 1, -1, -1):
            slope = slope * c + total
            total = total * c + moments[m, s, n]
    else:
        for i in range(len(offset)):
            if segment[i] == s and weights[m, i] != 0.0:
                flux = weights[m, i] * np.exp(c * offset[i])
                total += flux
                slope += flux * offset[i]
    return level * total, level * slope


@numba.njit(cache=True)
def _sums(
    nodes: FloatArray, moments: FloatArray, segment: IntArray, offset: FloatArray, weights: FloatArray
) -> FloatArray:
    out = np.zeros((len(nodes), len(moments)))
    for k in range(len(nodes)):
        for m in range(len(moments)):
            for s in range(moments.shape[1]):
                if moments[m, s, 0] != 0.0:
                    out[k, m] += _segment(m, s, nodes[k], moments, segment, offset, weights)[0]
    return out


def newton(mags: FloatArray, through: PivotMoments, tolerance: float, passes: int) -> FloatArray:
    """Return (n, b) magnitudes at the pivots that reproduce `mags` through each band, to `tolerance`.

    through: PivotMoments of the bands, each of weight 1. Rows without a solution keep `mags` at the pivots.
    """
    nodes = np.array(mags, dtype=float, order="C")
    _newton(nodes, tolerance, passes, *through.arrays)
    return nodes


@numba.njit(cache=True, error_model="numpy")
def _newton(
    nodes: FloatArray,
    tolerance: float,
    passes: int,
    moments: FloatArray,
    segment: IntArray,
    offset: FloatArray,
    weights: FloatArray,
) -> None:
    bands = nodes.shape[1]
    slopes = np.empty((bands, bands))
    step = np.empty(bands)
    for k in range(len(nodes)):
        target = nodes[k].copy()
        current = nodes[k]
        converged = False
        for _ in range(passes):
            converged = True
            slopes[:] = 0.0
            for m in range(bands):
                through = 0.0
                for s in range(bands + 1):
                    if moments[m, s, 0] == 0.0:
                        continue
                    flux, derivative = _segment(m, s, current, moments, segment, offset, weights)
                    through += flux
                    if 0 < s < bands:
                        slopes[m, s - 1] += 0.5 * flux - derivative
                        slopes[m, s] += 0.5 * flux + derivative
                    else:
                        slopes[m, min(s, bands - 1)] += flux
                slopes[m] /= through
                step[m] = target[m] + 2.5 * np.log10(through)
                converged &= abs(step[m]) < tolerance  # not for NaN
            if converged or not _solve(slopes, step):
                break
            for m in range(bands):
                current[m] += min(max(step[m], -1.0), 1.0)
        if not converged:
            current[:] = target


@numba.njit(cache=True, error_model="numpy")
def _solve(matrix: FloatArray, values: FloatArray) -> bool:
    """Put the solution of matrix x = values into `values`; False if the matrix is not finite or nearly singular."""
    n = len(values)
    size = np.sqrt((matrix**2).sum())
    both = np.hstack((matrix, np.eye(n)))
    for i in range(n):
        top = i + np.argmax(np.abs(both[i:, i]))
        for j in range(2 * n):
            both[i, j], both[top, j] = both[top, j], both[i, j]
        pivot = both[i, i]
        if not 0.0 < abs(pivot) < np.inf:
            return False
        both[i] /= pivot
        for row in range(n):
            factor = both[row, i]
            if row != i and factor != 0.0:
                both[row] -= factor * both[i]
    inverse = np.ascontiguousarray(both[:, n:])
    if not size * np.sqrt((inverse**2).sum()) < WORST_CONDITION:
        return False
    solved = np.zeros(n)
    for i in range(n):
        for j in range(n):
            solved[i] += inverse[i, j] * values[j]
    values[:] = solved
    return True


@numba.njit(cache=True, error_model="numpy")
def bins(nodes: FloatArray, pivots: FloatArray, edges: FloatArray) -> FloatArray:
    """Return (n, bins): integrals over wavelength of flux density / wavelength, magnitude 0 being 1.

    nodes: (n, b) magnitudes at pivots (b,); edges: rising; pivots and edges are logarithms of wavelength.
    """
    out = np.zeros((len(nodes), len(edges) - 1))
    last = len(pivots) - 1
    for k in range(len(nodes)):
        for s in range(last + 2):
            low = pivots[s - 1] if s > 0 else -np.inf
            high = pivots[s] if s <= last else np.inf
            level_mag = nodes[k, min(s, last)] if s == 0 or s > last else nodes[k, s - 1]
            rise = _C * (nodes[k, s - 1] - nodes[k, s]) / (high - low) if 0 < s <= last else 0.0
            origin = low if 0 < s <= last else 0.0
            level = 10.0 ** (-0.4 * level_mag)
            for j in range(len(edges) - 1):
                start = max(edges[j], low)
                end = min(edges[j + 1], high)
                if start < end:
                    exponent = rise * (end - start)
                    mean_factor = np.expm1(exponent) / exponent if exponent != 0.0 else 1.0
                    out[k, j] += level * np.exp(rise * (start - origin)) * (end - start) * mean_factor
    return out
