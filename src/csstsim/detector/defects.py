"""Defective pixels and bad columns (paper, sections 5.5.7 and 5.5.8).

    hot     charge of the pixel + Poisson(rate x exposure time), rate ~ Gamma / hot_time
    dead    u x background + N(0, dead_noise), u uniform in 0 to dead_max
    column  (1 - u)(low_factor background + low_offset) + u (high_factor background + high_offset), u uniform, with
            noise of column_noise times the background's own, sqrt(background + read noise^2)

Positions, rates and u are fixed for a chip; noise is new in each exposure. A bad column extends from the boundary of
the halves towards the amplifier. Numbers are drawn for the whole chip, so that a window has the same defects. A charge
is never below 0. Left out: hot pixels during readout, clusters, and defects of the amplifiers. Below, `numbers` is
instrument.defects.Defects; rng are numpy Generators.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from csstsim.base.arrays.robust_sigma import sigma_of_deviations
from csstsim.base.types import AnyArray, BoolArray, FloatArray, Floats, IntArray

if TYPE_CHECKING:
    from csstsim.instrument.chip import Window
    from csstsim.instrument.defects import Defects

_SAMPLE = 1_000_000  # pixels used for the background
_CLIP = 5.0  # robust sigma


def background(image: AnyArray, total: float | None = None) -> float:
    """Return the clipped mean [e-] of an image, without pixels of objects and defects; at least 0.

    total: the sum of its pixels, if it is known. Raises ValueError if the image has NaN or infinite values.
    """
    if not np.isfinite(image.sum(dtype=float) if total is None else total):
        raise ValueError(f"{np.count_nonzero(~np.isfinite(image))} pixel(s) of the image are not finite")
    some = image.reshape(-1)[:: max(image.size // _SAMPLE, 1) | 1].astype(float)
    middle = np.median(some)
    away = np.abs(some - middle)
    kept = some[away <= _CLIP * max(sigma_of_deviations(away), 1.0)]  # at least 1 e-: charges are whole electrons
    return max(float(kept.mean()), 0.0)


def places(shape: tuple[int, int], numbers: Defects, rng: np.random.Generator) -> tuple[IntArray, IntArray]:
    """Return (hot, dead): flat indices of the defective pixels of a chip of shape (ny, nx); no pixel is both."""
    pixels = shape[0] * shape[1]
    chosen = rng.choice(pixels, round(numbers.defective * pixels), replace=False)
    hot = round(numbers.hot_share * len(chosen))
    return chosen[:hot], chosen[hot:]


def hot_charge(
    count: int, seconds: float, numbers: Defects, rng_chip: np.random.Generator, rng: np.random.Generator
) -> IntArray:
    """Return (count,) electrons of hot pixels: Poisson noise from rng, rates (at least hot_min) from rng_chip."""
    rate = rng_chip.gamma(numbers.hot_shape, numbers.hot_scale, count) / numbers.hot_time
    return rng.poisson(np.maximum(rate, numbers.hot_min) * seconds)


def dead_charge(
    count: int, level: float, numbers: Defects, rng_chip: np.random.Generator, rng: np.random.Generator
) -> FloatArray:
    """Return (count,) electrons of dead pixels under a background `level`."""
    share = rng_chip.uniform(0, numbers.dead_max, count)
    return np.maximum(share * level + numbers.dead_noise * rng.standard_normal(count), 0.0)


def columns(half_rows: int, nx: int, numbers: Defects, rng: np.random.Generator) -> list[tuple[int, int, int, float]]:
    """Return a chip's bad columns as a list of (column, first row, end, u); chip rows [px], half-open."""
    first = int(numbers.columns_from * nx)
    end = max(int(numbers.columns_to * nx), int(numbers.columns_from * nx) + 1)
    found = []
    for half in range(2):
        count = min(int(rng.integers(numbers.columns_min, numbers.columns_max + 1)), end - first)
        for column in first + rng.choice(end - first, count, replace=False):
            length = round(rng.uniform(numbers.length_min, numbers.length_max) * half_rows)
            rows = (half_rows - length, half_rows) if half == 0 else (half_rows, half_rows + length)
            found.append((int(column), *rows, rng.random()))
    return found


def column_charge(
    rows: int, u: float, level: float, read_noise: float, numbers: Defects, rng: np.random.Generator
) -> FloatArray:
    """Return (rows,) electrons of a bad column; its noise is complete after the readout has added read_noise [e-]."""
    mean, sigma = column_level(u, level, read_noise, numbers)
    return np.maximum(mean + sigma * rng.standard_normal(rows), 0.0)


def column_level(u: Floats, level: float, read_noise: float, numbers: Defects) -> tuple[Floats, float]:
    """Return (mean, sigma) [e-] of a bad column's charge; u: float or array."""
    low = numbers.low_factor * level + numbers.low_offset
    high = numbers.high_factor * level + numbers.high_offset
    return (1 - u) * low + u * high, np.sqrt(numbers.column_noise**2 * (level + read_noise**2) - read_noise**2)


def inside(index: IntArray, nx: int, window: Window) -> tuple[BoolArray, IntArray, IntArray]:
    """Return (which, y, x): bool, whether flat indices of a chip of `nx` columns lie in a window; positions in it."""
    y = index // nx - window.y0
    x = index % nx - window.x0
    which = (y >= 0) & (y < window.ny) & (x >= 0) & (x < window.nx)
    return which, y[which], x[which]
