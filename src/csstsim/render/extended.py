"""Light far from an extended object: the PSF's wing spread over its profile, and the profile beyond its stamp.

The wing of a point is accurate for a galaxy much smaller than the PSF's box. The wing of a larger galaxy is the
convolution of that wing with its profile. The profile beyond the stamp begins where the stamp ends. Both hold a few per
cent of the light and are smooth, so tables are radial (ellipses are averaged over direction) and sizes are rounded to a
few values per octave. Galaxies above LARGE_PX are few, so their sizes are rounded less and their axis ratios are used.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from scipy.fft import fht, fhtoffset

from csstsim.base.types import FloatArray
from csstsim.catalog.profiles.log_table import nodes
from csstsim.catalog.profiles.sersic import DISK, K2_HIGH, K2_LOW, brightness, tables
from csstsim.render.wing_tables import CACHED, RADII, RadialProfile, light_of, step

if TYPE_CHECKING:
    from csstsim.render.scene import Scene

# px, half-light radius from which the object's size counts: in a wing that shows, whose inner edge lies in the box's
# ring; in smoother light
SHARP_PX = 1.0
WIDE_PX = 8.0
STEPS = 4
STEPS_LARGE = 32
LARGE_PX = 16.0
DIRECTIONS = 64
THINNEST = 2.0**-6
_LOG_R = np.linspace(-8.0, 18.0, 4096)
_R = np.exp(_LOG_R)
_STEP = _LOG_R[1] - _LOG_R[0]
_LOG_K2 = np.log(nodes(K2_LOW, K2_HIGH))
_SQUARE = 2 / np.sqrt(np.pi)  # radius of the circle of a square's area, over half its side
_MINIMUM = 1e-4  # of the flux: less than this beyond a stamp is not rendered


class Part(NamedTuple):
    """A Sersic component of an object.

    * fraction: of the object's flux
    * sersic_index: 0: a point
    * size: half-light radius [px] of a circle with the area of the ellipse
    * ratio: of the ellipse's axes, short over long
    """

    fraction: float
    sersic_index: float
    size: float
    ratio: float = 1.0


POINT = (Part(1.0, 0.0, 0.0),)


def parts_of(light: FloatArray, sersic: FloatArray, matrix: FloatArray) -> tuple[Part, ...]:
    """Return the Parts of an object of a render.scene.Scene: light (2,), sersic (2, 3), matrix (2, 2) px / arcsec."""
    area = abs(matrix[0, 0] * matrix[1, 1] - matrix[0, 1] * matrix[1, 0])
    square = (matrix**2).sum()  # of the axes, a^2 + b^2, and a b is the area
    ratio = area / (0.5 * (square + np.sqrt(max(square**2 - 4 * area**2, 0.0))))
    parts = [
        Part(float(fraction), float(index), *_rounded(size * np.sqrt(area), ratio))
        for fraction, (index, _, size) in zip(light, sersic, strict=True)
        if fraction > 0 and index > 0
    ]
    return tuple(parts) or POINT


def parts_at(scene: Scene, i: int) -> tuple[Part, ...]:
    """Return the Parts of object i of a Scene; knots and images count as a disk of their half-light radius."""
    sersic = scene.sersic[i]
    if scene.spot is not None and scene.spot[i] >= 0:
        sersic = np.array([[DISK, 0.0, sersic[0, 2]], [0.0, 0.0, 0.0]])
    return parts_of(scene.component_fractions[i], sersic, scene.matrix[i])


def _rounded(size: float, ratio: float) -> tuple[float, float]:
    """Return a size [px], at least 2^-10, and an axis ratio, rounded to the values that tables are made for.

    An ellipse thinner than THINNEST keeps its long axis.
    """
    thin = ratio < THINNEST
    size = size * np.sqrt(THINNEST / min(max(ratio, 1e-12), THINNEST))
    if size < LARGE_PX and not thin:
        return _nearest(max(size, 2.0**-10), STEPS), 1.0
    return _nearest(size, STEPS_LARGE), max(_nearest(ratio, STEPS), THINNEST)


def _nearest(value: float, steps: int) -> float:
    """Return the nearest of the values that are spaced by `steps` to the octave."""
    return float(2.0 ** (np.round(steps * np.log2(value)) / steps))


def _stretch(ratio: float) -> FloatArray:
    """Return the squared extent of an ellipse in evenly spaced directions, relative to the circle of the same area."""
    angle = np.pi * (np.arange(DIRECTIONS if ratio != 1 else 1) + 0.5) / DIRECTIONS
    return np.cos(angle) ** 2 / ratio + np.sin(angle) ** 2 * ratio


def spread(radial: RadialProfile, part: Part, minimum: float = WIDE_PX) -> RadialProfile:
    """Return the RadialProfile of a point convolved with a Part; itself if the part is smaller than `minimum` px."""
    return radial if part.size < minimum else _spread(radial, part.sersic_index, part.size, part.ratio)


@lru_cache(CACHED)
def _spread(radial: RadialProfile, index: float, size: float, ratio: float) -> RadialProfile:
    """Convolve by Hankel transforms on a logarithmic grid (Hamilton 2000): transform, multiply, transform back."""
    offset = fhtoffset(_STEP, mu=0.0)
    k = np.exp(offset - _LOG_R[::-1])
    transform, _ = tables(index, np.inf)
    log_k2 = np.log((k * size) ** 2 * _stretch(ratio)[:, None])
    of_profile = np.interp(log_k2, _LOG_K2, transform, left=1.0, right=0.0).mean(axis=0)
    flat = np.array([np.interp(_R, RADII, profile, right=0.0) for profile in radial.profile])
    convolved = fht(_R * flat, _STEP, mu=0.0, offset=offset) * of_profile
    wide = np.maximum(fht(convolved, _STEP, mu=0.0, offset=offset) / _R, 0.0)
    wide = np.array([np.interp(RADII, _R, profile) for profile in wide])
    return RadialProfile(wide * (light_of(radial.profile) / light_of(wide))[:, None], radial.light)


class Tail(NamedTuple):
    """A Part beyond a stamp: its fraction of a flux, and its profile of flux 1."""

    fraction: float
    profile: RadialProfile


def beyond_stamp(parts: Sequence[Part], reach: float) -> list[Tail]:
    """Return the Tails of Parts beyond a stamp of half side `reach` [px], as fractions of the flux beyond the stamp.

    Returns [] if less than _MINIMUM of the object's flux lies beyond the stamp.
    """
    rounded = _nearest(reach, STEPS)
    extended = [part for part in parts if part.sersic_index > 0]
    tails = [_tail(part.sersic_index, part.size, part.ratio, rounded) for part in extended]
    beyond = [part.fraction * tail.fraction for part, tail in zip(extended, tails, strict=True)]
    if sum(beyond) < _MINIMUM:
        return []
    return [Tail(flux / sum(beyond), tail.profile) for flux, tail in zip(beyond, tails, strict=True)]


@lru_cache(CACHED)
def _tail(index: float, size: float, ratio: float, reach: float) -> Tail:
    """Return the Tail of a Part of flux 1 beyond a square of half side `reach` [px], faded in around its corners."""
    axis = size / np.sqrt(_stretch(1 / ratio))  # radius of a contour; _stretch is that of the transform
    profile = brightness(RADII / axis[:, None], index).mean(axis=0) / size**2
    profile *= 1 - step(RADII, reach, 2 * _SQUARE * reach - reach)
    flux = float(light_of(profile[None])[0])
    return Tail(flux, RadialProfile(np.broadcast_to(profile / max(flux, 1e-300), (4, len(RADII))), np.ones(4)))
