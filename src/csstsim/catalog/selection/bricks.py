"""Which truth bricks, and which region of a catalogue, lie around a footprint.

Footprints are in the ICRS at the epoch (job.Job.footprint), with aberration removed.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from csstsim.base.healpix import NSIDE
from csstsim.base.sphere import expanded_polygon, ra_dec, unit_vectors
from csstsim.catalog.base import Region
from csstsim.catalog.selection.reach import REACH_MAX

if TYPE_CHECKING:
    from collections.abc import Iterable

    from csstsim.base.types import FloatArray, IntArray

DISTORTION_PX = 200  # at the field's edge (paper, section 5.2)
# Stars may move 147" (4.1" a year until 2036) within this margin; wings of bright stars beyond it are not rendered.
BRICK_MARGIN_PX = DISTORTION_PX + REACH_MAX


def bricks_for(footprint_ra: FloatArray, footprint_dec: FloatArray, margin_deg: float) -> IntArray:
    """Return the sorted NSIDE-256 nested pixels that overlap a convex footprint grown by a margin.

    Corners in order round the polygon [deg]; it may cross RA 0 and contain a pole. Neighbouring bricks may be included;
    no brick that overlaps is missing.
    """
    return _bricks(*_grown(footprint_ra, footprint_dec, margin_deg))


def region_for(footprint_ra: FloatArray, footprint_dec: FloatArray, margin_deg: float, bands: Iterable[str]) -> Region:
    """Return the `Region` that a catalogue must cover: footprint with margin, its bricks, the camera's bands."""
    ra, dec = _grown(footprint_ra, footprint_dec, margin_deg)
    return Region(tuple(ra.tolist()), tuple(dec.tolist()), tuple(_bricks(ra, dec).tolist()), tuple(bands))


def _bricks(ra: FloatArray, dec: FloatArray) -> IntArray:
    import hpgeom

    return np.sort(hpgeom.query_polygon(NSIDE, ra, dec, inclusive=True, fact=16))


def _grown(ra: FloatArray, dec: FloatArray, margin_deg: float) -> tuple[FloatArray, FloatArray]:
    """Return the corners [deg] of a footprint grown by a margin."""
    return ra_dec(expanded_polygon(unit_vectors(ra, dec), np.radians(margin_deg)))
