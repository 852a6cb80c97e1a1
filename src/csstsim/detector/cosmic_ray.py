"""Cosmic rays (paper, section 5.5.6): straight tracks in the plane of the chip, in whole electrons.

A track starts anywhere, also outside the frame, in a random direction, and deposits its electrons at equal steps; each
electron then diffuses by a Gaussian. Length and charge are independent (paper). The electrons of a pixel are counts, so
no shot noise may be added. Electrons are lost only beyond the edges. Left out: straggling along the track, delta rays,
and the earlier readout of rows near the amplifiers.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numba
import numpy as np

from csstsim.base.counter import word
from csstsim.base.types import FloatArray, IntArray
from csstsim.detector.random.normal import NormalTable, normal, normal_table

if TYPE_CHECKING:
    from csstsim.instrument.cosmic_rays import CosmicRays

_BATCH = 256  # tracks at a time; limits the work space
_FARTHEST = 9  # sigma; larger than any normal number made from 52 bits
_FWHM = np.sqrt(8 * np.log(2))  # of a Gaussian, in sigma
_S32 = np.uint64(32)


class Tracks(NamedTuple):
    """Arrays with a value per track, (n,) each; pixels are those of the frame, with their centres at integers."""

    x: FloatArray  # start [px]
    y: FloatArray
    dx: FloatArray  # extent [px]
    dy: FloatArray
    electrons: IntArray  # int64

    def batch(self, rows: slice) -> Tracks:
        """Return the tracks of a slice."""
        return Tracks(self.x[rows], self.y[rows], self.dx[rows], self.dy[rows], self.electrons[rows])


class Boxes(NamedTuple):
    """Pixels around tracks, half-open: int64 (n,) each."""

    x0: IntArray
    y0: IntArray
    x1: IntArray
    y1: IntArray

    @property
    def area(self) -> IntArray:
        """(n,) pixels."""
        return (self.x1 - self.x0) * (self.y1 - self.y0)

    def batch(self, rows: slice) -> Boxes:
        """Return the boxes of a slice."""
        return Boxes(self.x0[rows], self.y0[rows], self.x1[rows], self.y1[rows])


class Deposits(NamedTuple):
    """The charge of tracks in a frame: flat indices of hit pixels (ascending) and their electrons, (n,) each."""

    pixel: IntArray  # int64
    electrons: IntArray  # int32
    hits: int  # tracks with an electron in the frame


class WorkArrays(NamedTuple):
    """Work space of a batch of tracks: electrons in the box of one track, then pixels and electrons of all tracks."""

    box: IntArray  # int32, zeros before and after a track
    pixel: IntArray  # int64
    electrons: IntArray  # int32


def draw_tracks(shape: tuple[int, int], seconds: float, rays: CosmicRays, rng: np.random.Generator) -> Tracks:
    """Return the Tracks of a frame of `shape` (ny, nx) exposed for `seconds`, including some that miss the frame.

    rays: instrument.cosmic_rays.CosmicRays; rng: numpy Generator.
    """
    margin = rays.long_max + np.ceil(_FARTHEST * rays.diffusion)
    ny, nx = shape
    height = ny + 2 * margin
    width = nx + 2 * margin
    n = rng.poisson(rays.rate * seconds * height * width)
    x = rng.uniform(0, width, n) - margin - 0.5
    y = rng.uniform(0, height, n) - margin - 0.5
    is_long = rng.random(n) < rays.long_share
    fraction = rng.random(n)
    length = np.where(is_long, rays.short_max + (rays.long_max - rays.short_max) * fraction, rays.short_max * fraction)
    angle = rng.uniform(0, 2 * np.pi, n)
    electrons = 10 ** rng.normal(rays.log_energy, rays.log_energy_fwhm / _FWHM, n)
    return Tracks(x, y, length * np.cos(angle), length * np.sin(angle), np.rint(electrons).astype(np.int64))


def deposit(shape: tuple[int, int], tracks: Tracks, diffusion: float, key: np.uint64) -> Deposits:
    """Return the Deposits of Tracks in a frame.

    shape: (ny, nx); diffusion: Gaussian sigma [px]; key: uint64 for the diffusion of every electron.
    """
    track_boxes = boxes(tracks, np.ceil(_FARTHEST * diffusion))
    area = track_boxes.area
    pixels: list[IntArray] = [np.empty(0, np.int64)]
    electrons: list[IntArray] = [np.empty(0, np.int32)]
    hits = 0
    for first in range(0, len(area), _BATCH):
        batch = slice(first, first + _BATCH)
        size = int(area[batch].sum())
        box = np.zeros(int(area[batch].max()), np.int32)
        work = WorkArrays(box, np.empty(size, np.int64), np.empty(size, np.int32))
        used, hit = _deposit(
            shape, tracks.batch(batch), track_boxes.batch(batch), diffusion, key, first, work, normal_table()
        )
        pixels.append(work.pixel[:used].copy())
        electrons.append(work.electrons[:used].copy())
        hits += hit
    pixel, inverse = np.unique(np.concatenate(pixels), return_inverse=True)
    return Deposits(pixel, np.bincount(inverse, np.concatenate(electrons), len(pixel)).astype(np.int32), hits)


def boxes(tracks: Tracks, margin: float) -> Boxes:
    """Return the Boxes around each track's ends, `margin` px wider."""
    x0, x1 = _limits(tracks.x, tracks.x + tracks.dx, margin)
    y0, y1 = _limits(tracks.y, tracks.y + tracks.dy, margin)
    return Boxes(x0, y0, x1, y1)


def _limits(start: FloatArray, end: FloatArray, margin: float) -> tuple[IntArray, IntArray]:
    """Return (low, high), half-open, of the pixels between two ends along an axis, `margin` px wider."""
    low = np.floor(np.minimum(start, end) - margin).astype(np.int64)
    high = np.ceil(np.maximum(start, end) + margin).astype(np.int64) + 1
    return low, high


@numba.njit(cache=True)
def _deposit(
    shape: tuple[int, int],
    tracks: Tracks,
    track_boxes: Boxes,
    diffusion: float,
    key: np.uint64,
    first: int,
    work: WorkArrays,
    table: NormalTable,
) -> tuple[int, int]:
    """Fill `work` with the deposits of each track; return the number of entries and of tracks with any.

    first: the number of the first of these tracks among all.
    """
    ny, nx = shape
    x, y, dx, dy, n = tracks
    x0, y0, x1, y1 = track_boxes
    box, pixel, charge = work
    start, step = table
    used = hits = 0
    for t in range(len(x)):
        if x1[t] <= 0 or y1[t] <= 0 or x0[t] >= nx or y0[t] >= ny:
            continue
        track_key = word(key, np.uint64(first + t))
        width = x1[t] - x0[t]
        tail_key = word(~key, np.uint64(first + t))
        for j in range(n[t]):
            bits = word(track_key, np.uint64(j))
            along = (j + 0.5) / n[t]
            u = (
                x[t]
                + dx[t] * along
                + diffusion * normal(np.uint32(bits), word(tail_key, np.uint64(2 * j)), start, step)
            )
            v = y[t] + dy[t] * along
            v += diffusion * normal(np.uint32(bits >> _S32), word(tail_key, np.uint64(2 * j + 1)), start, step)
            box[(int(np.floor(v + 0.5)) - y0[t]) * width + int(np.floor(u + 0.5)) - x0[t]] += 1
        used_before = used
        for row in range(y0[t], y1[t]):
            for column in range(x0[t], x1[t]):
                index = (row - y0[t]) * width + column - x0[t]
                if box[index] and 0 <= row < ny and 0 <= column < nx:
                    pixel[used], charge[used] = row * nx + column, box[index]
                    used += 1
                box[index] = 0
        hits += used > used_before
    return used, hits
