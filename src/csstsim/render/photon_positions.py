"""Positions of single electrons drawn from the PSF, a profile or the wing, in compiled loops over a batch.

Used by render.imaging.photons and render.slitless.dispersed_photons. Positions are px, py [pixel] from the object's
centre. Random words come from a key and a counter (csstsim.base.counter); each function returns the advanced counter,
except from_psf, which uses two words an electron.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numba
import numpy as np

from csstsim.base.counter import high, low, unit, word
from csstsim.base.types import BoolArray, FloatArray, IntArray
from csstsim.catalog.profiles.log_table import first_of, nodes, read
from csstsim.catalog.profiles.sersic_photons import ring, rings_for
from csstsim.render.parts.spots import SampledSpots, Spots

if TYPE_CHECKING:
    from csstsim.optics.scatter.halo import Wing
    from csstsim.render.method import Targets
    from csstsim.render.psf_table import PsfTable
    from csstsim.render.scene import Scene

COUNTED_MAX = 1e8  # electrons of an object, about a second; well within the integers of the counted plane
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
_RAREST = -10  # the table ends at a fraction of 2^-10 of the wing's flux, 1000 boxes out
_TAIL_FIRST = first_of(_RAREST)


class CountedImage(NamedTuple):
    """A plane of counted electrons (ny, nx) int32, the response (ny, nx) float32 or (0, 0): 1, and its maximum."""

    counted: IntArray
    response: FloatArray
    maximum: float


class PsfSampler(NamedTuple):
    """What electrons are drawn from at the PSF's nodes: the arrays of a PsfTable (render.psf_table), and the wing.

    * words: uint32 alias tables of all nodes and sub-bands, flat
    * fraction: (nodes, 4, 2) of the flux, in the middle of the box and in its rest
    * inner_bits, outer_bits: base-2 logarithms of the sides of the tables of the middle and of the rest
    * cells: to a side of the box
    * per_pixel: cells to a pixel, along a side
    * tail: from `tail_table`, for the electrons beyond the box; empty: they are dropped
    """

    words: IntArray
    fraction: FloatArray
    inner_bits: int
    outer_bits: int
    cells: int
    per_pixel: int
    tail: FloatArray


class ProfileTables(NamedTuple):
    """What electrons of profiles are drawn from: rings of Sersic profiles (profiles.sersic_photons), and spots."""

    rings: FloatArray
    spots: SampledSpots


class SceneProfiles(NamedTuple):
    """The profiles of a Scene's components: arrays (n, 2) and the tables of all.

    * kind: number of a profile's rings; -1: a point; -2 - k: the k-th group of spots
    * fraction: of the next rings, between which and those of `kind` the profile's rings are interpolated
    * radius: half-light radius [arcsec]
    """

    kind: IntArray
    fraction: FloatArray
    radius: FloatArray
    tables: ProfileTables


class Profile(NamedTuple):
    """One component's entries of a SceneProfiles, and the matrix (2, 2) [px / arcsec] of its object."""

    matrix: FloatArray
    kind: int
    fraction: float
    radius: float
    tables: ProfileTables


def tail_table(wing: Wing, half: float) -> FloatArray:
    """Return the radii [px] beyond which a fraction u of the flux outside radius `half` lies, on octaves of u to 1."""
    r = np.geomspace(half, half * 2.0**-_RAREST, 4096)
    fraction = wing.light_beyond(r).mean(axis=0)
    fraction /= fraction[0]
    return np.exp(np.interp(np.log(nodes(_RAREST, 0)), np.log(fraction[::-1]), np.log(r[::-1])))


def sampler_of(table: PsfTable, wing: Wing | None) -> PsfSampler:
    """Return the PsfSampler of a PsfTable and a Wing, or None: electrons beyond the PSF's box are dropped."""
    inner_bits, outer_bits = table.bits
    tail = np.empty(0) if wing is None else tail_table(wing, table.cells / table.per_pixel / 2)
    words = table.words.reshape(-1)
    return PsfSampler(words, table.share, inner_bits, outer_bits, table.cells, table.per_pixel, tail)


def may_be_counted(targets: Targets) -> BoolArray:
    """Return (n,) bool: objects that may be drawn electron by electron.

    They have at most COUNTED_MAX electrons, the PSF's mixture is convex, and the image is not without noise.
    """
    drawing = targets.drawing
    few = targets.electrons * targets.maximum < COUNTED_MAX
    return few & drawing.psf.convex & (drawing.fidelity != "noise_free")


def check_scene(scene: Scene, table: PsfTable, maximum: float) -> None:
    """Raise ValueError for a Scene whose photons cannot be drawn: bad values, nodes without tables, too much light."""
    for name in ("x", "y", "electrons", "component_fractions", "sersic", "matrix", "weight"):
        values = getattr(scene, name)
        if not np.isfinite(values).all():
            raise ValueError(f"a value of {name} is not finite")
        if name in ("electrons", "component_fractions", "weight") and (values < 0).any():
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


def profiles_of(scene: Scene) -> SceneProfiles:
    """Return the SceneProfiles of a Scene."""
    rings, kind, fraction = rings_for(np.where(scene.component_fractions > 0, scene.sersic[:, :, 0], 0.0))
    if scene.spot is not None:
        kind[:, 0] = np.where(scene.spot >= 0, _POINT - 1 - scene.spot, kind[:, 0])
    spots = _NO_SPOTS if scene.spots is None else scene.spots.sampled
    radius = np.ascontiguousarray(scene.sersic[:, :, 2], np.float64)
    return SceneProfiles(kind, fraction, radius, ProfileTables(rings, spots))


@numba.njit(inline="always")
def first_word(psf: PsfSampler, node: int, f: int, part: int) -> int:
    """Return 2 x (index of the first word of a table) + part, where part 0 is the middle and 1 the rest."""
    inner = 1 << 2 * psf.inner_bits
    outer = 1 << 2 * psf.outer_bits
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
    count: int, psf: PsfSampler, px: FloatArray, py: FloatArray, key: np.uint64, counter: np.uint64
) -> np.uint64:
    """Set px, py [pixel] to draws from the wing outside the PSF's box; return the counter."""
    half = 0.5 * psf.cells / psf.per_pixel
    beyond = np.empty(1)  # fraction of the wing's flux
    bits = beyond.view(np.int64)
    for j in range(count):
        px[j] = py[j] = 0.0
        while abs(px[j]) < half and abs(py[j]) < half:
            draw = word(key, counter)
            counter += _ONE
            beyond[0] = high(draw)
            r = read(psf.tail, _TAIL_FIRST, bits[0])
            angle = 2 * np.pi * low(draw)
            px[j], py[j] = r * np.cos(angle), r * np.sin(angle)
    return counter


@numba.njit(cache=True)
def from_psf(
    count: int, psf: PsfSampler, first: IntArray, px: FloatArray, py: FloatArray, key: np.uint64, counter: np.uint64
) -> None:
    """Set px, py [pixel] to draws from the PSF's tables `first` (`first_word`).

    An electron uses two words, of which the upper half of the first is not used.
    """
    words = psf.words
    inner = psf.inner_bits
    outer = psf.outer_bits
    scale = 1.0 / (1024 * psf.per_pixel)
    # The centre of the table is the centre of the PSF
    corner_inner = 1.5 - 1024 * (1 + 0.5 * (1 << inner))
    corner_outer = 1.5 - 1024 * (1 + 0.5 * psf.cells)
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
    count: int, profile: Profile, px: FloatArray, py: FloatArray, key: np.uint64, counter: np.uint64
) -> np.uint64:
    """Add to px, py draws from a component's profile; return the counter."""
    if profile.kind == _POINT:
        return counter
    if profile.kind < _POINT:
        return _from_spots(count, profile, px, py, key, counter)
    rings = profile.tables.rings
    m00 = profile.matrix[0, 0] * profile.radius
    m01 = profile.matrix[0, 1] * profile.radius
    m10 = profile.matrix[1, 0] * profile.radius
    m11 = profile.matrix[1, 1] * profile.radius
    for j in range(count):
        turn = word(key, counter + np.uint64(j))
        r = ring(rings, profile.kind, profile.fraction, turn)
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
    count: int, profile: Profile, px: FloatArray, py: FloatArray, key: np.uint64, counter: np.uint64
) -> np.uint64:
    """Add to px, py draws from a group of spots (render.parts.spots), two words each; return the counter."""
    spots = profile.tables.spots
    matrix = profile.matrix
    group = _POINT - 1 - profile.kind
    first = spots.start[group]
    number = spots.start[group + 1] - spots.start[group]
    side = spots.blur[group]
    for j in range(count):
        at = counter + _TWO * np.uint64(j)
        column = unit(word(key, at)) * number  # of the alias table
        k = min(np.int64(column), number - 1)
        if column - k > spots.keep[first + k]:
            k = np.int64(spots.other[first + k])
        a = spots.u[first + k]
        b = spots.v[first + k]
        if side > 0.0:
            jitter = word(key, at + _ONE)
            spline = (jitter & _TENS) + ((jitter >> _S10) & _TENS) + ((jitter >> _S20) & _TENS)
            a += side * ((np.float64(np.int64(spline & _LOW32)) + 1.5) / 1024 - 1.5)
            b += side * ((np.float64(np.int64(spline >> _S32)) + 1.5) / 1024 - 1.5)
        px[j] += matrix[0, 0] * a + matrix[0, 1] * b
        py[j] += matrix[1, 0] * a + matrix[1, 1] * b
    return counter + _TWO * np.uint64(count)
