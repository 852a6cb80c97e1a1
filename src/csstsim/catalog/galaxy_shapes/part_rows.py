"""Rows of a table that are parts of another row's object: each with its own shape and light, placed by an offset.

    id, ra, dec, mag_r, type, size, part_of, offset_ra, offset_dec, part_share
    1, 10.0, -2.0, 21.0, galaxy, 0.5,,,,
    2,,,,galaxy, 0.2, 1, 0.3, -0.1, 0.25

Row 2 is a part of object 1: 0.3" east and 0.1" south of it, with a quarter of its light, which row 1 no longer has. A
part with a magnitude of its own adds its light to that of the object. Offsets are on the sky before lensing; a part has
its object's lens, and its place and redshift where its own are blank. It moves as its object does, and with a share of
the light it varies as that does. A part is drawn, selected and listed in the truth
as an object is.
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
    "part_share": "share of that object's light, in all its bands; blank: the part has its own magnitudes",
}
FARTHEST = 3600.0  # arcsec
DARK = 89.0  # mag, of an object that has given all of its light away
_LENS = "kappa", "gamma1", "gamma2"


def resolve(
    columns: Mapping[str, AnyArray], obj_type: IntArray, bands: Collection[str], where: PathLike
) -> dict[str, AnyArray]:
    """Return columns {name: (n,) values} with place, lens and light of parts filled in, and without SHORTHANDS.

    obj_type (n,). Raises InputError, which names `where`, the row and the object that it is a part of.
    """
    columns = dict(columns)
    ids = np.asarray(columns["id"])
    of = np.asarray(columns.get("part_of", np.full(len(ids), -1)))
    none = np.isnan(of) | (of == -1)
    _refuse_strangers(columns, of, none, where)
    if "part_of" not in columns:
        return {name: values for name, values in columns.items() if name not in SHORTHANDS}
    exact = of.dtype.kind in "iu"  # a column with blanks is of floats, which hold ids to 2^53 only
    rows = np.flatnonzero(~none)
    wide = rows[:0] if exact else rows[of[rows] > 2**53]
    if len(wide):
        message = "blanks in the column make this id inexact"
        allowed = "ids up to 2^53, or -1 in place of blanks"
        raise InputError(message, file=where, key=f"row {wide[0] + 1}: part_of", value=of[wide[0]], allowed=allowed)
    of = np.where(np.isfinite(of), of, -1).astype(np.int64)
    count = len(of)
    offset = [
        np.nan_to_num(np.asarray(columns.pop(f"offset_{axis}", np.zeros(count)), float)) for axis in ("ra", "dec")
    ]
    share = np.asarray(columns.pop("part_share", np.full(count, np.nan)), float)
    columns["part_of"] = of
    order = np.argsort(ids, kind="stable")
    at = order[np.minimum(np.searchsorted(ids[order], of[rows]), count - 1)]

    def refuse(bad: BoolArray | np.bool_, message: str, **more: str) -> None:
        if np.any(bad):
            row = rows[np.flatnonzero(bad)[0]]
            raise InputError(f"row {row + 1}, a part of object {of[row]}: {message}", file=where, **more)

    refuse(ids[at] != of[rows], "there is no row of that id", key="part_of")
    refuse(columns["part_of"][at] >= 0, "that row is a part itself", key="part_of")
    refuse(obj_type[at] == STAR, "a star has no parts, for it moves", key="part_of")
    refuse(obj_type[rows] == STAR, "a part is a galaxy, or as a point a quasar", key="type")
    for name, value in zip(("offset_ra", "offset_dec"), offset, strict=True):
        refuse(~(np.abs(value[rows]) <= FARTHEST), f"is not within {FARTHEST:g} arcsec", key=name)
    own = np.isfinite([np.asarray(columns[axis], float)[rows] for axis in ("ra", "dec")])
    refuse(own.any(axis=0) & ~own.all(axis=0), "has only one of ra and dec", key="ra, dec")
    aside = (offset[0][rows] != 0) | (offset[1][rows] != 0)
    refuse(own.any(axis=0) & aside, "has both a place and an offset", key="offset_ra, offset_dec")
    given = ~np.isnan(share[rows])
    refuse(given & ~((share[rows] > 0) & (share[rows] <= 1)), "is not above 0 and up to 1", key="part_share")
    for name in (*_LENS, "z"):
        if name in columns:
            own = np.array(columns[name], float)
            own[rows] = np.where(np.isfinite(own[rows]), own[rows], own[at])
            columns[name] = own
    _follow(columns, rows, at, given)
    _place(columns, rows, at, offset)
    _share_light(columns, rows[given], at[given], share, bands, refuse, rows)
    return columns


def _follow(columns: dict[str, AnyArray], rows: IntArray, at: IntArray, shared: BoolArray) -> None:
    """Give parts the motion of their objects, and those that have a share of the light its changes and its spectrum."""
    for name, some in [(n, np.ones(len(rows), bool)) for n in changing.MOTION] + [(n, shared) for n in changing.LIGHT]:
        if name in columns:
            values = np.array(columns[name])
            values[rows[some]] = values[at[some]]
            columns[name] = values
    if "spectrum_file" in columns:  # the shares are of one magnitude: in other bands the spectrum decides
        files = np.array(columns["spectrum_file"])
        blank = shared & (files[rows] == "")
        files[rows[blank]] = files[at[blank]]
        columns["spectrum_file"] = files


def _place(columns: dict[str, AnyArray], rows: IntArray, at: IntArray, offset: Sequence[FloatArray]) -> None:
    """Fill in ra, dec of parts: that of the object plus the offset, as its lens shows it."""
    lens = [
        np.nan_to_num(np.asarray(columns[name], float)[at]) if name in columns else np.zeros(len(at)) for name in _LENS
    ]
    kappa, gamma1, gamma2 = lens
    determinant = (1 - kappa) ** 2 - gamma1**2 - gamma2**2
    determinant = np.where(determinant > 0, determinant, 1.0)  # strong lensing is refused, or flagged, as of any row
    dx = offset[0][rows]
    dy = offset[1][rows]
    east = ((1 - kappa + gamma1) * dx + gamma2 * dy) / determinant
    north = (gamma2 * dx + (1 - kappa - gamma1) * dy) / determinant
    ra = np.array(columns["ra"], float)
    dec = np.array(columns["dec"], float)
    centre, to_east, to_north = frames(np.radians(ra[at]), np.radians(dec[at]))
    moved = centre + (east[:, None] * to_east + north[:, None] * to_north) / ARCSEC_PER_RAD
    own = np.isfinite(ra[rows]) & np.isfinite(dec[rows])
    placed = ra_dec(moved)
    ra[rows], dec[rows] = (np.where(own, v[rows], p) for v, p in zip((ra, dec), placed, strict=True))
    columns["ra"] = ra
    columns["dec"] = dec


def _refuse_strangers(columns: Mapping[str, AnyArray], of: AnyArray, none: BoolArray, where: PathLike) -> None:
    """Raise InputError for a part_of that is neither an id nor a blank, and for what only parts have in other rows."""
    with np.errstate(invalid="ignore"):
        odd = ~none & ~(np.isfinite(of) & (of >= 0) & (of == np.floor(of)))
    faults = [("part_of", odd, "is not an id", "an id, or a blank or -1: not a part")]
    for name in SHORTHANDS:
        values = np.asarray(columns.get(name, np.zeros(len(of))), float)
        given = ~np.isnan(values) & ((values != 0) | (name == "part_share") & (name in columns))
        faults.append((name, none & given, "is of a part, and the row is none: part_of is blank", "a blank"))
    for name, bad, message, allowed in faults:
        if bad.any():
            row = np.flatnonzero(bad)[0]
            value = np.asarray(of if name == "part_of" else columns[name])[row].item()
            raise InputError(f"row {row + 1}: {message}", file=where, key=name, value=value, allowed=allowed)


def _share_light(
    columns: dict[str, AnyArray],
    rows: IntArray,
    at: IntArray,
    share: FloatArray,
    bands: Iterable[str],
    refuse: Callable[..., None],
    all_rows: IntArray,
) -> None:
    """Give parts with a share their magnitudes, and take that light from their objects."""
    if not len(rows):
        return
    total = np.zeros(len(share))
    np.add.at(total, at, share[rows])
    refuse(np.isin(all_rows, rows[total[at] > 1 + 1e-6]), "the shares of its object's parts exceed 1", key="part_share")
    givers = np.unique(at)
    with np.errstate(divide="ignore"):
        fainter = -2.5 * np.log10(np.clip(1 - total[givers], 0.0, 1.0))
    for name in (f"mag_{band}" for band in bands if f"mag_{band}" in columns):
        mags = np.array(columns[name], float)
        refuse(np.isin(all_rows, rows[np.isfinite(mags[rows])]), "has both a magnitude and part_share", key=name)
        mags[rows] = mags[at] - 2.5 * np.log10(share[rows])
        mags[givers] = np.minimum(mags[givers] + fainter, DARK)
        columns[name] = mags
