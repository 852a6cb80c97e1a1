"""Columns of objects that change with time; without them, objects are constant."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import ArrayLike

    from csstsim.base.types import AnyArray, BoolArray
    from csstsim.catalog.table import ColumnKind, ObjectTable

MOTION: dict[str, ColumnKind] = {
    "rate_ra": (np.float64, 0.0, "arcsec / hour, motion on the sky as seen from the telescope, includes cos(dec)"),
    "rate_dec": (np.float64, 0.0, "arcsec / hour"),
    "rate_mjd": (np.float64, np.nan, "MJD, UTC, at which the object is at ra, dec; needed with a rate"),
    "trail_width": (
        np.float64,
        0.0,
        "arcsec, full width of a satellite's track before the PSF, as of a disc out of focus",
    ),
}
LIGHT: dict[str, ColumnKind] = {
    "var_period": (np.float64, np.nan, "day, of a periodic change of the magnitude"),
    "var_amplitude": (np.float64, 0.0, "mag, half the range of the periodic change: a sine about the given magnitude"),
    "var_phase": (np.float64, 0.0, "turns, of the sine at MJD 0 (UTC)"),
    "light_curve": (str, "", "name of a curve in the file of the option `light_curves`"),
}
COLUMNS = MOTION | LIGHT
UNITS = {
    **dict.fromkeys(("rate_ra", "rate_dec"), "arcsec / h"),
    "rate_mjd": "d",
    "trail_width": "arcsec",
    "var_period": "d",
    "var_amplitude": "mag",
}
# arcsec, mag, arcsec / hour, day
MAX_TRAIL_WIDTH = 60.0
MAX_AMPLITUDE = 30.0
MAX_RATE = 1e8
MAX_MJD = 1e6
TRACK_RATE = 216_000.0  # arcsec / hour, 1 arcmin / s: only what is faster may have a width


def completed(columns: Mapping[str, ArrayLike], count: int) -> dict[str, AnyArray]:
    """Return {name: (count,) values} of the columns of COLUMNS among `columns`, in their types, blanks at the default.

    If one of MOTION is given, all of them are returned.
    """
    given = {name: columns[name] for name in COLUMNS if name in columns}
    if set(given) & set(MOTION):
        given = {name: default for name, (_, default, _) in MOTION.items()} | given
    full = {}
    for name, values in given.items():
        dtype, default, _ = COLUMNS[name]
        if dtype is str:
            full[name] = np.array(np.broadcast_to(_names(np.asarray(values)), count))
            continue
        values = np.array(np.broadcast_to(values, count), dtype=dtype)
        full[name] = values if np.isnan(default) else np.where(np.isnan(values), default, values)
    return full


def _names(values: AnyArray) -> AnyArray:
    """Return names as text. Numbers are written as integers if a column with blanks made floats of them."""
    if values.dtype.kind != "f":
        return values.astype(str)
    text = ("" if v != v else str(int(v)) if v.is_integer() else repr(v) for v in np.atleast_1d(values).tolist())
    return np.array(list(text), dtype=str)


def moves(table: ObjectTable) -> BoolArray:
    """Return (n,) bool: the objects of a table with a rate of motion on the sky."""
    if "rate_ra" not in table:
        return np.zeros(len(table), bool)
    return np.hypot(table["rate_ra"], table["rate_dec"]) > 0


def reasons(table: ObjectTable) -> dict[str, BoolArray]:
    """Return {reason: (n,) bool} for which an object of a table cannot be rendered."""
    found = {}
    if "rate_ra" in table:
        speed = np.hypot(table["rate_ra"], table["rate_dec"])
        found["rate_ra or rate_dec is not finite"] = ~np.isfinite(speed)
        found["a rate of motion without rate_mjd"] = (speed > 0) & ~np.isfinite(table["rate_mjd"])
        width = table["trail_width"]
        found[f"trail_width is not within 0..{MAX_TRAIL_WIDTH:g} arcsec"] = ~((width >= 0) & (width <= MAX_TRAIL_WIDTH))
        found[f"a rate of motion above {MAX_RATE:g} arcsec / hour"] = speed > MAX_RATE
        found[f"rate_mjd is beyond {MAX_MJD:g}"] = np.abs(table["rate_mjd"]) > MAX_MJD
        found["a trail_width, but slower than 1 arcmin / s: widths are for satellites"] = (width > 0) & (
            speed < TRACK_RATE
        )
    period, size = (table.get(name, np.zeros(len(table))) for name in ("var_period", "var_amplitude"))
    found["a var_amplitude without a var_period above 0"] = (size != 0) & ~(period > 0)
    found["var_phase is not finite"] = ~np.isfinite(table.get("var_phase", np.zeros(len(table))))
    found[f"var_amplitude is not within 0..{MAX_AMPLITUDE:g} mag"] = ~((size >= 0) & (size <= MAX_AMPLITUDE))
    return found
