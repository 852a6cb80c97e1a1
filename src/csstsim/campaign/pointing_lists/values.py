"""The values of a list's quantities as arrays in csstsim's units, and the reasons why rows are refused."""

from __future__ import annotations

import re
import warnings
from datetime import datetime
from decimal import Decimal, InvalidOperation
from functools import partial
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from astropy import units as u
from astropy.coordinates import Angle
from astropy.time import Time

from csstsim.campaign.pointing_lists.quantities import KINDS, UNITS, unit_of

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from csstsim.base.types import BoolArray, FloatArray
    from csstsim.campaign.pointing_lists.mapping import Mapping
    from csstsim.campaign.pointing_lists.read_list import PointingList

_ISO = re.compile(r"[0-9]{4}-[0-9]{2}-[0-9]{2}T[0-9]{2}:[0-9]{2}(:[0-9]{2}(\.[0-9]{1,12})?)?")
_LONGITUDE = (-180.0, 360.0)
_LATITUDE = (-90.0, 90.0)
_TURN = (-360.0, 360.0)
_SEPARATION = (0.0, 180.0)
RANGES = {
    **dict.fromkeys(("ra", "ecl_lon", "gal_lon"), _LONGITUDE),
    **dict.fromkeys(("dec", "ecl_lat", "gal_lat"), _LATITUDE),
    "pa": _TURN,
    "sun_angle": _SEPARATION,
    "moon_angle": _SEPARATION,
}
_MJD_RANGE = 33_282, 88_069  # of the years allowed in a survey table, 1950 to 2099
_MJD_ZERO = {"jd": Decimal("2400000.5"), "mjd": Decimal(0)}  # MJD 0 in each format
_UNIX_MJD = Decimal(40_587)  # MJD of 1970-01-01
_YES = ("1", "yes", "y", "true", "t", "deep")
_NO = ("0", "no", "n", "false", "f", "wide")


class _Column(NamedTuple):
    cells: list[str]
    unit: str | None
    source: str  # as named in errors


class Values:
    """The quantities of a list's rows. `reasons` {row: why it is refused} is filled when quantities are converted."""

    def __init__(self, table: PointingList, mapping: Mapping) -> None:
        self.rows = len(table.rows)
        self.reasons: dict[int, str] = {}
        self._columns: dict[str, _Column] = {}
        for name, (key, column, value, origin) in mapping.keys().items():
            if column is None:
                assert value is not None  # one of the two is given
                source = ": ".join(str(part) for part in origin if part)
                self._columns[name] = _Column([value] * self.rows, unit_of(key, "", None), source)
            else:
                index = table.column(column)
                heading = table.names[index]
                unit = unit_of(key, heading, table.units.get(heading))
                self._columns[name] = _Column([cells[index] for _, cells in table.rows], unit, f"column {heading}")

    def __contains__(self, name: str) -> bool:
        return name in self._columns

    def refuse(self, row: int, message: str, name: str, value: str, allowed: str | None = None) -> None:
        """Refuse a row with a reason; later reasons are ignored."""
        reason = f"{self.source(name)}: {message} (got {value!r:.60})"
        self.reasons.setdefault(row, f"{reason}; allowed: {allowed}" if allowed else reason)

    def source(self, name: str) -> str:
        """Return the source of a quantity as text: a column of the list, or the entry with a value for all rows."""
        return self._columns[name].source

    def words(self, name: str) -> list[str]:
        """Return the cells of a quantity as text."""
        return self._columns[name].cells

    def numbers(self, name: str, empty: Sequence[bool] | BoolArray = ()) -> FloatArray:
        """Return a quantity (rows,) in the first unit of its kind, NaN where the row is refused.

        empty: (rows,), true for rows that need no value; they are NaN.
        """
        cells, unit, _ = self._columns[name]
        if len(empty):
            cells = ["0" if none else cell for cell, none in zip(cells, empty, strict=True)]
        kind = UNITS[KINDS[name]]
        default = next(iter(kind))
        assert unit is not None  # only words have no unit
        if (scale := kind[unit]) is None:
            numbers = np.array([self._angle(name, row, cell, unit) for row, cell in enumerate(cells)], float)
        else:
            numbers = np.array([self._number(name, row, cell) for row, cell in enumerate(cells)], float)
            numbers = numbers * scale.to(kind[default])
        low, high = RANGES.get(name, (-np.inf, np.inf))
        for row in np.flatnonzero((numbers < low) | (numbers > high)):
            allowed = f"{low:g} to {high:g} {default}"
            self.refuse(int(row), f"out of range: {numbers[row]:g} {default}", name, cells[row], allowed)
            numbers[row] = np.nan
        return np.where(empty, np.nan, numbers) if len(empty) else numbers

    def _number(self, name: str, row: int, cell: str) -> float:
        try:
            value: float | None = float(cell) if "_" not in cell else np.nan
        except ValueError:
            value = None
        if value is None or not np.isfinite(value):
            sexagesimal = name in RANGES and re.search(r"[0-9][:hdms ]+[0-9]", cell)
            allowed = f"decimals; or map {name}_hms or {name}_dms" if sexagesimal else None
            fault = "no value" if cell == "" else "not a number" if value is None else "not a finite number"
            self.refuse(row, fault, name, cell, allowed)
            return np.nan
        return value

    def _angle(self, name: str, row: int, cell: str, unit: str) -> float:
        """Return a sexagesimal angle [deg]: hours (hms) or degrees (dms), minutes and seconds."""
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("error")  # for 60 seconds
                return float(Angle(cell, unit=u.hourangle if unit == "hms" else u.deg).deg)
        except (ValueError, TypeError, u.UnitsError, Warning):
            allowed = "hours, minutes and seconds" if unit == "hms" else "degrees, minutes and seconds"
            self.refuse(row, "not a sexagesimal angle", name, cell, allowed)
            return np.nan

    def utc(self) -> list[str]:
        """Return the start of each exposure, ISO UTC to a microsecond; "" where the row is refused."""
        cells, unit, _ = self._columns["time"]
        assert unit is not None  # a time has one
        form, scale = unit.split("_")
        read: Callable[[int, str], str | tuple[float, float] | None] = (
            self._iso if form == "iso" else partial(self._days, form=form)
        )
        parts = {row: part for row, cell in enumerate(cells) if (part := read(row, cell)) is not None}
        starts = [""] * self.rows
        if parts:
            arguments = [list(parts.values())] if form == "iso" else np.array(list(parts.values())).T
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # for years without a table of leap seconds
                time = Time(*arguments, format="isot" if form == "iso" else "mjd", scale=scale, precision=6)
                for row, text in zip(parts, time.utc.isot, strict=True):
                    starts[row] = str(text).rstrip("0").rstrip(".")
        return starts

    def _days(self, row: int, cell: str, form: str) -> tuple[float, float] | None:
        """Return the MJD (whole days, fraction) of a JD, MJD or Unix time, without loss of precision; None: refused."""
        try:
            value = Decimal(cell) if "_" not in cell else Decimal("nan")
            mjd = value / 86_400 + _UNIX_MJD if form == "unix" else value - _MJD_ZERO[form]
        except InvalidOperation:
            self.refuse(row, "not a number" if cell else "no value", "time", cell)
            return None
        if not (mjd.is_finite() and _MJD_RANGE[0] <= mjd < _MJD_RANGE[1]):
            allowed = f"a time as {form} of the years 1950 to 2099"
            self.refuse(row, "out of range", "time", cell, allowed + _other_format(value))
            return None
        return float(int(mjd)), float(mjd % 1)

    def _iso(self, row: int, cell: str) -> str | None:
        """Return an ISO time in the format of astropy; None: refused."""
        allowed = "YYYY-MM-DDThh:mm:ss[.ffffff], years 1950 to 2099"
        text = cell.removesuffix("Z").replace(" ", "T")
        try:
            valid = _ISO.fullmatch(text) and 1950 <= datetime.fromisoformat(text[:19]).year <= 2099
        except ValueError:  # 30 February
            valid = False
        if valid:
            return text
        hint = "; or map time_jd or time_mjd" if re.fullmatch(r"[0-9.]+", cell) else ""
        self.refuse(row, "not a time" if cell else "no value", "time", cell, allowed + hint)
        return None

    def whole_numbers(self, name: str) -> list[int | None]:
        """Return a quantity of whole numbers (rows,), None where the row is refused."""
        cells = self.words(name)
        return [self._whole(name, row, cell) for row, cell in enumerate(cells)]

    def _whole(self, name: str, row: int, cell: str, allowed: str = "0, 1, 2, ...") -> int | None:
        if re.fullmatch(r"[0-9]{1,14}(\.0*)?", cell):
            return int(cell.split(".")[0])
        self.refuse(row, "not a whole number", name, cell, allowed)
        return None

    def deep(self) -> list[bool | None]:
        """Return whether exposures belong to the deep survey (rows,); False or None where the row is refused."""
        if "deep_index" in self:  # -1 is wide
            cells = enumerate(self.words("deep_index"))
            allowed = "-1 (wide), or the number of a deep field"
            return [
                False if re.fullmatch(r"-1(\.0*)?", cell) else self._whole("deep_index", row, cell, allowed) is not None
                for row, cell in cells
            ]
        return [self._deep(row, cell) for row, cell in enumerate(self.words("deep"))]

    def _deep(self, row: int, cell: str) -> bool | None:
        word = cell.lower().removesuffix(".0")
        if word not in (*_YES, *_NO):
            self.refuse(row, "neither deep nor wide", "deep", cell, ", ".join((*_YES, *_NO)))
            return None
        return word in _YES


def _other_format(value: Decimal) -> str:
    """Return a hint if a time that is out of range is valid in another format, else ""."""
    if not value.is_finite():
        return ""
    forms = [form for form, zero in _MJD_ZERO.items() if _MJD_RANGE[0] <= value - zero < _MJD_RANGE[1]]
    return "".join(f"; or map time_{form}" for form in forms)
