"""Radial profiles of light far from an object, as tables in r^2 (profiles.log_table), cut into annuli."""

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from csstsim.base.types import FloatArray
from csstsim.catalog.profiles.log_table import BITS, first_of, nodes

CACHED = 256  # tables, some 100 kB each
_OCTAVES = 32  # of r^2 [px^2] in a table: up to 65,536 px, more than from any object to any corner of a chip
RADII = np.sqrt(nodes(0, _OCTAVES))


@dataclass(frozen=True, eq=False)
class RadialProfile:
    """Surface brightness per pixel at RADII, by sub-band, for an object of flux 1 in each."""

    profile: FloatArray  # (4, nodes)
    light: FloatArray  # (4,) its integral over the plane


class Annulus(NamedTuple):
    """A part of a radial profile, as a table of profiles.log_table.

    * table: on octaves of r^2 [px^2], by sub-band (4, n) or of their sum (n,)
    * first: number of its first node
    * reach: radius beyond which it is 0 [px]; 0: it is empty
    """

    table: FloatArray
    first: int
    reach: float


def step(r: FloatArray, inner: float, outer: float) -> FloatArray:
    """Return 1 within radius `inner`, 0 beyond `outer`, and a quintic in between."""
    t = np.clip((r - inner) / (outer - inner), 0.0, 1.0)
    return 1 - t**3 * (10 - 15 * t + 6 * t * t)


def light_of(profile: FloatArray) -> FloatArray:
    """Return the integrals over the plane of profiles (k, nodes), taken as constant within the first node."""
    return np.trapezoid(2 * np.pi * RADII * profile, RADII, axis=1) + np.pi * profile[:, 0] * RADII[0] ** 2


@lru_cache(CACHED)
def annuli(radial: RadialProfile, radii: tuple[float, ...]) -> list[Annulus]:
    """Return the annuli of a RadialProfile, with tables (4, n): one more than `radii` [px].

    radii: edges of the annuli; from each edge to twice that edge one annulus fades into the next. An annulus that ends
    at edge 0, or at an edge out of order, is empty.
    """
    out: list[Annulus] = []
    before: FloatArray = np.zeros(len(RADII))
    for edge in (*radii, math.inf):
        until = np.ones(len(RADII)) if edge == math.inf else step(RADII, edge, 2 * edge) if edge else before
        until = np.maximum(before, until)
        lit = np.flatnonzero(until > before)
        if not lit.size:
            out.append(Annulus(np.zeros((4, 2)), 0, 0.0))
            continue
        low = lit[0] >> BITS
        high = -(-(lit[-1] + 1) >> BITS)
        part = slice(low << BITS, (high << BITS) + 1)
        table = np.ascontiguousarray((radial.profile * (until - before))[:, part])
        out.append(Annulus(table, first_of(int(low)), float(RADII[min(lit[-1] + 1, len(RADII) - 1)])))
        before = until
    return out
