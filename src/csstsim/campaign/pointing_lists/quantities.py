"""The quantities of a list of pointings, and their units.

A key is the name of a quantity and its unit, which may be omitted if it is the first of its kind: `ra`, `ra_hour`,
`time_jd`, `time_mjd_tai`. Words (obsid, type, deep) have no unit.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from astropy import units as u

from csstsim.base.errors import InputError

if TYPE_CHECKING:
    from csstsim.base.types import PathLike

# The units of each kind, the default first; None: text that is parsed
UNITS: dict[str, dict[str, u.UnitBase | None]] = {
    "angle": {
        "deg": u.deg,
        "hour": u.hourangle,
        "rad": u.rad,
        "arcmin": u.arcmin,
        "arcsec": u.arcsec,
        "hms": None,
        "dms": None,
    },
    "length": {"km": u.km, "m": u.m, "au": u.au},
    "speed": {"km_s": u.km / u.s, "m_s": u.m / u.s},
    "duration": {"s": u.s, "ms": u.ms, "min": u.min, "hour": u.hour, "day": u.day},
    "time": {"iso": None, "jd": u.day, "mjd": u.day, "unix": u.s},
    "words": {},
}
SCALES = "utc", "tai", "tt", "tdb"  # may follow the format of a time; the default first
COORDINATES = {"equator": ("ra", "dec"), "ecliptic": ("ecl_lon", "ecl_lat"), "galactic": ("gal_lon", "gal_lat")}
STATE = "sat_x", "sat_y", "sat_z", "sat_vx", "sat_vy", "sat_vz"
BODIES = "sun", "moon"
KINDS = {
    "obsid": "words",
    "number": "words",
    "type": "words",
    "deep": "words",
    "deep_index": "words",
    "time": "time",
    "exptime": "duration",
    **{name: "angle" for pair in COORDINATES.values() for name in pair},
    "pa": "angle",
    **dict.fromkeys(STATE[:3], "length"),
    **dict.fromkeys(STATE[3:], "speed"),
    **{f"{body}_angle": "angle" for body in BODIES},
    **{f"{body}_{axis}": "length" for body in BODIES for axis in "xyz"},
}


@dataclass(frozen=True)
class Key:
    """A quantity, and the unit in its key; None: the key has no unit."""

    name: str
    unit: str | None

    @property
    def kind(self) -> str:
        """One of UNITS."""
        return KINDS[self.name]


def parse_key(text: str, file: PathLike | None = None, key: str | None = None) -> Key:
    """Return the Key in a text of a mapping. Raises InputError for an unknown quantity or unit.

    file, key: where the text is, for the message.
    """
    matches = [name for name in KINDS if text == name or text.startswith(f"{name}_")]
    if not matches:
        hint = f"; did you mean time_{text}?" if _unit("time", text) else ""
        raise InputError("unknown quantity", file=file, key=key, value=text, allowed=", ".join(KINDS) + hint)
    name = max(matches, key=len)
    suffix = text[len(name) + 1 :]
    if not suffix:
        return Key(name, None)
    unit = _unit(KINDS[name], suffix)
    if unit is None:
        kind = UNITS[KINDS[name]]
        allowed = ", ".join(f"{name}_{unit}" for unit in kind) or f"{name}, which has no unit"
        if KINDS[name] == "time":
            allowed += f"; a scale may follow: {', '.join(SCALES)}"
        raise InputError("unknown unit", file=file, key=key or name, value=suffix, allowed=allowed)
    return Key(name, unit)


def _unit(kind: str, suffix: str) -> str | None:
    """Return the unit that a suffix names, or None; for a time, its format and scale, such as `mjd_tai`."""
    if kind != "time":
        return suffix if suffix in UNITS[kind] else None
    form, _, scale = ("iso", "", suffix) if suffix in SCALES else suffix.partition("_")
    return f"{form}_{scale or SCALES[0]}" if form in UNITS[kind] and scale in (*SCALES, "") else None


def unit_of(key: Key, column: str, stated: u.UnitBase | None) -> str | None:
    """Return the unit of a column: from the key, the list (`stated`, an astropy unit), or the end of the column's name.

    Without any of them, the first unit of the kind. Raises InputError if two differ, or if the list's unit does not fit
    the quantity.
    """
    if key.kind == "words":
        return None
    words = column.lower().split("_")
    named = [unit for k in range(len(words)) if (unit := _unit(key.kind, "_".join(words[k:])))]
    units: dict[str, str | None] = {
        "the mapping": key.unit,
        "the list": _unit_of_file(key, stated, column),
        "the column's name": None,
    }
    if named and (not key.unit if key.kind == "time" else len(words) > 1):  # MJD may be in any time scale
        units["the column's name"] = named[0]
    given = {source: unit for source, unit in units.items() if unit}
    first = next(iter(given.values()), next(iter(UNITS[key.kind])))
    if key.kind == "time" and "_" not in first:
        first = f"{first}_{SCALES[0]}"
    for source, unit in given.items():
        if unit != first:
            raise InputError(
                f"two units of {key.name}: {source} says {unit}, {next(iter(given))} {first}", key=f"column {column}"
            )
    return first


def _unit_of_file(key: Key, stated: u.UnitBase | None, column: str) -> str | None:
    """Return a unit stated in a FITS or ECSV file as one of UNITS; None: no unit, or the day or second of a time."""
    if stated is None:
        return None
    kind = UNITS[key.kind]
    stated = u.Unit(str(stated), parse_strict="silent")  # FITS has no hourangle
    if key.kind == "time":
        if stated in (u.day, u.s):
            return None
    elif key.kind == "angle" and stated == u.hour:
        return "hour"
    else:
        for name, unit in kind.items():
            if unit is not None and stated == unit:
                return name
    raise InputError(
        f"a unit that does not fit {key.name}", key=f"column {column}", value=str(stated), allowed=", ".join(kind)
    )
