"""Columns of the tables that contain a spectrum or a sensitivity, in csstsim's units."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from csstsim.base.errors import InputError

if TYPE_CHECKING:
    from astropy.table import Column, Table

    from csstsim.base.types import FloatArray

# Units of CALSPEC's files, by the names of pysynphot and synphot, in lower case
SYNPHOT_UNITS = {
    "angstroms": "AA",
    "nanometers": "nm",
    "microns": "um",
    "flam": "erg / (s cm2 AA)",
    "fnu": "erg / (s cm2 Hz)",
    "photlam": "photon / (s cm2 AA)",
    "photnu": "photon / (s cm2 Hz)",
    "jy": "Jy",
    "mjy": "mJy",
    "abmag": "mag(AB)",
    "stmag": "mag(ST)",
}


def read_columns(table: Table, name: str, where: str) -> tuple[FloatArray, FloatArray]:
    """Return WAVELENGTH [A] and `name` (FLUX or SENSITIVITY) of the table a user's method returned, in csstsim's units.

    Both are float64 and of one length. `where` begins the message. Raises InputError for anything not of that form.
    """
    try:
        wave = np.round(_plain(table["WAVELENGTH"], "AA"), 6)  # so that 1100 nm is exactly 11000 A
        values = _plain(table[name], "photon / (s m2 AA)" if name == "FLUX" else None, wave)
    except ValueError as exc:  # no numbers, or a unit that astropy cannot convert
        raise InputError(f"WAVELENGTH or {name} cannot be used: {exc}", key=where) from None
    except (KeyError, TypeError, IndexError):
        raise InputError(f"must return a table with the columns WAVELENGTH and {name}", key=where) from None
    if wave.ndim != 1 or len(wave) < 2 or wave.shape != values.shape or not (np.diff(wave) > 0).all():
        raise InputError("WAVELENGTH must rise and match its column in length", key=where)
    if not wave[0] > 0:
        raise InputError("WAVELENGTH must be above 0", key=where, value=float(wave[0]))
    return wave, values


def _plain(column: Column, unit: str | None, wave: FloatArray | None = None) -> FloatArray:
    """Return a column as a float array, masked values as NaN; in `unit` if both are given."""
    numbers = getattr(column, "value", column)  # of a Quantity
    values: FloatArray = np.ma.filled(np.ma.asarray(numbers, dtype=float), np.nan)
    column_unit = getattr(column, "unit", None)
    if column_unit is None or unit is None:
        return values
    from astropy import units as u

    per_wave = u.spectral_density(wave * u.AA) if wave is not None else []
    return (values * u.Unit(SYNPHOT_UNITS.get(str(column_unit).lower(), column_unit))).to_value(unit, per_wave)
