"""Resampling of densities (spectra, throughput curves, sensitivities) to another grid, conserving the integral.

A density is piecewise linear between its samples and zero outside. Interpolation at points would lose or double
features narrower than the grid's step. So the value of a bin is the mean of the density, from its exact integral.
"""

import numpy as np

_EXACT = 1e-9  # of a step: closer samples are on a point of the grid


def bin_averages(edges: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Return the mean (n,) over each bin of a piecewise linear density.

    edges: (n + 1,) rising bounds of the bins; x: (m,) rising positions of the samples, in the same unit; y: (m,)
    samples.
    """
    x, y, at = np.asarray(x, float), np.asarray(y, float), np.clip(edges, x[0], x[-1])
    total = np.concatenate([[0.0], np.cumsum(0.5 * (y[1:] + y[:-1]) * np.diff(x))])
    k = np.clip(np.searchsorted(x, at, side="right") - 1, 0, len(x) - 2)
    into = at - x[k]
    gap = x[k + 1] - x[k]
    below = total[k] + into * (y[k] + 0.5 * (y[k + 1] - y[k]) * into / gap)
    return np.diff(below) / np.diff(edges)


def on_grid(grid: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Return values (n,) on an even grid whose trapezoid sum is the integral of a piecewise linear density.

    If all samples are on points of the grid, the values are the samples. Otherwise they are means over bins, one step
    wide, around each point. A density that ends within the grid ends at its last sample.

    grid: (n,) even and rising; x: (m,) rising positions of the samples; y: (m,) samples.
    """
    x = np.asarray(x, float)
    y = np.asarray(y, float)
    step = grid[1] - grid[0]
    off = (x[(x >= grid[0]) & (x <= grid[-1])] - grid[0]) / step
    whole = (x[0] <= grid[0] or y[0] == 0) and (x[-1] >= grid[-1] or y[-1] == 0)
    if whole and np.abs(off - np.rint(off)).max(initial=0.0) < _EXACT:
        return np.interp(grid, x, y, left=0.0, right=0.0)
    return bin_averages(np.append(grid - 0.5 * step, grid[-1] + 0.5 * step), x, y)


def read_at(wave: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Return a piecewise linear curve at some positions, or its means (`on_grid`) if its samples are closer.

    wave: (n,) an even grid, or positions of any shape, at which the curve is interpolated; x: (m,) rising positions of
    the samples; y: (m,) samples; the curve is constant beyond both ends.
    """
    wave = np.asarray(wave, float)
    x = np.asarray(x, float)
    y = np.asarray(y, float)
    steps = np.diff(wave) if wave.ndim == 1 else np.zeros(0)
    if not (steps.size and steps[0] > 0 and np.ptp(steps) < 1e-6 * steps[0]):
        return np.interp(wave, x, y)
    ends = wave[0] - steps[0], wave[-1] + steps[0]
    within = x[(x > ends[0]) & (x < ends[1])]
    if np.diff(within).min(initial=np.inf) >= steps[0] * (1 - _EXACT):
        return np.interp(wave, x, y)
    at = np.unique([*ends, *within])
    return on_grid(wave, at, np.interp(at, x, y))
