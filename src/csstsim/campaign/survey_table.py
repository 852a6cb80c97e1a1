"""Reading the survey table: a CSV file with one exposure per row, checked completely (survey_tables/README.md).

Columns are identified by name and may have any order. Lines that start with '#' are comments. Every error names file,
line, column, value and what is allowed, because tables of thousands of rows are made by other people's scripts.
"""

from __future__ import annotations

import csv
import math
import re
from pathlib import Path
from typing import TYPE_CHECKING, get_args

from csstsim.base.errors import InputError
from csstsim.base.files.text_file import read_text
from csstsim.base.help_page import explained
from csstsim.base.shipped import SHIPPED
from csstsim.base.units import EARTH_RADIUS_KM
from csstsim.instrument.camera import load_telescope
from csstsim.instrument.orbit import OrbitState
from csstsim.instrument.pointing import EXPTIME_MAX, YEARS, ExposureType, Pointing, SurveyComponent, parse_utc

if TYPE_CHECKING:
    from collections.abc import Sequence

    from csstsim.base.types import PathLike
    from csstsim.instrument.orbit import Orbit

OBSID = re.compile(r"[0-9]{9,14}")
OBSID_ALLOWED = "9 to 14 digits"
REQUIRED = ("obsid", "type", "ra", "dec", "pa", "time", "exptime")
STATE = ("sat_x", "sat_y", "sat_z", "sat_vx", "sat_vy", "sat_vz")
SURVEY = "survey"
COLUMNS = (*REQUIRED, *STATE, SURVEY)
TYPES = get_args(ExposureType)
COMPONENTS = get_args(SurveyComponent)
_MIN_EXPTIME = 1e-3  # s
# larger values are in another unit, or not those of an Earth orbit
_MAX_RADIUS_KM = 50_000.0
_MAX_SPEED_KM_S = 12.0


@explained("survey table")
def load_survey_table(path: PathLike, orbit: Orbit | None = None) -> dict[str, Pointing]:
    """Return the exposures of a file as `exposures_of` does. Raises InputError for the first fault."""
    return exposures_of(read_text(Path(path), "utf-8-sig"), orbit, Path(path))


@explained("survey table")
def exposures_of(text: str, orbit: Orbit | None = None, path: PathLike | None = None) -> dict[str, Pointing]:
    """Return the exposures in a table's text, {obsid: Pointing} in the order of its lines.

    orbit: gives the spacecraft's state of rows without one (instrument.orbit.Orbit; None: the shipped one); path: named
    in errors. Raises InputError for the first fault.
    """
    lines = _lines(path, text)
    if not lines:
        raise InputError("the table is empty: no header line", file=path)
    header = _header(path, *lines[0])
    pointings: dict[str, Pointing] = {}
    line_of: dict[str, int] = {}
    for number, cells in lines[1:]:
        row = Row(path, f"line {number}", header, cells)
        obsid = row.obsid()
        if obsid in line_of:
            raise row.error(f"duplicate of line {line_of[obsid]}", "obsid", obsid)
        line_of[obsid] = number
        state = row.state()
        if state is None:
            orbit = orbit or load_telescope(SHIPPED / "instrument" / "telescope.yaml").orbit
            state = orbit.state(row.time())
        pointings[obsid] = row.pointing(state)
    if not pointings:
        raise InputError("the table is empty: a header and no exposure", file=path)
    return pointings


def _lines(path: PathLike | None, text: str) -> list[tuple[int, list[str]]]:
    """Return (line number, cells) of every line that is neither blank nor a comment."""
    lines = enumerate(text.splitlines(), start=1)
    rows = [(number, line) for number, line in lines if line.strip() and not line.lstrip().startswith("#")]
    return [(number, _cells(path, number, line)) for number, line in rows]


def _cells(path: PathLike | None, number: int, line: str) -> list[str]:
    try:
        if "\0" in line:
            raise csv.Error("a NUL character")
        return [cell.strip() for cell in next(csv.reader([line]))]
    except csv.Error as exc:  # also a cell of more than 131,072 characters
        raise InputError(f"not a line of CSV: {exc}", file=path, key=f"line {number}") from None


def _header(path: PathLike | None, number: int, names: list[str]) -> list[str]:
    def fault(message: str, name: str, allowed: str | None = None) -> InputError:
        return InputError(message, file=path, key=f"line {number}", value=name, allowed=allowed)

    for name in names:
        if name not in COLUMNS:
            raise fault("unknown column", name, ", ".join(COLUMNS))
        if names.count(name) > 1:
            raise fault("the column is given twice", name)
    for name in REQUIRED:
        if name not in names:
            raise fault("column is missing", name)
    missing = [name for name in STATE if name not in names]
    if 0 < len(missing) < len(STATE):
        raise fault("spacecraft state needs all six columns or none; missing", missing[0])
    return names


class Row:
    """One row of the table. Each method checks a cell and returns its value; an InputError names path, line, column."""

    def __init__(self, path: PathLike | None, line: str, header: Sequence[str], cells: Sequence[str]) -> None:
        self.path = path
        self.line = line
        if len(cells) != len(header):
            raise self.error(f"{len(cells)} cells under {len(header)} columns")
        self.cells = dict(zip(header, cells, strict=True))

    def error(
        self, message: str, column: str | None = None, value: object = None, allowed: object = None
    ) -> InputError:
        """Return the InputError about a cell."""
        key = ", ".join(part for part in (self.line, column and f"column {column}") if part)
        return InputError(message, file=self.path, key=key or None, value=value, allowed=allowed)

    def number_in(self, column: str, low: float, high: float, allowed: str, *, open_high: bool = False) -> float:
        """Return the number in a column, from `low` to `high` (included, unless `open_high`)."""
        text = self.cells[column]
        try:
            value = float(text)
        except ValueError:
            raise self.error("not a number", column, text, allowed) from None
        if not low <= value <= high or (open_high and value == high):  # false for NaN
            raise self.error("out of range", column, text, allowed)
        return value

    def obsid(self) -> str:
        """Return the obsid."""
        text = self.cells["obsid"]
        if not OBSID.fullmatch(text):
            raise self.error("not an observation id", "obsid", text, OBSID_ALLOWED)
        return text

    def type(self) -> str:
        """Return the exposure type, one of TYPES."""
        if self.cells["type"] not in TYPES:
            raise self.error("unknown exposure type", "type", self.cells["type"], ", ".join(TYPES))
        return self.cells["type"]

    def survey(self) -> str:
        """Return the survey component, one of COMPONENTS; WIDE if the table has none."""
        component = self.cells.get(SURVEY) or "WIDE"
        if component not in COMPONENTS:
            raise self.error("unknown survey component", SURVEY, component, ", ".join(COMPONENTS))
        if component != "WIDE" and self.type() != "SCIE":
            raise self.error("allowed for science exposures only", SURVEY, component, "empty, or type SCIE")
        return component

    def time(self) -> str:
        """Return the start, ISO UTC."""
        try:
            year = parse_utc(self.cells["time"]).year
        except ValueError:
            allowed = "UTC as YYYY-MM-DDThh:mm:ss[.ffffff]"
            raise self.error("not a time", "time", self.cells["time"], allowed) from None
        if not YEARS[0] <= year <= YEARS[1]:
            raise self.error("out of range", "time", self.cells["time"], f"years {YEARS[0]} to {YEARS[1]}")
        return self.cells["time"]

    def exptime(self) -> float:
        """Return the exposure time [s]."""
        allowed = f"0 (BIAS only), or {_MIN_EXPTIME} to 100000 s"
        value = self.number_in("exptime", 0.0, EXPTIME_MAX, allowed)
        if 0 < value < _MIN_EXPTIME:
            raise self.error("out of range", "exptime", self.cells["exptime"], allowed)
        if value == 0 and self.type() != "BIAS":
            raise self.error("zero exposure time", "exptime", self.cells["exptime"], "0 for BIAS only")
        return value

    def state(self) -> OrbitState | None:
        """Return the spacecraft's OrbitState; None if the six cells are empty, or the table lacks these columns."""
        given = [name for name in STATE if self.cells.get(name, "") != ""]
        if not given:
            return None
        for name in STATE:
            if name not in given:
                raise self.error("spacecraft state needs all six values or none; this one is empty", name)
        x, y, z, vx, vy, vz = (
            self.number_in(name, -_MAX_RADIUS_KM, _MAX_RADIUS_KM, "km and km/s, geocentric GCRS") for name in STATE
        )
        position = (x, y, z)
        velocity = (vx, vy, vz)
        radius = math.hypot(*position)
        speed = math.hypot(*velocity)
        if not EARTH_RADIUS_KM < radius <= _MAX_RADIUS_KM:
            raise self.error(
                "distance from the Earth's centre [km] out of range",
                "sat_x",
                radius,
                f"{EARTH_RADIUS_KM:g}-{_MAX_RADIUS_KM:g}",
            )
        if speed > _MAX_SPEED_KM_S:
            raise self.error("speed [km/s] out of range", "sat_vx", speed, f"up to {_MAX_SPEED_KM_S:g}")
        return OrbitState(position, velocity)

    def pointing(self, state: OrbitState) -> Pointing:
        """Return the Pointing of the row for a state of the spacecraft."""
        return Pointing(
            type=self.type(),
            ra=self.number_in("ra", 0.0, 360.0, "0 <= ra < 360 deg", open_high=True),
            dec=self.number_in("dec", -90.0, 90.0, "-90 to 90 deg"),
            pa=self.number_in("pa", -360.0, 360.0, "-360 to 360 deg"),
            time=self.time(),
            exptime=self.exptime(),
            sat_position=state.position,
            sat_velocity=state.velocity,
            survey=self.survey(),
        )
