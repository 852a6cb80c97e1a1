"""Light far from an extended object: the PSF's wing spread over its profile, and the profile beyond its stamp.

A point's wing is right for a galaxy small beside the PSF's box. About a larger one the wing is that of all its points:
the wing about a circle of each of RINGS radii that hold equal parts of its light. The profile beyond the stamp begins
where the stamp ends. Both are some per cent of the light and smooth, so that circles of the same area stand for
ellipses, and the next of STEPS sizes to the octave for a size.
"""

from functools import lru_cache
from typing import NamedTuple

import numpy as np
from scipy.interpolate import PchipInterpolator
from scipy.special import gammaincc, gammaincinv

from csstsim.render.profiles.sersic import brightness
from csstsim.render.scene import sersic_b
from csstsim.render.wing_tables import KEPT, RADII, Far, light_of, step

WIDE_PX = 8.0  # half-light radius: below it a wing is a point's
STEPS = 4
RINGS, ANGLES = 48, 32
_NODES = RADII[::16]
_SQUARE = 2 / np.sqrt(np.pi)  # radius of the circle of a square's area, over half its side
_LEAST = 1e-4  # of the light: less beyond a stamp is not worth a table


class Part(NamedTuple):
    """A circular Sersic component: its share of the light, its index (0: a point) and half-light radius [px]."""

    share: float
    index: float
    size: float


POINT = (Part(1.0, 0.0, 0.0),)


def parts_of(light, sersic, matrix):
    """Return the Parts of an object of a render.scene.Scene: light (2,), sersic (2, 3), matrix (2, 2) px / arcsec."""
    scale = np.sqrt(abs(matrix[0, 0] * matrix[1, 1] - matrix[0, 1] * matrix[1, 0]))
    parts = [
        Part(float(share), float(index), _rounded(size * scale))
        for share, (index, _, size) in zip(light, sersic, strict=True)
        if share > 0 and index > 0
    ]
    return tuple(parts) or POINT


def _rounded(value):
    """Return the nearest of STEPS values to the octave, at least 2^-10."""
    return float(2.0 ** (np.round(STEPS * np.log2(max(value, 2.0**-10))) / STEPS))


def spread(far, part):
    """Return the Far of an object of this Part whose points have the Far `far`; `far` itself if it is small."""
    return far if part.size < WIDE_PX else _spread(far, part.index, part.size)


@lru_cache(KEPT)
def _spread(far, index, size):
    rings = size * (gammaincinv(2 * index, (np.arange(RINGS) + 0.5) / RINGS) / sersic_b(index)) ** index
    cosine = np.cos(np.pi * (np.arange(ANGLES) + 0.5) / ANGLES)
    means = np.zeros((4, len(_NODES)))
    for ring in rings:
        away = np.sqrt(np.maximum(ring**2 + _NODES[:, None] ** 2 - 2 * ring * np.outer(_NODES, cosine), 0.0))
        for band, profile in zip(means, far.profile, strict=True):
            band += np.interp(away, RADII, profile).mean(axis=1) / RINGS
    wide = PchipInterpolator(np.log(_NODES), means, axis=1)(np.log(RADII))
    return Far(wide * (light_of(far.profile) / light_of(wide))[:, None], far.light)


def beyond_stamp(parts, reach):
    """Return [(share of what lies beyond, Far of light 1), ...] of the Parts about a stamp of half side `reach` [px].

    [] where so little does that it is not worth drawing.
    """
    radius = _SQUARE * reach
    left = [
        part.share * float(gammaincc(2 * part.index, sersic_b(part.index) * (radius / part.size) ** (1 / part.index)))
        for part in parts if part.index > 0
    ]  # fmt: skip
    if sum(left) < _LEAST:
        return []
    edge = _rounded(reach)
    return [(light / sum(left), _tail(part.index, part.size, edge)) for light, part in zip(left, parts, strict=True)]


@lru_cache(KEPT)
def _tail(index, size, reach):
    """Return the Far of a profile beyond a square of half side `reach`, faded in over about its corners."""
    profile = brightness(RADII / size, index) * (1 - step(RADII, reach, 2 * _SQUARE * reach - reach))
    light = float(light_of(profile[None])[0])
    return Far(np.tile(profile / light if light > 0 else profile, (4, 1)), np.ones(4))
