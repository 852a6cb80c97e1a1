"""A large image reduced to a picture's pixels: means of square blocks, or the largest bits of a mask."""

import numpy as np

from csstsim.base.types import AnyArray, FloatArray, IntArray


def block_mean(image: AnyArray, step: int) -> FloatArray:
    """Return the means of `step` x `step` blocks of a 2-D image, float32; blocks at the far edges may be smaller.

    Pixels that are not finite are left out; a block without finite pixels is NaN. Strips of `step` rows are processed
    one by one, so that a large image is never copied.
    """
    starts = np.arange(0, image.shape[1], step)
    means = np.empty((-(-image.shape[0] // step), starts.size), np.float32)
    for row in range(means.shape[0]):
        strip = np.asarray(image[row * step : (row + 1) * step], np.float64)
        good = np.isfinite(strip)
        total = np.add.reduceat(np.where(good, strip, 0.0).sum(axis=0), starts)
        count = np.add.reduceat(good.sum(axis=0), starts)
        means[row] = np.divide(total, count, out=np.full(starts.size, np.nan), where=count > 0)
    return means


def block_max(image: IntArray, step: int) -> IntArray:
    """Return the largest values of `step` x `step` blocks of a 2-D mask of integers: single bad pixels stay visible."""
    rows, columns = (np.arange(0, size, step) for size in image.shape)
    return np.maximum.reduceat(np.maximum.reduceat(np.asarray(image), columns, axis=1), rows, axis=0)
