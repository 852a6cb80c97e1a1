"""Rows of a table that are parts of another row's object, each with its own shape and flux, at an offset from it.

    id, ra, dec, mag_r, type, size, part_of, offset_ra, offset_dec, part_share
    1, 10.0, -2.0, 21.0, galaxy, 0.5,,,,
    2,,,,galaxy, 0.2, 1, 0.3, -0.1, 0.25

Row 2 is a part of object 1: 0.3" east and 0.1" south of it, with a quarter of its flux, which is subtracted from row 1.
A part with its own magnitude adds its flux to that of the object. Offsets are on the sky before lensing. A part has its
object's lens, and its position and redshift where its own are blank. It moves as its object does. With a fraction of
the object's flux, it also varies as the object does. A part is selected, rendered and listed in the truth like an
object.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from csstsim.base.errors import InputError
from csstsim.base.sphere import frames, ra_dec
from csstsim.base.units import ARCSEC_PER_RAD
from csstsim.catalog.changing import columns as changing
from csstsim.catalog.table import STAR

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterable, Mapping, Sequence

    from csstsim.base.types import AnyArray, BoolArray, FloatArray, IntArray, PathLike

SHORTHANDS = {
    "offset_ra": "arcsec, to the east, of a part from the object it is of, before lensing",
    "offset_dec": "arcsec, to the north, the same",
    "part_share": "fraction of that object's flux, in all its bands; blank: the part has its own magnitudes",
}
FARTHEST = 3600.0  # arcsec
DARK = 89.0  # mag, of an object whose parts have all of its flux
_LENS = "kappa", "gamma1", "gamma2"


def resolve(
    columns: Mapping[str, AnyArray], obj_type: IntArray, bands: Collection[str], where: PathLike
) -> dict[str, AnyArray]:
    """Return columns {name: (n,) values} with position, lens and flux of parts filled in, and without SHORTHANDS.

    obj_type (n,). Raises InputError, which names `where`, the row and the object that it is a part of.
    """
    columns = dict(columns)
    ids = np.asarray(columns["id"])
    owner = np.asarray(columns.get("part_of", np.full(len(ids), -1)))
    no_part = np.isnan(owner) | (owner == -1)
    _check_no_parts(columns, owner, no_part, where)
    if "part_of" not in columns:
        return {name: values for name, values in columns.items() if name not in SHORTHANDS}
    exact = owner.dtype.kind in "iu"  # a column with blanks is of floats, which are exact for ids up to 2^53
    rows = np.flatnonzero(~no_part)
    inexact = rows[:0] if exact else rows[owner[rows] > 2**53]
    if len(inexact):
        first = inexact[0]
        message = "blanks in the column make this id inexact"
        allowed = "ids up to 2^53, or -1 in place of blanks"
        raise InputError(message, file=where, key=f"row {first + 1}: part_of", value=owner[first], allowed=allowed)
    owner = np.where(np.isfinite(owner), owner, -1).astype(np.int64)
    count = len(owner)
    offset = [
        np.nan_to_num(np.asarray(columns.pop(f"offset_{axis}", np.zeros(count)), float)) for axis in ("ra", "dec")
    ]
    fraction = np.asarray(columns.pop("part_share", np.full(count, np.nan)), float)
    columns["part_of"] = owner
    order = np.argsort(ids, kind="stable")
    owner_rows = order[np.minimum(np.searchsorted(ids[order], owner[rows]), count - 1)]

    def refuse(bad: BoolArray | np.bool_, message: str, **more: str) -> None:
        if np.any(bad):
            row = rows[np.flatnonzero(bad)[0]]
            raise InputError(f"row {row + 1}, a part of object {owner[row]}: {message}", file=where, **more)

    refuse(ids[owner_rows] != owner[rows], "there is no row with that id", key="part_of")
    refuse(columns["part_of"][owner_rows] >= 0, "that row is a part itself", key="part_of")
    refuse(obj_type[owner_rows] == STAR, "a star has no parts, for it moves", key="part_of")
    refuse(obj_type[rows] == STAR, "a part is a galaxy, or as a point a quasar", key="type")
    for name, value in zip(("offset_ra", "offset_dec"), offset, strict=True):
        refuse(~(np.abs(value[rows]) <= FARTHEST), f"is not within {FARTHEST:g} arcsec", key=name)
    located = np.isfinite([np.asarray(columns[axis], float)[rows] for axis in ("ra", "dec")])
    refuse(located.any(axis=0) & ~located.all(axis=0), "has only one of ra and dec", key="ra, dec")
    shifted = (offset[0][rows] != 0) | (offset[1][rows] != 0)
    refuse(located.any(axis=0) & shifted, "has both a position and an offset", key="offset_ra, offset_dec")
    given = ~np.isnan(fraction[rows])
    refuse(given & ~((fraction[rows] > 0) & (fraction[rows] <= 1)), "is not above 0 and up to 1", key="part_share")
    for name in (*_LENS, "z"):
        if name in columns:
            values = np.array(columns[name], float)
            values[rows] = np.where(np.isfinite(values[rows]), values[rows], values[owner_rows])
            columns[name] = values
    _copy_from_owner(columns, rows, owner_rows, given)
    _set_positions(columns, rows, owner_rows, offset)
    _divide_flux(columns, rows[given], owner_rows[given], fraction, bands, refuse, rows)
    return columns


def _copy_from_owner(
    columns: dict[str, AnyArray], rows: IntArray, owner_rows: IntArray, has_fraction: BoolArray
) -> None:
    """Give parts the motion of their objects, and those with a fraction of the flux its changes and its spectrum."""
    every = np.ones(len(rows), bool)
    for name, parts in [(n, every) for n in changing.MOTION] + [(n, has_fraction) for n in changing.LIGHT]:
        if name in columns:
            values = np.array(columns[name])
            values[rows[parts]] = values[owner_rows[parts]]
            columns[name] = values
    if "spectrum_file" in columns:  # the fractions are of one magnitude: in other bands the spectrum counts
        files = np.array(columns["spectrum_file"])
        blank = has_fraction & (files[rows] == "")
        files[rows[blank]] = files[owner_rows[blank]]
        columns["spectrum_file"] = files


def _set_positions(
    columns: dict[str, AnyArray], rows: IntArray, owner_rows: IntArray, offset: Sequence[FloatArray]
) -> None:
    """Fill in ra, dec of parts: the position of the object plus the lensed offset."""
    count = len(owner_rows)
    lens = [
        np.nan_to_num(np.asarray(columns[name], float)[owner_rows]) if name in columns else np.zeros(count)
        for name in _LENS
    ]
    kappa, gamma1, gamma2 = lens
    determinant = (1 - kappa) ** 2 - gamma1**2 - gamma2**2
    determinant = np.where(determinant > 0, determinant, 1.0)  # strong lensing is refused or flagged elsewhere
    dx = offset[0][rows]
    dy = offset[1][rows]
    east = ((1 - kappa + gamma1) * dx + gamma2 * dy) / determinant
    north = (gamma2 * dx + (1 - kappa - gamma1) * dy) / determinant
    ra = np.array(columns["ra"], float)
    dec = np.array(columns["dec"], float)
    centre, to_east, to_north = frames(np.radians(ra[owner_rows]), np.radians(dec[owner_rows]))
    moved = centre + (east[:, None] * to_east + north[:, None] * to_north) / ARCSEC_PER_RAD
    located = np.isfinite(ra[rows]) & np.isfinite(dec[rows])
    ra[rows], dec[rows] = (np.where(located, v[rows], p) for v, p in zip((ra, dec), ra_dec(moved), strict=True))
    columns["ra"] = ra
    columns["dec"] = dec


def _check_no_parts(columns: Mapping[str, AnyArray], owner: AnyArray, no_part: BoolArray, where: PathLike) -> None:
    """Raise InputError for a part_of that is neither an id nor a blank, and for columns of parts in other rows."""
    with np.errstate(invalid="ignore"):
        odd = ~no_part & ~(np.isfinite(owner) & (owner >= 0) & (owner == np.floor(owner)))
    faults = [("part_of", odd, "is not an id", "an id, or a blank or -1: not a part")]
    for name in SHORTHANDS:
        values = np.asarray(columns.get(name, np.zeros(len(owner))), float)
        given = ~np.isnan(values) & ((values != 0) | (name == "part_share") & (name in columns))
        faults.append((name, no_part & given, "is for parts, but part_of is blank in this row", "a blank"))
    for name, bad, message, allowed in faults:
        if bad.any():
            row = np.flatnonzero(bad)[0]
            value = np.asarray(owner if name == "part_of" else columns[name])[row].item()
            raise InputError(f"row {row + 1}: {message}", file=where, key=name, value=value, allowed=allowed)


def _divide_flux(
    columns: dict[str, AnyArray],
    rows: IntArray,
    owner_rows: IntArray,
    fraction: FloatArray,
    bands: Iterable[str],
    refuse: Callable[..., None],
    all_rows: IntArray,
) -> None:
    """Set the magnitudes of parts with a fraction, and subtract their flux from their objects."""
    if not len(rows):
        return
    total = np.zeros(len(fraction))
    np.add.at(total, owner_rows, fraction[rows])
    too_much = np.isin(all_rows, rows[total[owner_rows] > 1 + 1e-6])
    refuse(too_much, "the fractions of its object's parts exceed 1", key="part_share")
    owners = np.unique(owner_rows)
    with np.errstate(divide="ignore"):
        fainter = -2.5 * np.log10(np.clip(1 - total[owners], 0.0, 1.0))
    for name in (f"mag_{band}" for band in bands if f"mag_{band}" in columns):
        mags = np.array(columns[name], float)
        refuse(np.isin(all_rows, rows[np.isfinite(mags[rows])]), "has both a magnitude and part_share", key=name)
        mags[rows] = mags[owner_rows] - 2.5 * np.log10(fraction[rows])
        mags[owners] = np.minimum(mags[owners] + fainter, DARK)
        columns[name] = mags
