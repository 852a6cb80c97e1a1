"""Boresight and position angle of the rows of a list: from its frames to ICRS, and from ICRS to apparent directions."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from astropy import units as u
from astropy.coordinates import ICRS, BarycentricMeanEcliptic, Galactic, SkyCoord

from csstsim.base.sphere import wrap_360
from csstsim.campaign.pointing_lists.quantities import COORDINATES
from csstsim.catalog.astrometry.reduction import apparent

if TYPE_CHECKING:
    from csstsim.base.types import FloatArray
    from csstsim.campaign.pointing_lists.mapping import Mapping
    from csstsim.campaign.pointing_lists.values import Values
    from csstsim.catalog.astrometry.ephemeris import Observer

FRAMES = {"equator": ICRS(), "ecliptic": BarycentricMeanEcliptic(equinox="J2000"), "galactic": Galactic()}
_TIP = 0.01 * u.deg  # from the boresight towards +y: aberration changes this direction by 1e-8 of a turn


class Direction(NamedTuple):
    """Apparent right ascension and declination of the boresight, and position angle of +y [deg]."""

    ra: float
    dec: float
    pa: float


def boresights(values: Values) -> list[SkyCoord]:
    """Return the boresights (rows,), ICRS, from each pair of coordinates in a list; NaN where a row is refused."""
    pairs = {frame: pair for frame, pair in COORDINATES.items() if pair[0] in values and pair[1] in values}
    return [
        SkyCoord(values.numbers(lon) * u.deg, values.numbers(lat) * u.deg, frame=FRAMES[frame]).icrs
        for frame, (lon, lat) in pairs.items()
    ]


def position_angles(boresight: SkyCoord, angles: FloatArray, mapping: Mapping) -> FloatArray:
    """Return position angles (rows,) [deg] of +y, north through east, from a list's angles (rows,) [deg]."""
    angle = (angles if mapping.pa_sense == "east" else -angles) + mapping.pa_zero
    if mapping.pa_north != "equator":
        tip = boresight.transform_to(FRAMES[mapping.pa_north]).directional_offset_by(angle * u.deg, _TIP)
        angle = boresight.position_angle(tip.icrs).deg
    return wrap_360(angle)


def apparent_direction(ra: float, dec: float, pa: float, craft: Observer) -> Direction:
    """Return the apparent Direction of ICRS ra, dec and position angle [deg] for an Observer."""
    tip = SkyCoord(ra * u.deg, dec * u.deg).directional_offset_by(pa * u.deg, _TIP)
    lon, lat = apparent(np.array([ra, tip.ra.deg]), np.array([dec, tip.dec.deg]), craft)
    boresight, tip = SkyCoord(lon * u.deg, lat * u.deg)
    return Direction(float(wrap_360(lon[0])), float(lat[0]), float(wrap_360(boresight.position_angle(tip).deg)))
