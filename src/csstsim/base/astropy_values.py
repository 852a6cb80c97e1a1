"""SkyCoord, Quantity and Time of astropy as the plain numbers that csstsim computes with.

Values of other types are returned as they are, and astropy is not imported for them.
"""

from __future__ import annotations

import warnings
from typing import TYPE_CHECKING, Any

from csstsim.base.errors import InputError

if TYPE_CHECKING:
    from astropy.coordinates import SkyCoord

    from csstsim.base.types import AnyArray, PathLike

_NO_ICRS = "has no ICRS position"


def is_sky_coord(value: object) -> bool:
    """Return whether a value is a SkyCoord."""
    return hasattr(value, "transform_to")


def is_time(value: object) -> bool:
    """Return whether a value is a Time."""
    return hasattr(value, "jd1")


def number(value: Any, unit: str, name: str) -> Any:
    """Return a Quantity or an Angle as float in `unit`. Raises InputError, which names `name`, if it does not fit."""
    if not hasattr(value, "to_value"):
        return value
    try:
        return float(value.to_value(unit))
    except (TypeError, ValueError):  # UnitConversionError is one; so is an array
        raise InputError(
            "the quantity does not fit", key=name, value=str(value), allowed=f"one value [{unit}]"
        ) from None


def direction(ra: Any, dec: Any) -> tuple[Any, Any]:
    """Return ra, dec [deg, ICRS] of two numbers or angles, or of a SkyCoord without `dec`. Raises InputError."""
    if not is_sky_coord(ra):
        if dec is None:
            raise InputError("is missing", key="dec", allowed="ra and dec [deg], or a SkyCoord")
        return number(ra, "deg", "ra"), number(dec, "deg", "dec")
    if dec is not None:
        raise InputError("a SkyCoord has its own", key="dec", value=dec, allowed="aim(position, chip=9)")
    if not ra.isscalar:
        raise InputError("must be one position", key="ra", value=f"SkyCoord of shape {ra.shape}")
    try:
        icrs = ra.icrs
    except Exception as error:  # of many types, as of an AltAz without a place
        raise InputError(f"{_NO_ICRS}: {str(error).splitlines()[0]}", key="ra", value=_said(ra)) from None
    return float(icrs.ra.deg), float(icrs.dec.deg)


def _said(sky: SkyCoord) -> str:
    return f"SkyCoord, {sky.frame.name}"


def utc_text(value: Any) -> Any:
    """Return a Time as ISO 8601 text in UTC, to the microsecond. Raises InputError for an array of times."""
    if not is_time(value):
        return value
    if not value.isscalar:
        raise InputError("must be one time", key="time", value=f"Time of shape {value.shape}")
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "ERFA function")  # future leap seconds are not known
        utc = value.utc.copy()
        utc.precision = 6
        return str(utc.isot)


def position_columns(sky: SkyCoord, name: str, where: PathLike) -> dict[str, AnyArray]:
    """Return {column of a table of objects: (n,) values} of a SkyCoord column `name`, ICRS at J2000.

    ra, dec [deg]; pmra, pmdec [mas / yr], rv [km / s] and parallax [mas] if the SkyCoord has them. Positions with
    proper motion and `obstime` are moved to J2000. Raises InputError if the frame has no ICRS positions.
    """
    from astropy import units as u
    from astropy.time import Time

    try:
        icrs = sky.icrs
        moving = "s" in icrs.data.differentials
        if moving and icrs.obstime is not None:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # of stars without a distance
                icrs = icrs.apply_space_motion(new_obstime=Time("J2000"))
    except Exception as error:  # of many types, as of an AltAz without a place
        raise InputError(f"{_NO_ICRS}: {str(error).splitlines()[0]}", file=where, key=name, value=_said(sky)) from None
    columns = {"ra": icrs.ra.deg, "dec": icrs.dec.deg}
    if moving:
        columns |= {"pmra": icrs.pm_ra_cosdec.to_value("mas/yr"), "pmdec": icrs.pm_dec.to_value("mas/yr")}
        if hasattr(icrs.data.differentials["s"], "d_distance"):
            columns["rv"] = icrs.radial_velocity.to_value("km/s")
    if icrs.distance.unit.is_equivalent(u.pc):
        columns["parallax"] = icrs.distance.to_value("mas", u.parallax())
    return columns
