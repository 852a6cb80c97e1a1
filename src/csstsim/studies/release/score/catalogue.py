"""Reads a catalogue with any column names: CSV, ECSV, FITS (also LDAC), parquet, source-extractor's text."""

from __future__ import annotations

import re
import warnings
from dataclasses import dataclass, field
from itertools import takewhile
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from csstsim.base.errors import InputError, first_line
from csstsim.base.files.fits_headers import check_headers
from csstsim.base.files.text_file import read_text
from csstsim.studies.release.score.missing import without_missing
from csstsim.studies.release.score.quantities import ab_magnitude, parse_key, shapes, to_first_unit

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from astropy.table import Column, Table

    from csstsim.base.types import BoolArray, FloatArray, PathLike
    from csstsim.studies.release.score.quantities import Key

FORMATS = {
    ".csv": "ascii.csv",
    ".ecsv": "ascii.ecsv",
    ".cat": "ascii.sextractor",
    ".fits": "fits",
    ".fit": "fits",
    ".parquet": "parquet",
}
TEXT_BYTES_MAX = 1_000_000_000  # bytes of a text
COLUMNS_MAX = 10_000  # of a catalogue of Source Extractor, whose arrays have a column for each element
NAMES_LISTED_MAX = 10  # columns that are not used, by name


@dataclass(frozen=True)
class Catalogue:
    """Sources as columns (n,): ra, dec [deg], and those of mag_B [AB], z, e1, e2 that are known.

    columns_used: {quantity: its column}; notes: sentences about what was left out.
    """

    columns: dict[str, FloatArray]
    columns_used: dict[str, str]
    notes: list[str] = field(default_factory=list)

    def __len__(self) -> int:
        return len(self.columns["ra"])

    def __contains__(self, name: str) -> bool:
        return name in self.columns

    def __getitem__(self, name: str) -> FloatArray:
        return self.columns[name]

    def take(self, rows: BoolArray) -> Catalogue:
        """Return the Catalogue of some rows."""
        return Catalogue({name: values[rows] for name, values in self.columns.items()}, self.columns_used, self.notes)


def read_catalogue(path: PathLike, maps: Mapping[str, str], bands: Sequence[str]) -> Catalogue:
    """Return the Catalogue in a file. maps: {key: column}, not needed if both have one name. Raises InputError."""
    table = read_table(path)
    keys = _map_columns(table, maps, bands, path)
    columns: dict[str, FloatArray] = {}
    columns_used: dict[str, str] = {}
    is_chi = False
    for key, name in keys.items():
        columns[key.full_name] = to_first_unit(_float_column(table[name], name, path), key, table[name].unit, name)
        columns_used[key.full_name] = name
        is_chi = is_chi or key.unit == "chi"
    missing = next((name for name in ("ra", "dec") if name not in columns), None)
    if missing:
        names = ", ".join(table.colnames)
        raise InputError("not mapped: use --map", file=path, key=missing, allowed=f"its columns: {names}")
    notes = _column_notes(table, keys, bands)
    for band in bands:
        flux = columns.pop(f"flux_{band}", None)
        if flux is not None and f"mag_{band}" in columns:
            raise InputError("a magnitude and a flux of one band", file=path, key=f"flux_{band}")
        if flux is not None:
            columns[f"mag_{band}"] = ab_magnitude(flux)
    columns, missing_notes = without_missing(columns)
    notes += missing_notes
    selected = {name: columns[name] for name in columns if name in ("ra", "dec", "z") or name.startswith("mag_")}
    ellipticity = shapes(columns, is_chi)
    if ellipticity:
        selected["e1"], selected["e2"] = ellipticity
    return _with_positions(Catalogue(selected, columns_used, notes), path)


def _with_positions(catalogue: Catalogue, path: PathLike) -> Catalogue:
    """Return the catalogue without rows that have no position. Raises InputError for impossible positions."""
    ra = catalogue["ra"]
    dec = catalogue["dec"]
    known = np.isfinite(ra) & np.isfinite(dec)
    wrong = known & ((np.abs(dec) > 90.0) | (ra < -360.0) | (ra > 720.0))
    if wrong.any():
        row = int(np.flatnonzero(wrong)[0])
        raise InputError(
            f"row {row + 1} is not a position on the sky: is the unit right?",
            file=path,
            key="ra, dec",
            value=f"{ra[row]:g}, {dec[row]:g}",
            allowed="degrees; ra_hour, ra_rad, dec_rad for others",
        )
    if not known.all():
        catalogue.notes.append(f"{(~known).sum()} rows have no position: left out")
    return catalogue.take(known)


def _map_columns(table: Table, maps: Mapping[str, str], bands: Sequence[str], path: PathLike) -> dict[Key, str]:
    """Return {Key: column}: the mapped ones, then columns with the name of a quantity.

    Names of one letter are not used, because z may be a redshift or a band. If a magnitude and a flux of one band are
    both unmapped, the magnitude is used.
    """
    keys: dict[Key, str] = {}
    mapped: dict[str, str] = {}
    for text, name in maps.items():
        key = parse_key(text, bands)
        if name not in table.colnames:
            names = ", ".join(table.colnames)
            raise InputError("no such column", file=path, key=f"--map {text}", value=name, allowed=names)
        if key.full_name in mapped:
            raise InputError("given twice", key="--map", value=key.full_name)
        keys[key] = name
        mapped[key.full_name] = name
    for name in sorted(table.colnames, key=lambda name: name.lower().startswith("flux_")):  # magnitudes first
        try:
            key = parse_key(name.lower(), bands)
        except InputError:
            continue
        equivalent = {f"mag_{key.band}", f"flux_{key.band}"} if key.band else {key.full_name}
        if not equivalent & set(mapped) and len(key.full_name) > 1:
            keys[key] = name
            mapped[key.full_name] = name
    return keys


def _column_notes(table: Table, keys: Mapping[Key, str], bands: Iterable[str]) -> list[str]:
    """Return sentences about the columns that are used, those that are not, and quantities without a column."""
    unused = [name for name in table.colnames if name not in keys.values()]
    more = f" and {len(unused) - NAMES_LISTED_MAX} more" if len(unused) > NAMES_LISTED_MAX else ""
    notes = [f"{key.full_name}: from column {name}" for key, name in keys.items()]
    notes += [f"columns not used: {', '.join(unused[:NAMES_LISTED_MAX])}{more}"] if unused else []
    quantities = {key.full_name for key in keys}
    if not any(f"{kind}_{band}" in quantities for band in bands for kind in ("mag", "flux")):
        notes.append(
            "no magnitude is mapped (mag_B, flux_B): photometry is not evaluated, and matching is by position alone"
        )
    if "z" not in quantities:
        notes.append("no column is mapped as z: redshifts are not evaluated")
    if not ({"e1", "e2"} <= quantities or ("pa" in quantities and ("q" in quantities or {"a", "b"} <= quantities))):
        notes.append("neither e1 and e2 nor a, b and pa are mapped: shapes are not evaluated")
    return notes


def _float_column(column: Column, name: str, path: PathLike) -> FloatArray:
    values = np.ma.asarray(column)
    if values.dtype.kind not in "biuf" or values.ndim != 1:
        raise InputError("must be numbers, one in a row", file=path, key=f"column {name}", value=str(values.dtype))
    return np.ma.filled(values.astype(float), np.nan)


def read_table(path: PathLike) -> Table:
    """Return an astropy Table, with units, of a file or of a folder of bricks. Raises InputError if it is no table."""
    from astropy.table import Table

    path = Path(path)
    if path.is_dir():
        return _read_bricks(path)
    format_ = FORMATS.get(path.suffix.lower())
    if format_ is None:
        raise InputError("unknown kind of table", file=path, value=path.suffix, allowed=", ".join(FORMATS))
    if not path.is_file():
        raise InputError("no such file", file=path)
    try:
        if format_ == "fits":
            check_headers(path)
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # units that FITS does not know, and the like
                return _read_fits(path)
        if format_ == "parquet":
            return _read_parquet([path])
        lines = read_text(path, "utf-8-sig", TEXT_BYTES_MAX).splitlines()
        if not any(line.strip() for line in lines):
            raise InputError("the table is empty: no heading", file=path)
        if format_ == "ascii.sextractor":
            _check_column_numbers(lines, path)
        return Table.read(lines, format=format_)
    except InputError:
        raise
    except Exception as exc:  # astropy's readers raise exceptions of many types
        raise InputError(f"not a table that can be read: {first_line(exc)}", file=path) from None


def _check_column_numbers(lines: Sequence[str], path: Path) -> None:
    """Raise InputError for a column beyond COLUMNS_MAX: astropy would make all columns up to its number."""
    for line in takewhile(lambda line: line.startswith("#"), lines):
        column = re.match(r"#\s*(\d+)\s+(\S+)", line)
        if column and int(column[1]) > COLUMNS_MAX:
            message, allowed = "too large a number of a column", f"<= {COLUMNS_MAX}"
            raise InputError(message, file=path, key=column[2], value=int(column[1]), allowed=allowed)


def _read_bricks(folder: Path) -> Table:
    """Return the rows of all parquet files below a folder. Raises InputError if it has none, or columns differ."""
    files = sorted(folder.rglob("*.parquet"))
    if not files:
        raise InputError("no parquet file is below this folder", file=folder)
    try:
        return _read_parquet(files)
    except Exception as exc:  # pyarrow's exceptions are of many types
        raise InputError(f"not bricks of one table: {first_line(exc)}", file=folder) from None


def _read_parquet(files: Iterable[Path]) -> Table:
    import pyarrow as pa
    import pyarrow.parquet as pq
    from astropy.table import Table

    table = pa.concat_tables([pq.ParquetFile(file).read() for file in files])
    return Table({name: table[name].to_numpy() for name in table.column_names})


def _read_fits(path: Path) -> Table:
    """Return the first table of a FITS file that is not LDAC's copy of the image header."""
    from astropy.io import fits
    from astropy.table import Table

    with fits.open(path) as file:
        tables = [k for k, hdu in enumerate(file) if isinstance(hdu, fits.BinTableHDU | fits.TableHDU)]
        tables = [k for k in tables if file[k].name != "LDAC_IMHEAD"]
    if not tables:
        raise InputError("a FITS file without a table", file=path)
    return Table.read(path, hdu=tables[0])
