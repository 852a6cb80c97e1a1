"""A list of pointings as rows of a survey table.

Each row is checked as the survey table's reader checks it, and against what the list itself states, and refused alone.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from csstsim.base.errors import InputError
from csstsim.base.process.progress import progress
from csstsim.base.sphere import angle, unit_vectors, wrap_360
from csstsim.campaign.pointing_lists.directions import places, position_angles, seen
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

    blocked: obsids that have the Earth in the way, among those whose spacecraft the model orbit places.
    """

    rows: dict[int, dict[str, str]]
    reasons: dict[int, str]
    blocked: list[str]


class _Stated(Row):
    """A row of a survey table, whose errors name what states the value; said: {column of a survey table: that}."""

    def __init__(self, cells: dict[str, Any], said: dict[str, str]) -> None:
        self.said = said
        super().__init__(None, "", list(cells), list(cells.values()))

    def error(
        self, message: str, column: str | None = None, value: object = None, allowed: object = None
    ) -> InputError:
        return InputError(message, key=self.said.get(column or "", f"column {column}"), value=value, allowed=allowed)


def convert(table: PointingList, mapping: Mapping, orbit: Orbit) -> Converted:
    """Return the Converted of a PointingList. orbit (instrument.orbit.Orbit): of rows without a spacecraft's state."""
    values = Values(table, mapping)
    columns = _columns(values, mapping)
    bodies = _bodies(values)
    said = _said(values)
    found: dict[int, dict[str, str]] = {}
    first: dict[str, int] = {}
    blocked: list[str] = []
    for row in progress(range(values.rows), "rows"):
        if row in values.reasons:
            continue
        cells = {name: column[row] for name, column in columns.items()}
        try:
            stated = {name: column[row] for name, column in bodies.items()}
            checked = _Stated(cells, said)
            obsid, clear = _checked(checked, stated, mapping, orbit)
            if obsid in first:
                allowed = f"once; {table.rows[first[obsid]][0]} has it"
                raise InputError("the obsid of another row, too", key=said["obsid"], value=obsid, allowed=allowed)
        except InputError as error:
            values.reasons[row] = str(error)
            continue
        found[row] = checked.cells
        first[obsid] = row
        blocked += [] if clear else [obsid]
    return Converted(found, values.reasons, blocked)


def _columns(values: Values, mapping: Mapping) -> dict[str, list[str] | FloatArray]:
    """Return {column of a survey table: value of each row}: ra, dec and pa are numbers [deg], ICRS; the rest text."""
    there, *others = places(values)
    for other in others:
        apart = there.separation(other).deg
        for row in np.flatnonzero(apart > mapping.tolerance):
            reason = f"two directions, {apart[row]:.4g} deg from each other; allowed: up to {mapping.tolerance:g} deg"
            values.reasons.setdefault(int(row), reason)
    columns = {
        "obsid": _obsids(values, mapping),
        "type": _types(values),
        "ra": wrap_360(there.ra.deg),
        "dec": there.dec.deg,
        "pa": position_angles(there, values.numbers("pa"), mapping),
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


def _said(values: Values) -> dict[str, str]:
    """Return {column of a survey table: what states its values}."""
    said = {name: values.said(name) for name in COLUMNS if name in values}
    said |= [(SURVEY, values.said(name)) for name in ("deep", "deep_index") if name in values]
    counted = values.said("number") if "number" in values else "the number of the row"
    return {"obsid": f"--first-obsid and {counted}"} | said


def _obsids(values: Values, mapping: Mapping) -> list[str]:
    """Return the obsids: the list's own, or counted from the first by its number or by the row."""
    if "obsid" in values:
        return values.words("obsid")
    numbers = values.whole_numbers("number") if "number" in values else range(values.rows)
    first = mapping.first_obsid
    return [str(int(first) + (number or 0)).zfill(len(first)) for number in numbers]


def _types(values: Values) -> list[str]:
    return [word.upper() for word in values.words("type")] if "type" in values else ["SCIE"] * values.rows


def _bodies(values: Values) -> dict[str, FloatArray]:
    """Return {what the list states of the Sun and the Moon: (rows,) angles [deg] or (rows, 3) positions [km]}."""
    found = {f"{body}_angle": values.numbers(f"{body}_angle") for body in BODIES if f"{body}_angle" in values}
    for body in BODIES:
        if f"{body}_x" in values:
            found[body] = np.stack([values.numbers(f"{body}_{axis}") for axis in "xyz"], axis=-1)
    return found


def _checked(row: _Stated, bodies: dict[str, Any], mapping: Mapping, orbit: Orbit) -> tuple[str, bool]:
    """Complete a row's cells; return its obsid, and whether a spacecraft on the model orbit sees the sky.

    Raises InputError if a survey table would refuse the row, if the Earth is in the way of a spacecraft whose state the
    list gives, or if Sun or Moon are elsewhere than it says.
    """
    cells = row.cells
    obsid = row.obsid()
    state = row.state()
    position, velocity = state or orbit.state(row.time())
    mjd = mjd_utc(row.time())
    ra, dec, pa = (float(cells[name]) for name in ("ra", "dec", "pa"))
    if mapping.directions == "icrs":
        ra, dec, pa = seen(ra, dec, pa, observer(mjd, position, velocity))
    cells |= {"ra": f"{wrap_360(round(ra, 9)):.9f}", "dec": f"{dec:.9f}", "pa": f"{pa:.7f}"}
    pointing = row.pointing((position, velocity))
    if pointing.type != "SCIE":
        return obsid, True
    angles = exposure_angles(ra, dec, mjd, position, velocity)
    if state and angles["limb"] < 0:
        raise InputError(
            "looks at the Earth", key="angle from the Earth's limb [deg]", value=round(angles["limb"], 2), allowed="> 0"
        )
    for name, stated in bodies.items():
        body = name.removesuffix("_angle")
        if name == body:  # a position
            stated = float(angle(unit_vectors(ra, dec), stated - np.array(position)))
        if not abs(stated - angles[body]) <= mapping.tolerance:  # NaN, too
            raise InputError(
                f"the list says {stated:.3f} deg from the {body.capitalize()}",
                key=name,
                value=round(angles[body], 3),
                allowed=f"within {mapping.tolerance:g} deg",
            )
    return obsid, bool(angles["limb"] >= 0)
