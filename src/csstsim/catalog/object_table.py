"""Reading and checking a user's table of objects: columns, units, blanks, placeholder numbers.

Every fault is an InputError that names the table, the column and the row. Nothing in the table is ignored or
reinterpreted silently: a column of another name without a single number or word per row is omitted with a warning.
"""

from __future__ import annotations

import csv
import logging
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from csstsim.base.astropy_values import is_sky_coord, is_time, position_columns
from csstsim.base.errors import InputError, first_line
from csstsim.base.files.fits_headers import check_headers
from csstsim.base.files.text_file import read_text
from csstsim.base.help_page import explained
from csstsim.catalog.changing import columns as changing
from csstsim.catalog.galaxy_shapes import part_rows
from csstsim.catalog.galaxy_shapes.unsupported_shapes import check_shapes
from csstsim.catalog.misspelt import closest_name
from csstsim.catalog.row_files import check_spectra, file_paths, with_images
from csstsim.catalog.selection.renderable import STRONGLY_LENSED, reasons
from csstsim.catalog.table import COLUMNS, FILE_COLUMNS, GALAXY, OPTIONAL, STAR, TYPES, ObjectTable, columns_with

if TYPE_CHECKING:
    from collections.abc import Collection, Mapping

    import pyarrow as pa
    from astropy.table import Column, Table
    from astropy.units import UnitBase
    from numpy.typing import ArrayLike

    from csstsim.base.types import AnyArray, IntArray, PathLike

FORMATS = {".csv": "ascii.csv", ".ecsv": "ascii.ecsv", ".fits": "fits", ".parquet": "parquet"}
# redshift; km/s; mas, ten times the nearest star
FARTHEST = 1e3
LIGHT_KM_S = 299792.458
NEAREST_MAS = 1e4
LARGE = 200_000_000  # bytes of a text from which reading it takes minutes, and tens of times as much memory
# mag; -99, -9.99, 99, 99.99 and the like stand for "not known" in many catalogues
BRIGHTEST = -3.0
FAINTEST = 90.0
_LARGEST_ID = np.iinfo(np.int64).max
_EXACT = 2.0**53  # larger whole numbers are no floats
FASTEST = 1e6  # mas / yr; Barnard's star has 1e4
_KNOWN = {*COLUMNS, *OPTIONAL, *changing.COLUMNS, *part_rows.SHORTHANDS, "type", "size", "n"}
# Names that users type: similar ones count as misspelt. Magnitudes are added.
_TYPED = {
    "ra", "dec", "type", "size", "size_disk", "size_bulge", "bulge_frac", "e1", "e2", "n_disk", "n_bulge", "knots_frac",
    "part_of", "part_share", "image_file", "spectrum_file", *changing.COLUMNS,
}  # fmt: skip
_SEPARATORS = {";": "semicolons", "\t": "tabs", "|": "bars"}
_WORDS = "type", "light_curve", "curve", *FILE_COLUMNS  # columns of text
_FILLED = {
    "e1", "e2", "bulge_frac", "z", "size_disk", "size_bulge", "kappa", "gamma1", "gamma2", "host", "satellite",
    "gal_type",
}  # fmt: skip
_UNITS = {
    **dict.fromkeys(("ra", "dec"), "deg"),
    **dict.fromkeys(("size", "size_disk", "size_bulge"), "arcsec"),
    **dict.fromkeys(("pmra", "pmdec"), "mas / yr"),
    "parallax": "mas",
    "rv": "km / s",
    "teff": "K",
    "av": "mag",
    **changing.UNITS,
}


@explained("table of objects")
def read_table(path: PathLike) -> dict[str, AnyArray]:
    """Return {name: (n,) values} of a table's file, blanks as NaN or "". Raises InputError if it is not a table."""
    from astropy.io.ascii import convert_numpy
    from astropy.table import Table

    path = Path(path)
    if path.suffix.lower() not in FORMATS:
        raise InputError("unknown kind of table", file=path, key="catalog.options.file", allowed=", ".join(FORMATS))
    form = FORMATS[path.suffix.lower()]
    if form == "parquet":
        return _read_parquet(path)
    words: dict[str, Any] = {}
    if form == "fits":
        check_headers(path)
    else:
        if path.is_file() and path.stat().st_size > LARGE:
            allowed = f"the same table as .fits or .parquet, or a text of less than {LARGE // 10**6} MB"
            raise InputError(
                "too large for a table of text",
                file=path,
                key="catalog.options.file",
                value=f"{path.stat().st_size // 10**6} MB",
                allowed=allowed,
            )
        lines = read_text(path, "utf-8-sig").splitlines()  # with or without Excel's byte-order mark
        if not any(line.strip() for line in lines):
            raise InputError("the table is empty: no heading", file=path)
        if form == "ascii.csv":
            lines = _without_comments(lines)
            _check_csv([line for line in lines if line.strip()], path)
    if form == "ascii.csv":  # whose reader takes names that begin with inf or nan for numbers
        words["converters"] = {name: [convert_numpy(str)] for name in _WORDS}
    try:
        table = _fits_table(path) if form == "fits" else Table.read(lines, format=form, **words)
        return plain_columns(table, path)
    except InputError:
        raise
    except Exception as exc:  # astropy's readers raise exceptions of many types
        raise InputError(f"not a table that can be read: {first_line(exc)}", file=path) from None


def _read_parquet(path: Path) -> dict[str, AnyArray]:
    import pyarrow as pa
    import pyarrow.parquet as pq
    from astropy.table import Table

    if not path.is_file():
        raise InputError("no such file", file=path)
    columns = {}
    try:
        file = pq.ParquetFile(path)
        names = file.schema_arrow.names
        twice = next((name for name in names if names.count(name) > 1), None)
        if twice:
            raise InputError("column given twice", file=path, key=twice)
        for name in names:  # one at a time is in memory twice
            column = _of_arrow(file.read(columns=[name])[name].combine_chunks(), name, path)
            if column is not None:
                columns[name] = column
    except (OSError, ValueError, pa.ArrowException) as exc:
        raise InputError(f"not a table that can be read: {first_line(exc)}", file=path) from None
    return plain_columns(Table(columns, copy=False), path)


def _of_arrow(column: pa.Array, name: str, path: Path) -> AnyArray | None:
    """Return a column of a parquet file as an array, masked if it has integers and blanks; None: omitted."""
    import pyarrow as pa
    from astropy.table import MaskedColumn

    if pa.types.is_dictionary(column.type):
        column = column.dictionary_decode()
    if pa.types.is_decimal(column.type) or pa.types.is_null(column.type):
        column = column.cast(pa.float64())
    if getattr(pa.types, "is_string_view", lambda _: False)(column.type):
        column = column.cast(pa.large_string())
    words = pa.types.is_string(column.type) or pa.types.is_large_string(column.type)
    if not (words or pa.types.is_floating(column.type) or _is_whole(column.type)):
        _omit(name, str(column.type), path)
        return None
    if words:
        coded = column.fill_null("").dictionary_encode()  # each word once, not an object for each row
        return np.array(coded.dictionary.to_pylist() or [""], dtype=str)[coded.indices.to_numpy()]
    empty = column.is_null().to_numpy(zero_copy_only=False)
    if empty.any() and _is_whole(column.type):
        blank = False if pa.types.is_boolean(column.type) else 0
        return MaskedColumn(column.fill_null(blank).to_numpy(zero_copy_only=False), mask=empty)
    return column.to_numpy(zero_copy_only=False)


def _fits_table(path: Path) -> Table:
    """Return the first table of a FITS file, with a warning if there are several.

    Display formats are omitted: astropy refuses a column of numbers that are displayed as another type.
    """
    from astropy.io import fits
    from astropy.table import Table

    with fits.open(path, memmap=False) as hdus:
        tables = [hdu for hdu in hdus if isinstance(hdu, fits.BinTableHDU | fits.TableHDU)]
        if len(tables) > 1:
            names = ", ".join(hdu.name or f"HDU {hdus.index(hdu)}" for hdu in tables)
            _warn_once(str(path), f"of its tables {names} the first is read")
        if not tables:
            raise InputError("the file has no table", file=path)
        for name in [name for name in tables[0].header if name.startswith("TDISP")]:
            del tables[0].header[name]
        return Table.read(tables[0])


def _omit(name: str, kind: str, where: PathLike) -> None:
    """Warn that a column is omitted. Raises InputError for one that csstsim would use."""
    if name in _KNOWN or name.startswith("mag_") or closest_name(name, _TYPED):
        raise InputError("must have one number or word per row", file=where, key=name, value=kind)
    _warn_once(str(where), f"column {name} is omitted: {kind}, not one number or word per row")


@lru_cache
def _warn_once(where: str, text: str) -> None:
    """Log a warning about a table once in a process."""
    logging.getLogger("csstsim").warning("%s: %s", where, text)


def _without_comments(lines: list[str]) -> list[str]:
    """Return lines of CSV without those above the heading that begin with #."""
    heading = next((k for k, line in enumerate(lines) if line.strip() and not line.startswith("#")), len(lines))
    return lines[heading:]


def _is_whole(kind: pa.DataType) -> bool:
    import pyarrow as pa

    return pa.types.is_integer(kind) or pa.types.is_boolean(kind)


def _check_csv(lines: list[str], path: Path) -> None:
    """Refuse other separators, names given twice, which astropy would change, and quotes over several rows."""
    if not lines:
        raise InputError("the table is empty: no heading", file=path)
    other = next((name for mark, name in _SEPARATORS.items() if mark in lines[0] and "," not in lines[0]), None)
    if other:
        raise InputError(f"{other} separate the columns", file=path, value=lines[0][:80], allowed="commas")
    try:
        names = [name.strip() for name in next(csv.reader(lines))]
        rows = sum(1 for _ in csv.reader((f"{line}\n" for line in lines), strict=True))
    except csv.Error as exc:
        raise InputError(f"a quote is left open, or is inside a cell ({exc})", file=path) from None
    if rows < len(lines):
        raise InputError("a quoted cell continues beyond the end of its line", file=path, value=f"{len(lines)} lines")
    if twice := next((name for name in names if names.count(name) > 1), None):
        raise InputError("column given twice", file=path, key=twice)


@explained("table of objects")
def plain_columns(table: Table, where: PathLike = "catalog") -> dict[str, AnyArray]:
    """Return {name: (n,) values} of an astropy Table, blanks as NaN or "", converted to csstsim's units.

    A SkyCoord gives ra, dec and what else it has (base.astropy_values.position_columns) if the table has no ra and dec.
    A Time in rate_mjd gives MJD. Raises InputError for a unit that does not fit the column, or a column that is not of
    single numbers or words.
    """
    columns = {name: _plain(name, column, where) for name, column in _with_positions(table, where).items()}
    return {name: values for name, values in columns.items() if values is not None}


def _with_positions(table: Table, where: PathLike) -> dict[str, Any]:
    """Return {name: column} of an astropy Table with the columns of its SkyCoord, and times as MJD."""
    columns = {name: table[name] for name in table.colnames}
    if is_time(columns.get("rate_mjd")):
        columns["rate_mjd"] = columns["rate_mjd"].utc.mjd
    if {"ra", "dec"} & set(columns):
        return columns
    positions = [name for name, column in columns.items() if is_sky_coord(column)]
    if len(positions) > 1:
        given = ", ".join(positions)
        raise InputError("several columns of positions", file=where, value=given, allowed="one, or ra and dec")
    for name in positions:
        columns = position_columns(columns.pop(name), name, where) | columns
    return columns


def _plain(name: str, column: Column, where: PathLike) -> AnyArray | None:
    unit = getattr(column, "unit", None)
    if unit is not None and (name in _KNOWN or name.startswith("mag_")):
        column = _converted(name, column, unit, where)
    values: AnyArray = np.ma.asarray(getattr(column, "value", column))
    if values.dtype.kind not in "biufUS" or values.ndim != 1:
        _omit(name, f"{values.dtype}, {values.shape}", where)
        return None
    if values.dtype.kind == "f" and values.dtype.itemsize > 8:
        values = values.astype(float)  # a longdouble
    if values.dtype.kind == "S":
        values = values.astype(str)
    if values.dtype.kind in "biu" and np.ma.is_masked(values):
        if (np.abs(np.ma.compressed(values).astype(float)) > _EXACT).any():
            fault = "has blank cells, and numbers of too many digits"
            if name in _KNOWN:
                raise InputError(fault, file=where, key=name, allowed="no blank cells")
            _warn_once(str(where), f"column {name} {fault} for a float: its numbers are kept as words")
            return np.ma.filled(values.astype(str), "")
        values = values.astype(float)
    blanks: dict[str, float | str] = {"f": np.nan, "U": ""}
    return np.ma.filled(values, blanks.get(values.dtype.kind, 0))


def _converted(name: str, column: Column, unit: UnitBase, where: PathLike) -> Column | AnyArray:
    """Return a column's values in csstsim's unit. Magnitudes are not converted: they must be AB."""
    magnitude = name.startswith("mag_")
    wanted = "mag(AB)" if magnitude else _UNITS.get(name, "")
    if str(unit) == wanted or (magnitude and str(unit) == "mag"):
        return column
    try:
        if magnitude:
            raise ValueError
        return np.ma.filled(np.ma.asarray(column, dtype=float), np.nan) * unit.to(wanted)
    except (TypeError, ValueError, AttributeError):
        fault = {"key": name, "value": str(unit), "allowed": wanted or "a plain number"}
        raise InputError("the unit does not fit the column", file=where, **fault) from None


@explained("table of objects")
def object_table(columns: Mapping[str, ArrayLike], bands: Collection[str], where: PathLike) -> ObjectTable:
    """Return columns {name: (n,) values} as an ObjectTable with ids, types and sizes [arcsec].

    All rows can then be rendered. bands: of the camera; a magnitude in at least one is needed. Raises InputError, which
    names `where`, the column and the row.
    """
    full = {name: np.asarray(values) for name, values in columns.items()}
    known = {*columns_with(bands), *OPTIONAL} - {"flags"}  # flags of other programs do not mean what csstsim's do
    _check_columns(full, [f"mag_{band}" for band in bands], where)
    _warn_of_rounding(full, where)
    count = len(full["ra"])
    full.setdefault("id", np.arange(1, count + 1))
    magnitudes = [f"mag_{band}" for band in bands if f"mag_{band}" in full]
    if "type" in full:
        full["obj_type"] = _types(full.pop("type"), where)
    obj_type = np.asarray(full.get("obj_type", np.full(count, STAR, np.int8)))
    if obj_type.dtype.kind == "f":  # integers with blanks
        full["obj_type"] = obj_type = np.nan_to_num(obj_type, nan=STAR)
    if "spectrum_file" in full:
        full["spectrum_file"] = file_paths(full, "spectrum_file", where)
    if {"part_of", *part_rows.SHORTHANDS} & set(full):
        full = part_rows.resolve(full, obj_type, bands, where)
    _check_magnitudes(full, magnitudes, where)
    if "n" in full:
        full["n_disk"] = full.pop("n")
    check_shapes(full, obj_type, where)
    if "size" in full:
        size = np.where(obj_type == GALAXY, full.pop("size"), 0.0)
        for part in ("size_disk", "size_bulge"):
            full.setdefault(part, size)
    if "image_file" in full:
        full = with_images(full, obj_type, where)
    if "spectrum_file" in full:
        unknown = np.full(count, np.nan)
        mags = {bands[b] if isinstance(bands, dict) else b: full.get(f"mag_{b}", unknown) for b in bands}
        check_spectra(full["spectrum_file"], mags, where)
    if "knots" in full:  # without knots_frac all of the disk's flux
        disk = 1.0 - np.nan_to_num(np.asarray(full.get("bulge_frac", np.zeros(count)), float))
        knots_frac = np.asarray(full.get("knots_frac", np.full(count, np.nan)), float)
        full["knots_frac"] = np.where(np.isnan(knots_frac), np.where(full["knots"] > 0, disk, 0.0), knots_frac)
    for name in set(full) & (_FILLED | set(OPTIONAL)) - set(FILE_COLUMNS):
        if not np.isfinite(full[name]).all():
            full[name] = np.nan_to_num(full[name], nan=(COLUMNS | OPTIONAL)[name][1])  # a blank gets the default
    others = {name: values for name, values in full.items() if name not in changing.COLUMNS}
    ours = {name if name in known else f"user_{name}": values for name, values in others.items()}
    ours |= changing.completed(full, count)
    try:
        table = ObjectTable.complete(ours, bands, compact=True)
    except InputError as error:
        raise InputError(str(error), file=where) from None
    _check_rows(table, where)
    return table


def _check_columns(columns: Mapping[str, AnyArray], magnitudes: list[str], where: PathLike) -> None:
    known = _KNOWN | set(magnitudes)
    typed = _TYPED | set(magnitudes)
    lengths = {name: len(values) if values.ndim == 1 else values.shape for name, values in columns.items()}
    if len(set(lengths.values())) > 1:
        raise InputError("columns differ in length", file=where, value=str(lengths))
    for name in columns:
        if name not in known and (column := closest_name(name, typed - set(columns))):
            raise InputError(
                f"did you mean {column}? Rename it to {column}, or to something unlike {column}", file=where, key=name
            )
    sizes = [name for name in ("size_disk", "size_bulge") if name in columns]
    if "size" in columns and len(sizes) == 2:
        raise InputError(f"means the same as {' and '.join(sizes)}; give it or them", file=where, key="size")
    bulge = [name for name in ("n_disk", "n_bulge", "bulge_frac") if name in columns]
    if "n" in columns and bulge:
        allowed = "n alone, or n_disk, n_bulge and bulge_frac"
        raise InputError(f"is of the total flux, so not together with {bulge[0]}", file=where, key="n", allowed=allowed)
    if "size" in columns and not {"type", "obj_type"} & set(columns):
        raise InputError("only galaxies have sizes: the column type is missing", file=where, key="size")
    given = [name for name in magnitudes if name in columns]
    missing = next(
        (name for name in ("ra", "dec") if name not in columns), None if given else magnitudes[len(magnitudes) // 2]
    )
    if missing:
        needed = f"ra, dec and one of {', '.join(magnitudes)}"
        given_names = ", ".join(columns)
        message = f"a column is missing; needed: {needed}; found: {given_names}"
        raise InputError(message, file=where, key=missing)
    _check_ids(columns.get("id", np.zeros(0, int)), where)
    for name in known & set(columns) - {"type", "light_curve", *FILE_COLUMNS}:
        if columns[name].dtype.kind not in "iuf":
            row = next((k for k, value in enumerate(columns[name]) if not _number(value)), 0)
            raise InputError("must be numbers", file=where, key=f"{name}, row {row + 1}", value=str(columns[name][row]))


def _warn_of_rounding(columns: Mapping[str, AnyArray], where: PathLike) -> None:
    """Warn if positions have less than double precision."""
    for name in ("ra", "dec"):
        values = columns[name]
        if values.dtype.kind == "f" and values.dtype.itemsize < 8 and np.isfinite(values).any():
            step = 3.6e6 * float(np.spacing(np.nanmax(abs(values))))
            _warn_once(str(where), f"{name} is {values.dtype}, which rounds positions to {step:.2g} mas; use float64")


def _check_ids(ids: AnyArray, where: PathLike) -> None:
    """Raise InputError for the first id that is blank, no whole number, or none of 64 bits."""
    if ids.dtype.kind == "i" or (ids.dtype.kind == "u" and (ids <= _LARGEST_ID).all()):
        return
    row = next((k for k, value in enumerate(ids.tolist()) if not _is_id(value)), None)
    if row is not None:
        value = ids[row] if ids.dtype.kind != "f" or np.isfinite(ids[row]) else "blank"
        raise InputError(
            "not a number of an object",
            file=where,
            key=f"id, row {row + 1}",
            value=str(value),
            allowed=f"whole numbers from {-_LARGEST_ID - 1} to {_LARGEST_ID}, or no column id",
        )


def _is_id(value: Any) -> bool:
    try:
        return float(value).is_integer() and -_LARGEST_ID - 1 <= int(value) <= _LARGEST_ID
    except (TypeError, ValueError, OverflowError):
        return False


def _check_magnitudes(columns: Mapping[str, AnyArray], given: list[str], where: PathLike) -> None:
    none = np.ones(len(columns["ra"]), bool)
    odd = np.zeros(len(columns["ra"]), bool)
    for name in given:
        none &= ~np.isfinite(columns[name])
        with np.errstate(invalid="ignore"):
            odd |= (columns[name] < BRIGHTEST) | (columns[name] > FAINTEST)
    for bad, message in (
        (none, "has no magnitude"),
        (odd, f"has a magnitude outside {BRIGHTEST:g} to {FAINTEST:g}; leave the cell blank to omit this band"),
    ):
        if bad.any():
            raise InputError(f"row {np.flatnonzero(bad)[0] + 1} {message}", file=where, key=", ".join(given))


def _check_rows(table: ObjectTable, where: PathLike) -> None:
    """Raise InputError for the first row that cannot be rendered, or an id that another row has."""
    for start, part in table.parts():
        faults = {reason: mask for reason, mask in reasons(part).items() if reason != STRONGLY_LENSED}
        with np.errstate(invalid="ignore"):
            faults["ra is not within -180..360"] = ~((part["ra"] >= -180) & (part["ra"] <= 360))
            faults[f"its z is not above -1, to {FARTHEST:g}"] = (part["z"] <= -1) | (part["z"] > FARTHEST)
            faults[f"its rv is not within {LIGHT_KM_S:g} km / s"] = np.abs(part["rv"]) >= LIGHT_KM_S
            faults[f"its parallax is not within {NEAREST_MAS:g} mas"] = np.abs(part["parallax"]) > NEAREST_MAS
            motion = np.hypot(part["pmra"], part["pmdec"])
            faults[f"its proper motion is above {FASTEST:g} mas / yr"] = motion > FASTEST
        for reason, mask in faults.items():
            if mask.any():
                row = start + np.flatnonzero(mask)[0] + 1
                raise InputError(f"row {row} cannot be rendered: {reason}", file=where)
    if (np.diff(table["id"]) > 0).all():
        return
    order = np.argsort(table["id"], kind="stable")
    again = order[1:][np.diff(table["id"][order]) == 0]
    if len(again):
        raise InputError(f"row {again.min() + 1} cannot be rendered: another row has the same id", file=where)


def _number(value: Any) -> bool:
    try:
        float(value)
    except ValueError:
        return False
    return True


def _types(names: AnyArray, where: PathLike) -> IntArray:
    numbers = np.full(len(names), -1, np.int8)
    numbers[names == ""] = STAR  # blank
    for number, word in enumerate(TYPES):
        numbers[names == word] = number
    others = np.flatnonzero(numbers < 0)  # written in another way
    words = [str(name).strip().lower() for name in names[others]]
    unknown = sorted(set(words) - set(TYPES))
    if unknown:
        raise InputError("unknown type", file=where, key="type", value=unknown[0], allowed=", ".join(TYPES))
    numbers[others] = [TYPES.index(word) for word in words]
    return numbers
