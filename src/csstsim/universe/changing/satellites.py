"""Satellites that cross the field during an exposure: how many, where, how fast, how wide and how bright.

Tracks cross a circle about the boresight at a rate that is proportional to its diameter and to the exposure time. Their
directions, distances from the centre and times are uniform. They depend on the campaign's seed, the boresight and the
start of the exposure, so all chips of an exposure see the same ones. Left out: orbits, the Earth's shadow, flashes.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np

from csstsim.base.rng import stream
from csstsim.base.sphere import frames, normalised, ra_dec
from csstsim.base.types import AnyArray
from csstsim.base.units import ARCSEC_PER_RAD

_TRACKS_MAX = 1000  # tracks in an exposure


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

    start: MJD; exptime [s]; diameter: of the mirror [m]. Names: id; ra, dec [deg], the point of the track nearest to
    the boresight; time of that point [s after the start]; angle [deg, north through east]; speed [arcsec / s]; width
    [arcsec]; V [mag]; distance [km].
    """
    rate = numbers["rate"]
    orbits = numbers["orbits"]
    key = f"{start:.8f} {boresight[0]:.8f} {boresight[1]:.8f}"
    rng = stream(seed, "satellites", key)
    per_width = -np.log1p(-rate["crossed"]) / (rate["exptime"] * rate["width"])  # 1 / s / arcsec
    mean = numbers["growth"] * per_width * 2 * radius * ARCSEC_PER_RAD * exptime
    count = min(int(rng.poisson(mean)), _TRACKS_MAX)
    angle, impact, time_fraction, distance_quantile, speed, magnitude_quantile = rng.random((6, count))
    angle = 2 * np.pi * angle
    impact = (2 * impact - 1) * radius
    nearest, furthest = orbits["distance"]
    distance = nearest * (furthest / nearest) ** distance_quantile
    slowest, fastest = orbits["speed"]
    speed = (slowest + (fastest - slowest) * speed) / distance * ARCSEC_PER_RAD
    from scipy.special import ndtri

    middle, scatter = orbits["magnitude"]
    centre, east, north = frames(*np.radians(boresight))
    across = np.cos(angle)[:, None] * east - np.sin(angle)[:, None] * north
    position = normalised(np.cos(impact)[:, None] * centre + np.sin(impact)[:, None] * across)
    ra, dec = ra_dec(position)
    _, east, north = frames(np.radians(ra), np.radians(dec))
    heading = np.cross(position, across * np.cos(impact)[:, None] - centre * np.sin(impact)[:, None])
    direction = np.degrees(np.arctan2(np.einsum("ni,ni->n", heading, east), np.einsum("ni,ni->n", heading, north)))
    return {
        "id": np.arange(count, dtype=np.int64) + (int(rng.integers(1 << 32)) << 12),
        "ra": ra,
        "dec": dec,
        "time": time_fraction * exptime,
        "angle": direction % 360.0,
        "speed": speed,
        "width": (diameter + orbits["size"]) / (1000.0 * distance) * ARCSEC_PER_RAD,
        "V": middle + scatter * ndtri(magnitude_quantile) + 5 * np.log10(distance / 1000.0),
        "distance": distance,
    }
