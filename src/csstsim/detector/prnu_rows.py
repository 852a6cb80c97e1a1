"""Multiplication of a frame by the pixel response: the compiled loop of csstsim.detector.prnu."""

import numba
import numpy as np

from csstsim.base.types import FloatArray, IntArray
from csstsim.detector.random.normal import normal_row, normal_table


def multiply_rows(image: FloatArray, x0: int, y0: int, rms: float, key: np.uint64, clip: float) -> None:
    """Multiply as csstsim.detector.prnu.multiply; z is clipped to +-clip."""
    _multiply(image, x0, y0, np.float32(rms), key, np.float32(clip), *normal_table())


def multiply_pixels(values: FloatArray, x: IntArray, y: IntArray, rms: float, key: np.uint64, clip: float) -> None:
    """Multiply as csstsim.detector.prnu.multiply_at; z is clipped to +-clip."""
    _multiply_pixels(values, x, y, np.float32(rms), key, np.float32(clip), *normal_table())


@numba.njit(cache=True)
def _multiply(
    image: FloatArray,
    x0: int,
    y0: int,
    rms: np.float32,
    key: np.uint64,
    clip: np.float32,
    start: FloatArray,
    step: FloatArray,
) -> None:
    ny, nx = image.shape
    halves = np.empty(nx + 2, np.uint32)
    z = np.empty(nx, np.float32)
    one = np.float32(1)
    for y in range(ny):
        normal_row(key, y0 + y, x0, halves, z, start, step)
        for x in range(nx):
            image[y, x] *= one + rms * min(max(z[x], -clip), clip)


@numba.njit(cache=True)
def _multiply_pixels(
    values: FloatArray,
    x: IntArray,
    y: IntArray,
    rms: np.float32,
    key: np.uint64,
    clip: np.float32,
    start: FloatArray,
    step: FloatArray,
) -> None:
    halves = np.empty(3, np.uint32)
    z = np.empty(1, np.float32)
    for i in range(len(values)):
        normal_row(key, y[i], x[i], halves, z, start, step)
        values[i] *= np.float32(1) + rms * min(max(z[0], -clip), clip)
