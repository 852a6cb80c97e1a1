"""Conversion of a list of pointings to rows of a survey table.

Each row is checked by the reader of survey tables, and against the Sun, Moon and directions stated in the list. It is
accepted or refused independently of other rows.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from csstsim.base.errors import InputError
from csstsim.base.process.progress import progress
from csstsim.base.sphere import angle, unit_vectors, wrap_360
from csstsim.campaign.pointing_lists.directions import apparent_direction, boresights, position_angles
from csstsim.campaign.pointing_lists.quantities import BODIES, STATE
from csstsim.campaign.pointing_lists.values import Values
from csstsim.campaign.survey_table import COLUMNS, SURVEY, Row
from csstsim.catalog.astrometry.ephemeris import observer
from csstsim.instrument.pointing import mjd_utc
from csstsim.optics.sky.bodies import exposure_angles

if TYPE_CHECKING:
    from typing import Any

    from csstsim.base.types import FloatArray
    from csstsim.campaign.pointing_lists.mapping import Mapping
    from csstsim.campaign.pointing_lists.read_list import PointingList
    from csstsim.instrument.orbit import Orbit


@dataclass(frozen=True)
class Converted:
    """rows {row of the list: cells of a survey table by column}; reasons {row: why it is refused}.

    blocked: obsids of exposures towards the Earth, if the state of their spacecraft is from the model orbit.
    """

    rows: dict[int, dict[str, str]]
    reasons: dict[int, str]
    blocked: list[str]


class _ListRow(Row):
    """A row of a survey table; errors name the source of a value. sources: {column of a survey table: source}."""

    def __init__(self, cells: dict[str, Any], sources: dict[str, str]) -> None:
        self.sources = sources
        super().__init__(None, "", list(cells), list(cells.values()))

    def error(
        self, message: str, column: str | None = None, value: object = None, allowed: object = None
    ) -> InputError:
        return InputError(message, key=self.sources.get(column or "", f"column {column}"), value=value, allowed=allowed)


def convert(table: PointingList, mapping: Mapping, orbit: Orbit) -> Converted:
    """Return the Converted of a PointingList. orbit: gives the spacecraft's state of rows without one."""
    values = Values(table, mapping)
    columns = _columns(values, mapping)
    bodies = _bodies(values)
    sources = _sources(values)
    rows: dict[int, dict[str, str]] = {}
    row_of: dict[str, int] = {}
    blocked: list[str] = []
    for number in progress(range(values.rows), "rows"):
        if number in values.reasons:
            continue
        cells = {name: column[number] for name, column in columns.items()}
        try:
            row = _ListRow(cells, sources)
            stated = {name: column[number] for name, column in bodies.items()}
            obsid, sees_sky = _complete(row, stated, mapping, orbit)
            if obsid in row_of:
                allowed = f"once; {table.rows[row_of[obsid]][0]} has it"
                raise InputError("the obsid of another row, too", key=sources["obsid"], value=obsid, allowed=allowed)
        except InputError as error:
            values.reasons[number] = str(error)
            continue
        rows[number] = row.cells
        row_of[obsid] = number
        blocked += [] if sees_sky else [obsid]
    return Converted(rows, values.reasons, blocked)


def _columns(values: Values, mapping: Mapping) -> dict[str, list[str] | FloatArray]:
    """Return {column of a survey table: value of each row}: ra, dec and pa are numbers [deg], ICRS; others are text."""
    boresight, *others = boresights(values)
    for other in others:
        separation = boresight.separation(other).deg
        for row in np.flatnonzero(separation > mapping.tolerance):
            distance = f"{separation[row]:.4g} deg from each other"
            reason = f"two directions, {distance}; allowed: up to {mapping.tolerance:g} deg"
            values.reasons.setdefault(int(row), reason)
    columns = {
        "obsid": _obsids(values, mapping),
        "type": _types(values),
        "ra": wrap_360(boresight.ra.deg),
        "dec": boresight.dec.deg,
        "pa": position_angles(boresight, values.numbers("pa"), mapping),
        "time": values.utc(),
        "exptime": [f"{seconds:.10g}" for seconds in values.numbers("exptime")],
    }
    if STATE[0] in values:
        blank = np.array([[cell == "" for cell in values.words(name)] for name in STATE])
        empty = np.asarray(blank.all(axis=0))
        for name in STATE:
            numbers = values.numbers(name, empty)
            columns[name] = ["" if none else f"{number:.9f}" for number, none in zip(numbers, empty, strict=True)]
    if "deep" in values or "deep_index" in values:
        columns["survey"] = ["DEEP" if deep else "WIDE" for deep in values.deep()]
    return columns


def _sources(values: Values) -> dict[str, str]:
    """Return {column of a survey table: the source of its values, as named in errors}."""
    sources = {name: values.source(name) for name in COLUMNS if name in values}
    sources |= [(SURVEY, values.source(name)) for name in ("deep", "deep_index") if name in values]
    number = values.source("number") if "number" in values else "the number of the row"
    return {"obsid": f"--first-obsid and {number}"} | sources


def _obsids(values: Values, mapping: Mapping) -> list[str]:
    """Return the obsids: those of the list, or first_obsid plus the number in the list or of the row."""
    if "obsid" in values:
        return values.words("obsid")
    numbers = values.whole_numbers("number") if "number" in values else range(values.rows)
    first = mapping.first_obsid
    return [str(int(first) + (number or 0)).zfill(len(first)) for number in numbers]


def _types(values: Values) -> list[str]:
    return [word.upper() for word in values.words("type")] if "type" in values else ["SCIE"] * values.rows


def _bodies(values: Values) -> dict[str, FloatArray]:
    """Return the list's {name: angles (rows,) [deg], or positions (rows, 3) [km]} of the Sun and the Moon."""
    bodies = {f"{body}_angle": values.numbers(f"{body}_angle") for body in BODIES if f"{body}_angle" in values}
    for body in BODIES:
        if f"{body}_x" in values:
            bodies[body] = np.stack([values.numbers(f"{body}_{axis}") for axis in "xyz"], axis=-1)
    return bodies


def _complete(row: _ListRow, bodies: dict[str, Any], mapping: Mapping, orbit: Orbit) -> tuple[str, bool]:
    """Complete the cells of a row; return its obsid, and whether the telescope points away from the Earth.

    Raises InputError if the row is not valid in a survey table, if the telescope points to the Earth from a state given
    in the list, or if the directions of Sun or Moon differ from those in the list.
    """
    cells = row.cells
    obsid = row.obsid()
    state = row.state()
    craft = state or orbit.state(row.time())
    mjd = mjd_utc(row.time())
    ra, dec, pa = (float(cells[name]) for name in ("ra", "dec", "pa"))
    if mapping.directions == "icrs":
        ra, dec, pa = apparent_direction(ra, dec, pa, observer(mjd, *craft))
    cells |= {"ra": f"{wrap_360(round(ra, 9)):.9f}", "dec": f"{dec:.9f}", "pa": f"{pa:.7f}"}
    pointing = row.pointing(craft)
    if pointing.type != "SCIE":
        return obsid, True
    angles = exposure_angles(ra, dec, mjd, *craft)
    if state and angles["limb"] < 0:
        raise InputError(
            "looks at the Earth", key="angle from the Earth's limb [deg]", value=round(angles["limb"], 2), allowed="> 0"
        )
    for name, stated in bodies.items():
        body = name.removesuffix("_angle")
        if name == body:  # a position
            stated = float(angle(unit_vectors(ra, dec), stated - np.array(craft.position)))
        if not abs(stated - angles[body]) <= mapping.tolerance:  # also for NaN
            raise InputError(
                f"the list says {stated:.3f} deg from the {body.capitalize()}",
                key=name,
                value=round(angles[body], 3),
                allowed=f"within {mapping.tolerance:g} deg",
            )
    return obsid, bool(angles["limb"] >= 0)
