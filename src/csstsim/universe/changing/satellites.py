"""Satellites that cross the field during an exposure: how many, where, how fast, how wide and how bright.

Tracks cross a circle about the boresight at a rate that is proportional to its diameter and to the exposure time; their
directions, distances from the centre and times are uniform. They depend on the campaign's seed and on when and where
the telescope looks, so all chips of an exposure see the same ones. Left out: their orbits, the Earth's shadow, flashes.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np

from csstsim.base.rng import stream
from csstsim.base.sphere import frames, normalised, ra_dec
from csstsim.base.types import AnyArray
from csstsim.base.units import ARCSEC_PER_RAD

_MOST = 1000  # tracks in an exposure


def crossing(
    seed: int,
    start: float,
    exptime: float,
    boresight: tuple[float, float],
    radius: float,
    diameter: float,
    numbers: Mapping[str, Any],
) -> dict[str, AnyArray]:
    """Return {name: (n,)} of the satellites that cross a circle of `radius` [rad] about `boresight` (ra, dec) [deg].

    start: MJD; exptime: s; diameter: of the mirror [m]. id, ra, dec [deg], where it is nearest to the boresight, time
    [s after the start], angle [deg, north through east], speed [arcsec / s], width [arcsec], V [mag], distance [km].
    """
    rate = numbers["rate"]
    orbits = numbers["orbits"]
    key = f"{start:.8f} {boresight[0]:.8f} {boresight[1]:.8f}"
    rng = stream(seed, "satellites", key)
    per_width = -np.log1p(-rate["crossed"]) / (rate["exptime"] * rate["width"])  # 1 / s / arcsec
    mean = numbers["growth"] * per_width * 2 * radius * ARCSEC_PER_RAD * exptime
    count = min(int(rng.poisson(mean)), _MOST)
    angle, off, when, where, speed, bright = rng.random((6, count))
    angle = 2 * np.pi * angle
    off = (2 * off - 1) * radius
    near, far = orbits["distance"]
    distance = near * (far / near) ** where
    slowest, fastest = orbits["speed"]
    speed = (slowest + (fastest - slowest) * speed) / distance * ARCSEC_PER_RAD
    from scipy.special import ndtri

    middle, scatter = orbits["magnitude"]
    centre, east, north = frames(*np.radians(boresight))
    across = np.cos(angle)[:, None] * east - np.sin(angle)[:, None] * north
    place = normalised(np.cos(off)[:, None] * centre + np.sin(off)[:, None] * across)
    ra, dec = ra_dec(place)
    _, east, north = frames(np.radians(ra), np.radians(dec))
    along = np.cross(place, across * np.cos(off)[:, None] - centre * np.sin(off)[:, None])
    direction = np.degrees(np.arctan2(np.einsum("ni,ni->n", along, east), np.einsum("ni,ni->n", along, north)))
    return {
        "id": np.arange(count, dtype=np.int64) + (int(rng.integers(1 << 32)) << 12),
        "ra": ra,
        "dec": dec,
        "time": when * exptime,
        "angle": direction % 360.0,
        "speed": speed,
        "width": (diameter + orbits["size"]) / (1000.0 * distance) * ARCSEC_PER_RAD,
        "V": middle + scatter * ndtri(bright) + 5 * np.log10(distance / 1000.0),
        "distance": distance,
    }
