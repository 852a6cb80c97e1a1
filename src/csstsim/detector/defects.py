"""Defective pixels and bad columns (paper, sections 5.5.7 and 5.5.8).

    hot     charge of the pixel + Poisson(rate x exposure time), rate ~ Gamma / hot_time
    dead    u x background + N(0, dead_noise), u uniform in 0 to dead_max
    column  (1 - u)(low_factor background + low_offset) + u (high_factor background + high_offset), u uniform, with
            noise of column_noise times the background's own, sqrt(background + read noise^2)

Positions, rates and u are fixed for a chip; noise is new in each exposure. A bad column extends from the boundary of
the halves towards the amplifier. Numbers are drawn for the whole chip, so that a window has the same defects. A charge
is never below 0. Left out: hot pixels during readout, clusters, and defects of the amplifiers. Below, `parameters` is
instrument.defects.Defects; rng are numpy Generators.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from csstsim.base.arrays.robust_sigma import sigma_of_deviations
from csstsim.base.types import AnyArray, BoolArray, FloatArray, Floats, IntArray

if TYPE_CHECKING:
    from csstsim.instrument.chip import Window
    from csstsim.instrument.defects import Defects

_SAMPLE = 1_000_000  # pixels used for the background
_CLIP = 5.0  # robust sigma


class BadColumn(NamedTuple):
    """A bad column of a chip: its rows [px], half-open, and its u (0..1), which gives its level."""

    column: int
    first: int
    end: int
    u: float


class PixelsInWindow(NamedTuple):
    """Which of a chip's pixels are in a window: bool (n,), and the positions of those in it [px], (m,) each."""

    inside: BoolArray
    y: IntArray
    x: IntArray


def background(image: AnyArray, total: float | None = None) -> float:
    """Return the clipped mean [e-] of an image, which leaves out pixels of objects and defects; at least 0.

    total: the sum of its pixels, if it is known. Raises ValueError if the image has NaN or infinite values.
    """
    if not np.isfinite(image.sum(dtype=float) if total is None else total):
        raise ValueError(f"{np.count_nonzero(~np.isfinite(image))} pixel(s) of the image are not finite")
    sample = image.reshape(-1)[:: max(image.size // _SAMPLE, 1) | 1].astype(float)
    median = np.median(sample)
    deviation = np.abs(sample - median)
    limit = _CLIP * max(sigma_of_deviations(deviation), 1.0)  # at least 1 e-: charges are whole electrons
    return max(float(sample[deviation <= limit].mean()), 0.0)


def defective_pixels(
    shape: tuple[int, int], parameters: Defects, rng: np.random.Generator
) -> tuple[IntArray, IntArray]:
    """Return (hot, dead): flat indices of the defective pixels of a chip of shape (ny, nx); no pixel is both."""
    pixels = shape[0] * shape[1]
    chosen = rng.choice(pixels, round(parameters.defective * pixels), replace=False)
    hot = round(parameters.hot_share * len(chosen))
    return chosen[:hot], chosen[hot:]


def hot_charge(
    count: int, seconds: float, parameters: Defects, rng_chip: np.random.Generator, rng: np.random.Generator
) -> IntArray:
    """Return (count,) electrons of hot pixels: Poisson noise from rng, rates (minimum hot_min) from rng_chip."""
    rate = rng_chip.gamma(parameters.hot_shape, parameters.hot_scale, count) / parameters.hot_time
    return rng.poisson(np.maximum(rate, parameters.hot_min) * seconds)


def dead_charge(
    count: int, level: float, parameters: Defects, rng_chip: np.random.Generator, rng: np.random.Generator
) -> FloatArray:
    """Return (count,) electrons of dead pixels under a background `level`."""
    fraction = rng_chip.uniform(0, parameters.dead_max, count)
    return np.maximum(fraction * level + parameters.dead_noise * rng.standard_normal(count), 0.0)


def bad_columns(half_rows: int, nx: int, parameters: Defects, rng: np.random.Generator) -> list[BadColumn]:
    """Return the bad columns of a chip of `nx` columns, with `half_rows` rows [px] in each half."""
    first = int(parameters.columns_from * nx)
    end = max(int(parameters.columns_to * nx), int(parameters.columns_from * nx) + 1)
    columns = []
    for half in range(2):
        count = min(int(rng.integers(parameters.columns_min, parameters.columns_max + 1)), end - first)
        for column in first + rng.choice(end - first, count, replace=False):
            length = round(rng.uniform(parameters.length_min, parameters.length_max) * half_rows)
            rows = (half_rows - length, half_rows) if half == 0 else (half_rows, half_rows + length)
            columns.append(BadColumn(int(column), *rows, rng.random()))
    return columns


def column_charge(
    rows: int, u: float, level: float, read_noise: float, parameters: Defects, rng: np.random.Generator
) -> FloatArray:
    """Return (rows,) electrons of a bad column. The readout adds read_noise [e-], which completes its noise."""
    mean, sigma = column_level(u, level, read_noise, parameters)
    return np.maximum(mean + sigma * rng.standard_normal(rows), 0.0)


def column_level(u: Floats, level: float, read_noise: float, parameters: Defects) -> tuple[Floats, float]:
    """Return (mean, sigma) [e-] of a bad column's charge; u: float or array."""
    low = parameters.low_factor * level + parameters.low_offset
    high = parameters.high_factor * level + parameters.high_offset
    return (1 - u) * low + u * high, np.sqrt(parameters.column_noise**2 * (level + read_noise**2) - read_noise**2)


def in_window(index: IntArray, nx: int, window: Window) -> PixelsInWindow:
    """Return which pixels of a chip of `nx` columns, given by flat indices (n,), are in a window."""
    y = index // nx - window.y0
    x = index % nx - window.x0
    inside = (y >= 0) & (y < window.ny) & (x >= 0) & (x < window.nx)
    return PixelsInWindow(inside, y[inside], x[inside])
