"""The pointing that the header of a Level-0 file states, compared with the pointing itself."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from csstsim.base.sphere import offsets

if TYPE_CHECKING:
    from csstsim.optics.geometry.wcs import ChipWCS

POSITIONS = ("RA_OBJ", "DEC_OBJ"), ("RA_PNT0", "DEC_PNT0"), ("RA_PNT1", "DEC_PNT1")  # apparent, as CRVAL
ANGLES = ("POS_ANG0", 1), ("POS_ANG1", 1), ("EULER0_3", -1), ("EULER1_3", -1)  # keyword, sign of the position angle
EULER = ("EULER0_1", "EULER0_2"), ("EULER1_1", "EULER1_2")  # right ascension, minus declination
TOLERANCE = 0.01  # arcsec: keywords are written in full precision
LINEAR = "RA---TAN"


class Boresight(NamedTuple):
    """The boresight: apparent ra, dec [deg], and the position angle of the mosaic pa [deg], None if not known."""

    ra: float
    dec: float
    pa: float | None


def boresight_of(header: Mapping[str, Any]) -> Boresight | None:
    """Return the boresight of a linear WCS (its CRVAL); None if the header has no such WCS."""
    if header.get("CTYPE1") != LINEAR or not {"CRVAL1", "CRVAL2"} <= set(header):
        return None
    return Boresight(float(header["CRVAL1"]), float(header["CRVAL2"]), None)


def pointing_offsets(header0: Mapping[str, Any], boresight: Boresight) -> dict[str, float]:
    """Return {keyword: arcsec} by which the pointing keywords of a primary header differ from the boresight.

    A position counts as one keyword, that of its right ascension. Without a position angle, the angles are compared
    with each other. Keywords that the header lacks are omitted. The difference is infinite if a value is not a number.
    """
    off = {}
    positions = [(*pair, 1) for pair in POSITIONS] + [(*pair, -1) for pair in EULER]
    for ra_name, dec_name, sign in positions:
        if ra_name in header0 and dec_name in header0:
            ra = _number(header0[ra_name])
            dec = sign * _number(header0[dec_name])
            off[ra_name] = _separation(ra, dec, boresight)
    angles = {name: sign * _number(header0[name]) for name, sign in ANGLES if name in header0}
    true = boresight.pa if boresight.pa is not None else next(iter(angles.values()), 0.0)
    for name, angle in angles.items():
        off[name] = abs((angle - true + 180.0) % 360.0 - 180.0) * 3600.0
    return {name: distance if np.isfinite(distance) else np.inf for name, distance in off.items()}


def _number(value: object) -> float:
    try:
        return float(value)  # type: ignore[arg-type]
    except (TypeError, ValueError):
        return np.nan


def _separation(ra: float, dec: float, boresight: Boresight) -> float:
    east, north = offsets(ra, dec, boresight.ra, boresight.dec)
    return float(np.hypot(east, north)) * 3600.0


def wcs_offset(header: Mapping[str, Any], wcs: ChipWCS) -> float:
    """Return the largest distance [arcsec] of an image header's WCS from `wcs`, at the chip's centre and a corner.

    The header's WCS is TAN or TAN-SIP; a linear one is compared with the linear part of `wcs`. The distance is infinite
    for a header without a valid WCS.
    """
    from astropy.io.fits import Header
    from astropy.wcs import WCS

    wcs_names = set(wcs.header())
    cards = {k: v for k, v in header.items() if k in wcs_names or k.startswith(("A_", "B_", "AP_", "BP_"))}
    if "CTYPE1" not in cards:
        return np.inf
    x = np.array([(wcs.chip.detector.nx - 1) / 2, 0.0])
    y = np.array([(wcs.chip.detector.ny - 1) / 2, 0.0])
    linear = str(cards.get("CTYPE1")) == LINEAR
    true = WCS(Header(wcs.header())).all_pix2world(x, y, 0) if linear else wcs.pixel_to_world(x, y)
    return sky_offset(cards, x, y, true)


def sky_offset(cards: Mapping[str, Any], x: ArrayLike, y: ArrayLike, true: Iterable[ArrayLike]) -> float:
    """Return the largest distance [arcsec] of a WCS at pixels x, y (n,) from `true`, their ra and dec [deg].

    It is infinite for cards that are no WCS, and for positions that are not finite.
    """
    from astropy.io.fits import Header
    from astropy.wcs import WCS

    try:
        measured = WCS(Header(cards)).all_pix2world(x, y, 0)
    except (ValueError, KeyError, ArithmeticError):
        return np.inf
    distance = 3600.0 * np.hypot(*offsets(*measured, *true)).max()
    return float(distance) if np.isfinite(distance) else np.inf
