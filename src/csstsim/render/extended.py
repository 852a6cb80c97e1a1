"""Light far from an extended object: the PSF's wing spread over its profile, and the profile beyond its stamp.

A point's wing is right for a galaxy small beside the PSF's box. About a larger one the wing is that of all its points,
a convolution. The profile beyond the stamp begins where the stamp ends. Both are some per cent of the light and smooth,
so that circles of the same area stand for ellipses, and the nearest of a few sizes to the octave for a size: of STEPS,
or of STEPS_LARGE for the few large galaxies.
"""

from functools import lru_cache
from typing import NamedTuple

import numpy as np
from scipy.fft import fht, fhtoffset
from scipy.special import gammaincc

from csstsim.catalog.table import GALAXY
from csstsim.render.octave_table import nodes
from csstsim.render.profiles.sersic import K2_HIGH, K2_LOW, brightness, tables
from csstsim.render.scene import BULGE, DISK, sersic_b
from csstsim.render.wing_tables import KEPT, RADII, Far, light_of, step

# px of half-light radius, from which light about an object is not a point's: a wing that shows, with its edge in the
# box's ring; smoother light
SHARP_PX, WIDE_PX = 1.0, 8.0
STEPS, STEPS_LARGE, LARGE_PX = 4, 32, 16.0
_LOG_R = np.linspace(-8.0, 18.0, 4096)
_R, _STEP = np.exp(_LOG_R), _LOG_R[1] - _LOG_R[0]
_LOG_K2 = np.log(nodes(K2_LOW, K2_HIGH))
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


def parts_of_table(objects, matrix):
    """Return the Parts of each object of an ObjectTable of drawable ones; matrix: of render.scene.shape_matrix."""
    galaxy, bulge = objects["obj_type"] == GALAXY, objects["bulge_frac"].astype(float)
    sizes = np.stack([objects["size_disk"], objects["size_bulge"]], axis=1).astype(float)
    return [
        parts_of((1 - share, share), ((DISK, 0, size[0]), (BULGE, 0, size[1])), shape) if extended else POINT
        for extended, share, size, shape in zip(galaxy, bulge, sizes, matrix, strict=True)
    ]


def _rounded(value):
    """Return the nearest of so many values to the octave, at least 2^-10."""
    steps = STEPS if value < LARGE_PX else STEPS_LARGE
    return float(2.0 ** (np.round(steps * np.log2(max(value, 2.0**-10))) / steps))


def spread(far, part, least=WIDE_PX):
    """Return the Far of an object of this Part whose points have the Far `far`; `far` itself if it is below `least`."""
    return far if part.size < least else _spread(far, part.index, part.size)


@lru_cache(KEPT)
def _spread(far, index, size):
    """Convolve by Hankel transforms on a logarithmic grid (Hamilton 2000): there, times the profile's, and back."""
    offset = fhtoffset(_STEP, mu=0.0)
    k = np.exp(offset - _LOG_R[::-1])
    transform, _ = tables(index, np.inf)
    of_profile = np.interp(np.log((k * size) ** 2), _LOG_K2, transform, left=1.0, right=0.0)
    flat = np.array([np.interp(_R, RADII, profile, right=0.0) for profile in far.profile])
    there = fht(_R * flat, _STEP, mu=0.0, offset=offset) * of_profile
    wide = np.maximum(fht(there, _STEP, mu=0.0, offset=offset) / _R, 0.0)
    wide = np.array([np.interp(RADII, _R, profile) for profile in wide])
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
    edge = float(2.0 ** (np.round(STEPS * np.log2(reach)) / STEPS))
    return [(light / sum(left), _tail(part.index, part.size, edge)) for light, part in zip(left, parts, strict=True)]


@lru_cache(KEPT)
def _tail(index, size, reach):
    """Return the Far of a profile beyond a square of half side `reach`, faded in over about its corners."""
    profile = brightness(RADII / size, index) * (1 - step(RADII, reach, 2 * _SQUARE * reach - reach))
    light = float(light_of(profile[None])[0])
    return Far(np.tile(profile / light if light > 0 else profile, (4, 1)), np.ones(4))
