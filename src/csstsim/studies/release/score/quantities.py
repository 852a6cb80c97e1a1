"""The quantities and units of a catalogue: the keys of `csstsim release score --map KEY=COLUMN`.

A key is the name of a quantity, followed by its unit unless that is the first of its kind: `ra`, `ra_hour`,
`flux_r_njy`, `pa_rad`. B stands for a band.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from astropy import units as u

from csstsim.base.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from csstsim.base.types import FloatArray

UNITS: dict[str, dict[str, u.UnitBase | None]] = {
    "angle": {"deg": u.deg, "hour": u.hourangle, "rad": u.rad},
    "flux": {"ujy": u.uJy, "njy": u.nJy, "mjy": u.mJy, "jy": u.Jy},
    "ellipticity": {"g": None, "chi": None},  # (a - b) / (a + b), (a2 - b2) / (a2 + b2)
    "number": {},
}
NOT_AB = "mag(st)", "stmag", "vegamag", "mag(bol)"
KINDS = {
    "ra": "angle", "dec": "angle", "pa": "angle", "e1": "ellipticity", "e2": "ellipticity", "a": "number",
    "b": "number", "q": "number", "z": "number", "mag_B": "number", "flux_B": "flux",
}  # fmt: skip
ABOUT = {
    "ra": "right ascension, ICRS",
    "dec": "declination, ICRS",
    "mag_B": "AB magnitude in band B",
    "flux_B": "flux in band B, in place of mag_B",
    "z": "redshift",
    "e1": "ellipticity (a - b) / (a + b), axis 1 along east",
    "e2": "the same, axis 2 at 45 deg towards north",
    "a": "major axis, with b and pa in place of e1, e2; any unit",
    "b": "minor axis, in the unit of a",
    "q": "b / a, in place of a and b",
    "pa": "position angle of the major axis, north through east",
}


@dataclass(frozen=True)
class Key:
    """A quantity, its band ("" if it has none) and the unit that the key names, or None."""

    name: str
    band: str
    unit: str | None

    @property
    def full_name(self) -> str:
        """The name with its band: mag_r."""
        return f"{self.name[:-1]}{self.band}" if self.band else self.name


def parse_key(text: str, bands: Sequence[str], option: str = "--map") -> Key:
    """Return the Key of a text. Raises InputError, with `option`, for an unknown quantity, band or unit."""
    for name, kind in KINDS.items():
        for band in bands if name.endswith("_B") else ("",):
            full_name = f"{name[:-1]}{band}" if band else name
            if text == full_name:
                return Key(name, band, None)
            if text.startswith(f"{full_name}_") and text[len(full_name) + 1 :] in UNITS[kind]:
                return Key(name, band, text[len(full_name) + 1 :])
    names = ", ".join(KINDS)
    units = "; ".join(f"{kind}: {', '.join(known)}" for kind, known in UNITS.items() if known)
    allowed = f"{names} (B: {', '.join(bands)}), with _UNIT at the end ({units})"
    raise InputError("unknown quantity, band or unit", key=option, value=text, allowed=allowed)


def to_first_unit(values: FloatArray, key: Key, stated_unit: u.UnitBase | None, column: str) -> FloatArray:
    """Return a column's numbers (n,) in the first unit of their kind. Raises InputError for a unit that does not fit.

    stated_unit: astropy unit of the column in the file, or None.
    """
    units = UNITS[KINDS[key.name]]
    if key.name == "mag_B" and str(stated_unit).lower() in NOT_AB:
        raise InputError("magnitudes are AB", key=f"column {column}", value=str(stated_unit), allowed="mag, mag(AB)")
    first_name = next(iter(units), None)
    name = key.unit
    if stated_unit is not None and KINDS[key.name] in ("angle", "flux"):
        stated_name = next((word for word, unit in units.items() if unit == stated_unit), None)
        if name and stated_name != name:
            raise InputError(
                f"the file has the unit {stated_unit}, the key {name}", key=f"column {column}", value=key.full_name
            )
        if stated_name is None:
            raise InputError(
                f"a unit that does not fit {key.full_name}",
                key=f"column {column}",
                value=str(stated_unit),
                allowed=", ".join(units),
            )
        name = stated_name
    if name is None or first_name is None or name == first_name:
        return values
    unit = units[name]
    if unit is None:
        return values  # chi: both components are needed, see `shapes`
    return (values * unit).to_value(units[first_name])


def ab_magnitude(flux: FloatArray) -> FloatArray:
    """Return AB magnitudes of fluxes [microjansky]; NaN where they are not positive."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(flux > 0, 23.9 - 2.5 * np.log10(flux), np.nan)


def shapes(columns: Mapping[str, FloatArray], chi: bool) -> tuple[FloatArray, FloatArray] | None:
    """Return e1, e2 (n,) in (a - b) / (a + b), or None. columns: {quantity: (n,)}.

    chi: whether e1 and e2 are (a2 - b2) / (a2 + b2).
    """
    if {"e1", "e2"} <= set(columns):
        e = columns["e1"] + 1j * columns["e2"]
        size = np.abs(e)
        with np.errstate(invalid="ignore"):
            factor = 1.0 / (1.0 + np.sqrt(1.0 - size**2)) if chi else np.ones(len(size))
        return (e * factor).real, (e * factor).imag
    if "pa" not in columns or not ("q" in columns or {"a", "b"} <= set(columns)):
        return None
    with np.errstate(divide="ignore", invalid="ignore"):
        q = columns["q"] if "q" in columns else columns["b"] / columns["a"]
    # pa is measured from north and the first axis is east, so the angle from the first axis is 90 deg - pa
    angle = np.radians(90.0 - columns["pa"])
    e = (1.0 - q) / (1.0 + q)
    return e * np.cos(2 * angle), e * np.sin(2 * angle)
