"""Thumbnails of Level-0 files for the report: electrons above each channel's overscan, block-averaged, stretched.

They are not calibrated: nonlinearity, flat field and defects remain.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from csstsim.base.arrays.robust_sigma import robust_sigma, sigma_of_deviations

if TYPE_CHECKING:
    from csstsim.base.types import BoolArray, FloatArray, IntArray
    from csstsim.instrument.chip import Window
    from csstsim.io.level0 import Level0

MAX_SIDE = 384  # pixels along a thumbnail's longer side
# sigma from the background: the black level, and the lowest white level
BLACK = -3.0
WHITE = 30.0
SOFT = 3.0  # sigma; the asinh stretch is linear below


def step_for(window: Window, max_side: int = MAX_SIDE) -> int:
    """Return the block side [px] with which `window` (instrument.chip.Window) fits in `max_side` blocks."""
    return -(-max(window.shape) // max_side)


def binned(file: Level0, window: Window, step: int) -> FloatArray:
    """Return mean electrons of step x step blocks of `window`, float64; blocks at the far edges may be smaller.

    `file`: an open io.level0.Level0. A block of pixels that were not read is NaN.
    """
    shape = tuple(-(-n // step) for n in window.shape)
    total = np.zeros(shape)
    pixels = np.zeros(shape)
    for channel in file.channels():
        c = channel.window
        x0 = max(c.x0, window.x0)
        x1 = min(c.x1, window.x1)
        y0 = max(c.y0, window.y0)
        y1 = min(c.y1, window.y1)
        if x0 >= x1 or y0 >= y1:
            continue
        level = _level(channel.serial_overscan)
        part = channel.active[y0 - c.y0 : y1 - c.y0, x0 - c.x0 : x1 - c.x0]
        rows, i = _starts(y0 - window.y0, y1 - window.y0, step)
        columns, j = _starts(x0 - window.x0, x1 - window.x0, step)
        sums = np.add.reduceat(np.add.reduceat(part, rows, axis=0, dtype=np.int64), columns, axis=1)
        n = np.outer(np.diff(rows, append=y1 - y0), np.diff(columns, append=x1 - x0))
        blocks = slice(i, i + len(rows)), slice(j, j + len(columns))
        total[blocks] += (sums - level * n) * (channel.gain or 1.0)
        pixels[blocks] += n
    return np.divide(total, pixels, out=np.full(shape, np.nan), where=pixels > 0)


def any_in_blocks(mask: BoolArray, step: int) -> BoolArray:
    """Return whether any pixel of each step x step block of a mask (ny, nx) is set, in the blocks of `binned`."""
    for axis, n in enumerate(mask.shape):
        mask = np.logical_or.reduceat(mask, np.arange(0, n, step), axis=axis)
    return mask


def _level(overscan: IntArray) -> float:
    """Return the mean of an overscan region [DN] without outliers; a median would be rounded to whole DN."""
    if not overscan.size:
        return 0.0
    middle = np.median(overscan)
    distance = np.abs(overscan - middle)
    return overscan[distance <= 4 * max(sigma_of_deviations(distance), 1.0)].mean()


def _starts(first: int, last: int, step: int) -> tuple[IntArray, int]:
    """Return (starts of the blocks in [first, last), counted from first; the number of the first block)."""
    edges = np.arange(first // step * step, last, step)
    return np.maximum(edges, first) - first, first // step


def stretch(image: FloatArray) -> IntArray:
    """Return uint8 greys of an image: asinh of its distance from the background, in units of the noise.

    Background and noise are the median and the scatter about it; NaN is black. White begins at the brightest 0.1%, or
    at WHITE sigma if that is higher.
    """
    good = np.isfinite(image)
    if not good.any():
        return np.zeros(image.shape, np.uint8)
    values = image[good]
    level = np.median(values)
    noise = robust_sigma(values, level) or values.std() or 1.0
    high = max(WHITE, float(np.quantile(values, 0.999) - level) / noise)
    low = np.arcsinh(BLACK / SOFT)
    high = np.arcsinh(high / SOFT)
    scaled = (np.arcsinh((np.where(good, image, -np.inf) - level) / noise / SOFT) - low) / (high - low)
    return np.rint(255.0 * np.clip(scaled, 0.0, 1.0)).astype(np.uint8)


def brightest_window(greys: IntArray, window: Window, step: int, max_side: int = MAX_SIDE) -> Window:
    """Return the Window of `max_side` px a side, within `window`, where its thumbnail (uint8) is brightest."""
    from scipy.ndimage import uniform_filter

    side = max(max_side // step, 1)
    brightness = uniform_filter(greys.astype(float), side, mode="constant")
    row, column = np.unravel_index(brightness.argmax(), brightness.shape)
    return window_around(window.x0 + column * step, window.y0 + row * step, window, max_side)


def window_around(x: float, y: float, window: Window, side: int) -> Window:
    """Return the Window of `side` px around x, y, moved and cut so that it lies within `window`."""
    x0, x1 = _span(x, window.x0, window.x1, side)
    y0, y1 = _span(y, window.y0, window.y1, side)
    return type(window)(x0, x1, y0, y1)


def _span(middle: float, low: int, high: int, max_side: int) -> tuple[int, int]:
    start = int(max(min(round(middle) - max_side // 2, high - max_side), low))
    return start, min(start + max_side, high)
