"""What a catalogue may state, and in which units: the keys of `csstsim release score --map KEY=COLUMN`.

A key is a quantity's name, then, if it is not the first of its kind, the unit: `ra`, `ra_hour`, `flux_r_njy`, `pa_rad`.
B stands for a band.
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
    """A quantity, its band ("" if it has none) and the unit that a key says, or None."""

    name: str
    band: str
    unit: str | None

    @property
    def whole(self) -> str:
        """The name with its band: mag_r."""
        return f"{self.name[:-1]}{self.band}" if self.band else self.name


def parse_key(text: str, bands: Sequence[str], place: str = "--map") -> Key:
    """Return the Key that a text names. Raises InputError for an unknown quantity, band or unit."""
    for name, kind in KINDS.items():
        for band in bands if name.endswith("_B") else ("",):
            whole = f"{name[:-1]}{band}" if band else name
            if text == whole:
                return Key(name, band, None)
            if text.startswith(f"{whole}_") and text[len(whole) + 1 :] in UNITS[kind]:
                return Key(name, band, text[len(whole) + 1 :])
    names = ", ".join(KINDS)
    units = "; ".join(f"{kind}: {', '.join(known)}" for kind, known in UNITS.items() if known)
    allowed = f"{names} (B: {', '.join(bands)}), with _UNIT at the end ({units})"
    raise InputError("unknown quantity, band or unit", key=place, value=text, allowed=allowed)


def in_our_unit(values: FloatArray, key: Key, stated: u.UnitBase | None, column: str) -> FloatArray:
    """Return a column's numbers (n,) in the first unit of their kind. Raises InputError for a unit that does not fit.

    stated: astropy unit that the file gives the column, or None.
    """
    known = UNITS[KINDS[key.name]]
    if key.name == "mag_B" and str(stated).lower() in NOT_AB:
        raise InputError("magnitudes are AB", key=f"column {column}", value=str(stated), allowed="mag, mag(AB)")
    first = next(iter(known), None)
    said = key.unit
    if stated is not None and KINDS[key.name] in ("angle", "flux"):
        named = next((word for word, unit in known.items() if unit == stated), None)
        if said and named != said:
            raise InputError(f"the file says {stated}, the key {said}", key=f"column {column}", value=key.whole)
        if named is None:
            raise InputError(
                f"a unit that does not fit {key.whole}",
                key=f"column {column}",
                value=str(stated),
                allowed=", ".join(known),
            )
        said = named
    if said is None or first is None or said == first:
        return values
    unit = known[said]
    if unit is None:
        return values  # chi: both components are needed, see `shapes`
    return (values * unit).to_value(known[first])


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
    # pa counts from north, the first axis is east: an axis at pa has an angle of 90 deg - pa from it
    angle = np.radians(90.0 - columns["pa"])
    e = (1.0 - q) / (1.0 + q)
    return e * np.cos(2 * angle), e * np.sin(2 * angle)
