"""Stars of the list near a frame: which are rendered with it, and the wings of the others.

An object is rendered on a frame if it is at most REACH_MAX from it. A star further off also scatters light onto the
frame, which falls with the third power of its distance. The coarse grid of the sky would err there, so stars up to
NEAR_PX from the frame have a separate grid.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from csstsim.base.sphere import angle, ra_dec, unit_vectors
from csstsim.catalog.astrometry.ephemeris import observer
from csstsim.catalog.astrometry.reduction import apparent
from csstsim.catalog.selection.reach import REACH_MAX
from csstsim.optics.sky.starlight import star_directions

if TYPE_CHECKING:
    from csstsim.base.types import BoolArray, FloatArray
    from csstsim.optics.sky.parameters import SkyNumbers
    from csstsim.simulation.exposure import Exposure

NEAR_PX = 20_000.0
_LOOKED_AT = 5.0  # deg from the boresight: no star further off is near a chip


def pixels_off(directions: FloatArray, exposure: Exposure) -> FloatArray:
    """Return how far sources (n, 3), ICRS unit vectors, lie from an Exposure's window [pixel]: 0 on it, (n,).

    The larger of the distances along x and y, as objects are selected; inf more than 5 deg from the boresight.
    """
    pointing = exposure.pointing
    window = exposure.window
    off = np.full(len(directions), np.inf)
    some = np.flatnonzero(angle(directions, unit_vectors(pointing.ra, pointing.dec)) < _LOOKED_AT)
    seen_from = observer(pointing.mjd, pointing.sat_position, pointing.sat_velocity)
    x, y = exposure.wcs.world_to_pixel(*apparent(*ra_dec(directions[some]), seen_from))
    aside = np.maximum(window.x0 - x, x - (window.x1 - 1)), np.maximum(window.y0 - y, y - (window.y1 - 1))
    off[some] = np.maximum(np.maximum(*aside), 0.0)
    return off


def stars_about(exposure: Exposure, numbers: SkyNumbers) -> tuple[BoolArray, BoolArray]:
    """Return the stars of the list that are not rendered with an Exposure, as bool (n,): those far away, those near it.

    numbers: SkyNumbers.
    """
    off = pixels_off(star_directions(numbers), exposure)
    drawn = off <= REACH_MAX + (exposure.gratings.reach if exposure.gratings is not None else 0.0)
    return ~drawn & (off > NEAR_PX), ~drawn & (off <= NEAR_PX)
