"""The boresight and position angle of a list's rows: from any of its frames to ICRS, and as they are seen."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from astropy import units as u
from astropy.coordinates import ICRS, BarycentricMeanEcliptic, Galactic, SkyCoord

from csstsim.base.sphere import wrap_360
from csstsim.campaign.pointing_lists.quantities import PLACES
from csstsim.catalog.astrometry.reduction import apparent

if TYPE_CHECKING:
    from csstsim.base.types import FloatArray
    from csstsim.campaign.pointing_lists.mapping import Mapping
    from csstsim.campaign.pointing_lists.values import Values
    from csstsim.catalog.astrometry.ephemeris import Observer

FRAMES = {"equator": ICRS(), "ecliptic": BarycentricMeanEcliptic(equinox="J2000"), "galactic": Galactic()}
_TIP = 0.01 * u.deg  # from the boresight towards +y: aberration changes along it by 1e-8 of a turn


def places(values: Values) -> list[SkyCoord]:
    """Return the SkyCoord in ICRS (rows,) of each pair of coordinates that a list states; NaN where refused."""
    pairs = {frame: pair for frame, pair in PLACES.items() if pair[0] in values and pair[1] in values}
    return [
        SkyCoord(values.numbers(lon) * u.deg, values.numbers(lat) * u.deg, frame=FRAMES[frame]).icrs
        for frame, (lon, lat) in pairs.items()
    ]


def position_angles(there: SkyCoord, given: FloatArray, mapping: Mapping) -> FloatArray:
    """Return the position angles [deg] of +y, north through east, of a list's angles `given` at `there` (ICRS)."""
    angle = (given if mapping.pa_sense == "east" else -given) + mapping.pa_zero
    if mapping.pa_north != "equator":
        tip = there.transform_to(FRAMES[mapping.pa_north]).directional_offset_by(angle * u.deg, _TIP)
        angle = there.position_angle(tip.icrs).deg
    return wrap_360(angle)


def seen(ra: float, dec: float, pa: float, craft: Observer) -> tuple[float, float, float]:
    """Return apparent ra, dec and position angle [deg] of an ICRS place for an Observer, `craft`."""
    tip = SkyCoord(ra * u.deg, dec * u.deg).directional_offset_by(pa * u.deg, _TIP)
    lon, lat = apparent(np.array([ra, tip.ra.deg]), np.array([dec, tip.dec.deg]), craft)
    here, tip = SkyCoord(lon * u.deg, lat * u.deg)
    return float(wrap_360(lon[0])), float(lat[0]), float(wrap_360(here.position_angle(tip).deg))
