"""Cosmic rays (paper, section 5.5.6): straight tracks in the plane of the chip, in whole electrons.

A track starts anywhere, also outside the frame, in a random direction, and deposits its electrons at equal steps; each
electron then diffuses by a Gaussian. Length and charge are independent (paper). The electrons of a pixel are counts, so
no shot noise may be added. Electrons are lost only beyond the edges. Left out: straggling along the track, delta rays,
and the earlier readout of rows near the amplifiers.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numba
import numpy as np

from csstsim.base.counter import word
from csstsim.base.types import FloatArray, IntArray
from csstsim.detector.random.normal import normal, normal_table

if TYPE_CHECKING:
    from csstsim.instrument.cosmic_rays import CosmicRays

_BATCH = 256  # tracks at a time; limits the work space
_FARTHEST = 9  # sigma; larger than any normal number made from 52 bits
_FWHM = np.sqrt(8 * np.log(2))  # of a Gaussian, in sigma
_S32 = np.uint64(32)


@dataclass(frozen=True)
class Tracks:
    """Arrays with a value per track: start x, y, extent dx, dy [px of the frame, pixel centres at integers], e-."""

    x: FloatArray
    y: FloatArray
    dx: FloatArray
    dy: FloatArray
    electrons: IntArray


def draw_tracks(shape: tuple[int, int], seconds: float, rays: CosmicRays, rng: np.random.Generator) -> Tracks:
    """Return the Tracks of a frame of `shape` (ny, nx) exposed for `seconds`, including some that miss the frame.

    rays: instrument.cosmic_rays.CosmicRays; rng: numpy Generator.
    """
    margin = rays.long_max + np.ceil(_FARTHEST * rays.diffusion)
    height, width = (n + 2 * margin for n in shape)
    n = rng.poisson(rays.rate * seconds * height * width)
    x = rng.uniform(0, width, n) - margin - 0.5
    y = rng.uniform(0, height, n) - margin - 0.5
    long = rng.random(n) < rays.long_share
    length = rng.random(n)
    length = np.where(long, rays.short_max + (rays.long_max - rays.short_max) * length, rays.short_max * length)
    angle = rng.uniform(0, 2 * np.pi, n)
    electrons = 10 ** rng.normal(rays.log_energy, rays.log_energy_fwhm / _FWHM, n)
    return Tracks(x, y, length * np.cos(angle), length * np.sin(angle), np.rint(electrons).astype(np.int64))


def deposit(shape: tuple[int, int], tracks: Tracks, diffusion: float, key: np.uint64) -> tuple[IntArray, IntArray, int]:
    """Return (pixel, electrons, hits): flat indices of hit pixels (ascending), their electrons, number of tracks.

    shape: (ny, nx); diffusion: Gaussian sigma [px]; key: uint64 for the diffusion of every electron. hits: number of
    tracks that put an electron into the frame.
    """
    margin = np.ceil(_FARTHEST * diffusion)
    x0, y0, x1, y1 = boxes(tracks, margin)
    area = (x1 - x0) * (y1 - y0)
    pixels = [np.empty(0, np.int64)]
    electrons = [np.empty(0, np.int32)]
    hits = 0
    for first in range(0, len(area), _BATCH):
        part = slice(first, first + _BATCH)
        room = int(area[part].sum())
        pixel = np.empty(room, np.int64)
        charge = np.empty(room, np.int32)
        work = np.zeros(int(area[part].max()), np.int32)
        used, struck = _deposit(
            shape, tracks.x[part], tracks.y[part], tracks.dx[part], tracks.dy[part], tracks.electrons[part],
            x0[part], y0[part], x1[part], y1[part], diffusion, key, first, work, pixel, charge, *normal_table(),
        )  # fmt: skip
        pixels.append(pixel[:used].copy())
        electrons.append(charge[:used].copy())
        hits += struck
    pixel, inverse = np.unique(np.concatenate(pixels), return_inverse=True)
    return pixel, np.bincount(inverse, np.concatenate(electrons), len(pixel)).astype(np.int32), hits


def boxes(tracks: Tracks, margin: float) -> tuple[IntArray, IntArray, IntArray, IntArray]:
    """Return x0, y0, x1, y1 (int64, half-open) around each track's ends, `margin` px wider."""
    ends = [np.stack([a, a + d]) for a, d in ((tracks.x, tracks.dx), (tracks.y, tracks.dy))]
    low = (np.floor(end.min(axis=0) - margin).astype(np.int64) for end in ends)
    high = (np.ceil(end.max(axis=0) + margin).astype(np.int64) + 1 for end in ends)
    return *low, *high


@numba.njit(cache=True)
def _deposit(
    shape: tuple[int, int],
    x: FloatArray,
    y: FloatArray,
    dx: FloatArray,
    dy: FloatArray,
    n: IntArray,
    x0: IntArray,
    y0: IntArray,
    x1: IntArray,
    y1: IntArray,
    diffusion: float,
    key: np.uint64,
    first: int,
    work: IntArray,
    pixel: IntArray,
    charge: IntArray,
    start: FloatArray,
    step: FloatArray,
) -> tuple[int, int]:
    """Fill pixel and charge with the deposits of each track; return the number of entries and of tracks with any."""
    ny, nx = shape
    used = struck = 0
    for t in range(len(x)):
        if x1[t] <= 0 or y1[t] <= 0 or x0[t] >= nx or y0[t] >= ny:
            continue
        own = word(key, np.uint64(first + t))
        width = x1[t] - x0[t]
        tail = word(~key, np.uint64(first + t))
        for j in range(n[t]):
            bits = word(own, np.uint64(j))
            along = (j + 0.5) / n[t]
            u = x[t] + dx[t] * along + diffusion * normal(np.uint32(bits), word(tail, np.uint64(2 * j)), start, step)
            v = y[t] + dy[t] * along
            v += diffusion * normal(np.uint32(bits >> _S32), word(tail, np.uint64(2 * j + 1)), start, step)
            work[(int(np.floor(v + 0.5)) - y0[t]) * width + int(np.floor(u + 0.5)) - x0[t]] += 1
        before = used
        for row in range(y0[t], y1[t]):
            for column in range(x0[t], x1[t]):
                at = (row - y0[t]) * width + column - x0[t]
                if work[at] and 0 <= row < ny and 0 <= column < nx:
                    pixel[used], charge[used] = row * nx + column, work[at]
                    used += 1
                work[at] = 0
        struck += used > before
    return used, struck
