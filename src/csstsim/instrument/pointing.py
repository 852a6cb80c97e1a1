"""A pointing: when and where one exposure is taken, a row of the survey table (paper, section 4.1)."""

import re
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from typing import Literal

ExposureType = Literal["SCIE", "BIAS", "DARK", "FLAT"]
SurveyComponent = Literal["WIDE", "DEEP"]  # to which a science exposure belongs
EXPTIME_MAX = 1e5  # s
YEARS = 1950, 2099  # range of the Earth's ephemeris of catalog.astrometry.ephemeris
_ISO = re.compile(r"\d{4}-\d{2}-\d{2}[T ]\d{2}:\d{2}:\d{2}(\.\d{1,6})?Z?")
_MJD_ZERO = datetime(1858, 11, 17, tzinfo=UTC)


def parse_utc(text: str) -> datetime:
    """Return an ISO UTC time 'YYYY-MM-DDThh:mm:ss[.ffffff][Z]' as an aware datetime; ValueError otherwise."""
    if not isinstance(text, str) or not _ISO.fullmatch(text):
        raise ValueError(f"not an ISO UTC time: {text!r}")
    return datetime.fromisoformat(text.removesuffix("Z")).replace(tzinfo=UTC)


def mjd_utc(text: str) -> float:
    """Return the UTC modified Julian date [day] of an ISO UTC time."""
    return (parse_utc(text) - _MJD_ZERO) / timedelta(days=1)


@dataclass(frozen=True)
class Pointing:
    """One exposure, without its obsid: pixels depend on the obsid only through random numbers.

    `ra`, `dec` [deg] are the direction of the boresight in the apparent frame: CRVAL of every chip. `pa` [deg] is
    the position angle of the mosaic's +y axis, north through east. `time` is the start, ISO UTC; `exptime` in s.
    `sat_position` [km] and `sat_velocity` [km/s] are geocentric GCRS, (x, y, z). `survey` is for headers and names of
    files only.
    """

    type: str  # SCIE, BIAS, DARK or FLAT
    ra: float
    dec: float
    pa: float
    time: str
    exptime: float
    sat_position: tuple[float, float, float]
    sat_velocity: tuple[float, float, float]
    survey: str = "WIDE"  # or DEEP

    @property
    def start(self) -> datetime:
        """Aware UTC datetime of the start."""
        return parse_utc(self.time)

    @property
    def end(self) -> datetime:
        """Aware UTC datetime of start + exptime."""
        return self.start + timedelta(seconds=self.exptime)

    @property
    def mjd(self) -> float:
        """UTC modified Julian date of the start [day]."""
        return mjd_utc(self.time)
