"""Maps of a whole frame computed from other maps, each in one pass and without temporary frames."""

from collections.abc import Sequence

import numba
import numpy as np

from csstsim.base.types import BoolArray, FloatArray, IntArray

BIN = 2  # px


@numba.njit(cache=True)
def binned(image: FloatArray) -> FloatArray:
    """Return sums of BIN x BIN pixels, float32; a last odd row or column is left out, a single one counts twice."""
    ny, nx = image.shape
    out = np.empty((max(ny // BIN, 1), max(nx // BIN, 1)), np.float32)
    down = min(1, ny - 1)
    right = min(1, nx - 1)
    for j in range(out.shape[0]):
        y = BIN * j
        for i in range(out.shape[1]):
            x = BIN * i
            out[j, i] = image[y, x] + image[y, x + right] + (image[y + down, x] + image[y + down, x + right])
    return out


@numba.njit(cache=True)
def full_size(small: FloatArray, shape: tuple[int, ...]) -> FloatArray:
    """Return a binned map (C-contiguous) at the frame's shape; a last odd row or column has its neighbour's value."""
    out = np.empty(shape, small.dtype)
    for y in range(shape[0]):
        line = small[min(y // BIN, small.shape[0] - 1)]
        for x in range(shape[1]):
            out[y, x] = line[min(x // BIN, line.size - 1)]
    return out


@numba.njit(cache=True)
def grown(mask: BoolArray, reach: int) -> BoolArray:
    """Return `mask`, bool (ny, nx), grown by `reach` px in steps along the axes."""
    ny, nx = mask.shape
    out = mask.copy()
    for y in range(ny):
        for x in range(nx):
            if not mask[y, x]:
                continue
            inner = 0 < y < ny - 1 and 0 < x < nx - 1
            if inner and mask[y - 1, x] and mask[y + 1, x] and mask[y, x - 1] and mask[y, x + 1]:
                continue  # inside the mask: nothing to add
            for v in range(max(y - reach, 0), min(y + reach + 1, ny)):
                half_width = reach - abs(v - y)
                out[v, max(x - half_width, 0) : min(x + half_width + 1, nx)] = True
    return out


@numba.njit(cache=True)
def solid(image: FloatArray, threshold: float, sign: float) -> BoolArray:
    """Return bool (ny, nx): pixels of `sign` x image above the threshold, as at least five of eight neighbours are."""
    ny, nx = image.shape
    out = np.zeros((ny, nx), np.bool_)
    for y in range(ny):
        for x in range(nx):
            if not sign * image[y, x] > threshold:
                continue
            count = 0
            for v in range(max(y - 1, 0), min(y + 2, ny)):
                for u in range(max(x - 1, 0), min(x + 2, nx)):
                    count += sign * image[v, u] > threshold
            out[y, x] = count > 5
    return out


@numba.njit(cache=True)
def flux_within(image: FloatArray, segments: IntArray, count: int) -> FloatArray:
    """Return (count,): the sum of `image` over the pixels with number k + 1 in `segments`, both (ny, nx)."""
    out = np.zeros(count)
    for y in range(image.shape[0]):
        for x in range(image.shape[1]):
            if segments[y, x] > 0:
                out[segments[y, x] - 1] += image[y, x]
    return out


def interpolated(mesh: FloatArray, middle: Sequence[FloatArray], shape: tuple[int, ...]) -> FloatArray:
    """Return float32 of `shape`, bilinear between the meshes' middles (rows, columns), constant beyond the last."""
    out = np.empty(shape, np.float32)
    _between(out, *_lines_between(mesh, middle, shape), np.float32(0), np.float32(1))
    return out


def add_interpolated(image: FloatArray, mesh: FloatArray, middle: Sequence[FloatArray], factor: float) -> None:
    """Add `factor` times the `interpolated` mesh to an image (ny, nx), in place."""
    _between(image, *_lines_between(mesh, middle, image.shape), np.float32(1), np.float32(factor))


def _lines_between(
    mesh: FloatArray, middle: Sequence[FloatArray], shape: tuple[int, ...]
) -> tuple[FloatArray, FloatArray]:
    """Return (lines of the mesh at full width, position of each row of `shape` among them)."""
    lines = np.array([np.interp(np.arange(shape[1]), middle[1], line) for line in mesh], np.float32)
    return lines, np.interp(np.arange(shape[0]), middle[0], np.arange(len(mesh)))


@numba.njit(cache=True)
def _between(
    image: FloatArray, lines: FloatArray, position: FloatArray, image_factor: np.float32, factor: np.float32
) -> None:
    """Set each row to `image_factor` times itself plus `factor` times the `lines` interpolated at its position."""
    for y in range(position.size):
        low = min(int(position[y]), max(len(lines) - 2, 0))
        high = min(low + 1, len(lines) - 1)
        fraction = np.float32(position[y] - low)
        for x in range(image.shape[1]):
            value = factor * ((np.float32(1) - fraction) * lines[low, x] + fraction * lines[high, x])
            image[y, x] = value if image_factor == 0 else image_factor * image[y, x] + value
