"""Positions of single electrons drawn from the PSF, a profile or the wing, in compiled loops over a batch.

Used by render.imaging.photons and render.slitless.dispersed_photons. Positions are px, py [pixel] from the object's
centre. Random words come from a key and a counter (csstsim.base.counter); each function returns the advanced counter,
except from_psf, which uses two words an electron.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, TypeAlias

import numba
import numpy as np

from csstsim.base.counter import high, low, unit, word
from csstsim.base.types import FloatArray, IntArray
from csstsim.profiles.log_table import first_of, nodes, read
from csstsim.profiles.sersic_photons import ring, rings_for
from csstsim.render.parts.spots import Spots

if TYPE_CHECKING:
    from csstsim.optics.scatter.halo import Wing
    from csstsim.render.psf_table import PsfTable
    from csstsim.render.scene import Scene

# What compiled loops take of a PsfTable (words, share, bits, cells, per_pixel) and of profiles (rings, Spots.sampled)
Cells: TypeAlias = tuple[IntArray, FloatArray, tuple[int, int], int, int]
Shapes: TypeAlias = tuple[FloatArray, IntArray, FloatArray, FloatArray, FloatArray, IntArray, FloatArray]
_ONE = np.uint64(1)
_TWO = np.uint64(2)
_S10, _S16, _S20, _S32 = (np.uint64(s) for s in (10, 16, 20, 32))
_MASK16 = np.uint64(0xFFFF)
_LOW32 = np.uint64(0xFFFFFFFF)
_TENS = np.uint64(0x3FF << 32 | 0x3FF)  # ten bits of each half of a word
_ANGLES = 1024  # tabulated; linear in between, which enlarges the radius by up to 5e-6
_TURN = np.stack([f(2 * np.pi / _ANGLES * (np.arange(_ANGLES) + 0.5)) for f in (np.cos, np.sin)], axis=1)
_REST = 2 * np.pi / 2.0**32
_POINT = -1  # below it: groups of spots
_NO_SPOTS = Spots().sampled
_RAREST = -10  # the table ends at a share of 2^-10 of the wing's light, 1000 boxes out
_TAIL_FIRST = first_of(_RAREST)


def tail_table(wing: Wing, half: float) -> FloatArray:
    """Return the radii [px] beyond which a share u of the light outside radius `half` lies, on octaves of u up to 1."""
    r = np.geomspace(half, half * 2.0**-_RAREST, 4096)
    share = wing.light_beyond(r).mean(axis=0)
    share /= share[0]
    return np.exp(np.interp(np.log(nodes(_RAREST, 0)), np.log(share[::-1]), np.log(r[::-1])))


def check_scene(scene: Scene, table: PsfTable, maximum: float) -> None:
    """Raise ValueError for a Scene whose photons cannot be drawn: bad values, nodes without tables, too much light."""
    for name in ("x", "y", "electrons", "light", "sersic", "matrix", "weight"):
        values = getattr(scene, name)
        if not np.isfinite(values).all():
            raise ValueError(f"a value of {name} is not finite")
        if name in ("electrons", "light", "weight") and (values < 0).any():
            raise ValueError(f"a value of {name} is negative: photons cannot be drawn")
    if (maximum * scene.electrons.sum(axis=1) >= 2**31).any():
        raise ValueError("an object has 2^31 electrons or more")
    nodes = scene.node[scene.weight > 0]
    lit = table.share.sum(axis=(1, 2)) > 0
    table.verify(nodes)
    if not lit[nodes].all():
        raise ValueError("a PSF node has no tables")


def contiguous(response: FloatArray | None) -> FloatArray:
    """Return a Canvas's response as a contiguous float32 array, of shape (0, 0) if all light is counted."""
    return np.empty((0, 0), np.float32) if response is None else np.ascontiguousarray(response, np.float32)


def profiles_of(scene: Scene) -> tuple[FloatArray, Shapes]:
    """Return (profile (n, 2, 3), tables) of a Scene: what `from_profile` needs of each component, and of all."""
    rings, which, share = rings_for(np.where(scene.light > 0, scene.sersic[:, :, 0], 0.0))
    if scene.spot is not None:
        which[:, 0] = np.where(scene.spot >= 0, _POINT - 1 - scene.spot, which[:, 0])
    spots = _NO_SPOTS if scene.spots is None else scene.spots.sampled
    return np.stack([which, share, scene.sersic[:, :, 2]], axis=-1).astype(np.float64), (rings, *spots)


@numba.njit(inline="always")
def first_word(node: int, f: int, part: int, sides: tuple[int, int]) -> int:
    """Return 2 x (index of the first word of a table) + part, where part 0 is the middle and 1 the rest."""
    inner = 1 << 2 * sides[0]
    outer = 1 << 2 * sides[1]
    return 2 * ((4 * node + f) * (inner + outer) + part * inner) + part


@numba.njit(inline="always")
def cumulative(values: FloatArray, sums: FloatArray) -> FloatArray:
    """Put the running sums of `values` into `sums`, of the same length, and return it."""
    total = 0.0
    for j in range(len(values)):
        total += values[j]
        sums[j] = total
    return sums


@numba.njit(inline="always")
def pick(sums: FloatArray, u: float) -> int:
    """Return the index of the interval of `sums` that u lies in; without branches, which would be mispredicted."""
    passed = 0
    for j in range(len(sums) - 1):
        passed += np.int64(u >= sums[j])  # type: ignore[assignment]  # an int64 is an int to numba
    return passed


@numba.njit(cache=True)
def from_wing(
    count: int, tail: FloatArray, half: float, px: FloatArray, py: FloatArray, key: np.uint64, counter: np.uint64
) -> np.uint64:
    """Set px, py [pixel] to draws from the wing outside the square of half side `half`; return the counter."""
    share = np.empty(1)
    bits = share.view(np.int64)
    for j in range(count):
        px[j] = py[j] = 0.0
        while abs(px[j]) < half and abs(py[j]) < half:
            draw = word(key, counter)
            counter += _ONE
            share[0] = high(draw)
            r = read(tail, _TAIL_FIRST, bits[0])
            angle = 2 * np.pi * low(draw)
            px[j], py[j] = r * np.cos(angle), r * np.sin(angle)
    return counter


@numba.njit(cache=True)
def from_psf(
    count: int, psf: Cells, first: IntArray, px: FloatArray, py: FloatArray, key: np.uint64, counter: np.uint64
) -> None:
    """Set px, py [pixel] to draws from the PSF; two words each, of which the upper half of the first is not used."""
    words, _, sides, cells, per_pixel = psf
    inner, outer = sides
    scale = 1.0 / (1024 * per_pixel)
    # The centre of the table is the centre of the PSF
    corner_inner = 1.5 - 1024 * (1 + 0.5 * (1 << inner))
    corner_outer = 1.5 - 1024 * (1 + 0.5 * cells)
    for j in range(count):
        at = counter + _TWO * np.uint64(j)
        bits = word(key, at)
        jitter = word(key, at + _ONE)
        start = first[j] >> 1
        part = first[j] & 1
        side, corner = (outer, corner_outer) if part else (inner, corner_inner)
        slot = np.int64(bits) & ((1 << 2 * side) - 1)
        entry = np.int64(words[np.uint64(start + slot)])
        cell = slot if np.int64((bits >> _S16) & _MASK16) < (entry >> 16) else entry & 0xFFFF
        # A draw from the quadratic B-spline is the sum of three uniforms: 3 x 10 bits in each half of the word
        spline = (jitter & _TENS) + ((jitter >> _S10) & _TENS) + ((jitter >> _S20) & _TENS)
        column = cell & ((1 << side) - 1)
        row = cell >> side
        px[j] = (np.float64((column << 10) + np.int64(spline & _LOW32)) + corner) * scale
        py[j] = (np.float64((row << 10) + np.int64(spline >> _S32)) + corner) * scale


@numba.njit(cache=True)
def from_profile(
    count: int,
    matrix: FloatArray,
    profile: FloatArray,
    tables: Shapes,
    px: FloatArray,
    py: FloatArray,
    key: np.uint64,
    counter: np.uint64,
) -> np.uint64:
    """Add to px, py draws from a component's profile, a row of `profiles_of`; return the counter."""
    which = np.int64(profile[0])
    share = profile[1]
    radius = profile[2]
    if which == _POINT:
        return counter
    if which < _POINT:
        return _from_spots(count, matrix, _POINT - 1 - which, tables, px, py, key, counter)
    rings = tables[0]
    m00 = matrix[0, 0] * radius
    m01 = matrix[0, 1] * radius
    m10 = matrix[1, 0] * radius
    m11 = matrix[1, 1] * radius
    for j in range(count):
        turn = word(key, counter + np.uint64(j))
        r = ring(rings, which, share, turn)
        angle = np.int64(turn >> _S32)
        a = np.uint64(angle >> 22)
        d = np.float64((angle & 0x3FFFFF) - 0x200000) * _REST
        cos = r * (_TURN[a, 0] - d * _TURN[a, 1])
        sin = r * (_TURN[a, 1] + d * _TURN[a, 0])
        px[j] += m00 * cos + m01 * sin
        py[j] += m10 * cos + m11 * sin
    return counter + np.uint64(count)


@numba.njit(cache=True)
def _from_spots(
    count: int,
    matrix: FloatArray,
    group: int | np.int64,
    tables: Shapes,
    px: FloatArray,
    py: FloatArray,
    key: np.uint64,
    counter: np.uint64,
) -> np.uint64:
    """Add to px, py draws from a group of spots (render.parts.spots), two words each; return the counter."""
    _, start, u, v, keep, other, blur = tables
    first = start[group]
    number = start[group + 1] - start[group]
    side = blur[group]
    for j in range(count):
        at = counter + _TWO * np.uint64(j)
        place = unit(word(key, at)) * number
        k = min(np.int64(place), number - 1)
        if place - k > keep[first + k]:
            k = np.int64(other[first + k])
        a = u[first + k]
        b = v[first + k]
        if side > 0.0:
            jitter = word(key, at + _ONE)
            spline = (jitter & _TENS) + ((jitter >> _S10) & _TENS) + ((jitter >> _S20) & _TENS)
            a += side * ((np.float64(np.int64(spline & _LOW32)) + 1.5) / 1024 - 1.5)
            b += side * ((np.float64(np.int64(spline >> _S32)) + 1.5) / 1024 - 1.5)
        px[j] += matrix[0, 0] * a + matrix[0, 1] * b
        py[j] += matrix[1, 0] * a + matrix[1, 1] * b
    return counter + _TWO * np.uint64(count)
