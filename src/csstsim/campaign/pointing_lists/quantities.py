"""The quantities of a list of pointings, and the units in which a list may state them.

A key is a quantity's name, then, if it is not the first of its kind, the unit: `ra`, `ra_hour`, `time_jd`,
`time_mjd_tai`. Words (obsid, type, deep) have none.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from astropy import units as u

from csstsim.base.errors import InputError

if TYPE_CHECKING:
    from csstsim.base.types import PathLike

# The units of each kind, the first where none is said; None: text that is parsed
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
SCALES = "utc", "tai", "tt", "tdb"  # may follow the form of a time; the first where none is said
PLACES = {"equator": ("ra", "dec"), "ecliptic": ("ecl_lon", "ecl_lat"), "galactic": ("gal_lon", "gal_lat")}
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
    **{name: "angle" for pair in PLACES.values() for name in pair},
    "pa": "angle",
    **dict.fromkeys(STATE[:3], "length"),
    **dict.fromkeys(STATE[3:], "speed"),
    **{f"{body}_angle": "angle" for body in BODIES},
    **{f"{body}_{axis}": "length" for body in BODIES for axis in "xyz"},
}


@dataclass(frozen=True)
class Key:
    """A quantity and the unit that a key, a list or a column's name says; None: not said."""

    name: str
    unit: str | None

    @property
    def kind(self) -> str:
        """One of UNITS."""
        return KINDS[self.name]


def parse_key(text: str, file: PathLike | None = None, place: str | None = None) -> Key:
    """Return the Key that a mapping's text names. Raises InputError for an unknown quantity or unit.

    file, place: where it is said, for the message.
    """
    known = [name for name in KINDS if text == name or text.startswith(f"{name}_")]
    if not known:
        time = f"; a time in this form: time_{text}" if _unit("time", text) else ""
        raise InputError("unknown quantity", file=file, key=place, value=text, allowed=", ".join(KINDS) + time)
    name = max(known, key=len)
    suffix = text[len(name) + 1 :]
    if not suffix:
        return Key(name, None)
    unit = _unit(KINDS[name], suffix)
    if unit is None:
        kind = UNITS[KINDS[name]]
        allowed = ", ".join(f"{name}_{unit}" for unit in kind) or f"{name}, which has no unit"
        if KINDS[name] == "time":
            allowed += f"; a scale may follow: {', '.join(SCALES)}"
        raise InputError("unknown unit", file=file, key=place or name, value=suffix, allowed=allowed)
    return Key(name, unit)


def _unit(kind: str, suffix: str) -> str | None:
    """Return the unit that a suffix names, or None; of a time, form and scale, as `mjd_tai`."""
    if kind != "time":
        return suffix if suffix in UNITS[kind] else None
    form, _, scale = ("iso", "", suffix) if suffix in SCALES else suffix.partition("_")
    return f"{form}_{scale or SCALES[0]}" if form in UNITS[kind] and scale in (*SCALES, "") else None


def unit_of(key: Key, column: str, stated: u.UnitBase | None) -> str | None:
    """Return the unit of a column: what the key says, the list (`stated`, an astropy unit) or the column's name.

    The first of its kind if none does. Raises InputError if two differ, or the list's is of another kind.
    """
    if key.kind == "words":
        return None
    words = column.lower().split("_")
    named = [unit for k in range(len(words)) if (unit := _unit(key.kind, "_".join(words[k:])))]
    said: dict[str, str | None] = {
        "the mapping": key.unit,
        "the list": _of_list(key, stated, column),
        "the column's name": None,
    }
    if named and (not key.unit if key.kind == "time" else len(words) > 1):  # MJD may be of any scale
        said["the column's name"] = named[0]
    given = {who: unit for who, unit in said.items() if unit}
    first = next(iter(given.values()), next(iter(UNITS[key.kind])))
    if key.kind == "time" and "_" not in first:
        first = f"{first}_{SCALES[0]}"
    for who, unit in given.items():
        if unit != first:
            raise InputError(
                f"two units of {key.name}: {who} says {unit}, {next(iter(given))} {first}", key=f"column {column}"
            )
    return first


def _of_list(key: Key, stated: u.UnitBase | None, column: str) -> str | None:
    """Return the unit that a FITS or ECSV file states as one of UNITS; None: it states none, or a time's day."""
    if stated is None:
        return None
    kind = UNITS[key.kind]
    stated = u.Unit(str(stated), parse_strict="silent")  # FITS knows no hourangle
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
