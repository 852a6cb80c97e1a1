"""Reads a catalogue in anybody's columns: CSV, ECSV, FITS (also LDAC), parquet, source-extractor's text."""

from __future__ import annotations

import warnings
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from csstsim.base.errors import InputError
from csstsim.base.files.fits_headers import check_headers
from csstsim.base.files.text_file import read_text
from csstsim.studies.release.score.missing import without_missing
from csstsim.studies.release.score.quantities import ab_magnitude, in_our_unit, parse_key, shapes

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
LARGEST = 1_000_000_000  # bytes of a text
NAMED = 10  # columns that are not used, by name


@dataclass(frozen=True)
class Catalogue:
    """Sources as columns: ra, dec [deg], and of mag_B [AB], z, e1, e2 those that it has; (n,) numbers.

    told: {quantity: its column}; notes: what was left out, in sentences.
    """

    columns: dict[str, FloatArray]
    told: dict[str, str]
    notes: list[str] = field(default_factory=list)

    def __len__(self) -> int:
        return len(self.columns["ra"])

    def __contains__(self, name: str) -> bool:
        return name in self.columns

    def __getitem__(self, name: str) -> FloatArray:
        return self.columns[name]

    def take(self, rows: BoolArray) -> Catalogue:
        """Return the Catalogue of some rows."""
        return Catalogue({name: values[rows] for name, values in self.columns.items()}, self.told, self.notes)


def read_catalogue(path: PathLike, maps: Mapping[str, str], bands: Sequence[str]) -> Catalogue:
    """Return the Catalogue in a file. maps: {key: column}; columns called as a key need none. Raises InputError."""
    table = read_any(path)
    keys = _keys(table, maps, bands, path)
    columns: dict[str, FloatArray] = {}
    told: dict[str, str] = {}
    chi = False
    for key, name in keys.items():
        columns[key.whole] = in_our_unit(_numbers(table[name], name, path), key, table[name].unit, name)
        told[key.whole] = name
        chi = chi or key.unit == "chi"
    missing = next((name for name in ("ra", "dec") if name not in columns), None)
    if missing:
        had = ", ".join(table.colnames)
        raise InputError("not mapped: use --map", file=path, key=missing, allowed=f"its columns: {had}")
    notes = _not_used(table, keys, bands)
    for band in bands:
        flux = columns.pop(f"flux_{band}", None)
        if flux is not None and f"mag_{band}" in columns:
            raise InputError("a magnitude and a flux of one band", file=path, key=f"flux_{band}")
        if flux is not None:
            columns[f"mag_{band}"] = ab_magnitude(flux)
    columns, empty = without_missing(columns)
    notes += empty
    found = shapes(columns, chi)
    kept = {name: columns[name] for name in columns if name in ("ra", "dec", "z") or name.startswith("mag_")}
    return _placed(Catalogue(kept | (dict(zip(("e1", "e2"), found, strict=True)) if found else {}), told, notes), path)


def _placed(catalogue: Catalogue, path: PathLike) -> Catalogue:
    """Return the catalogue without rows that have no place. Raises InputError for places that are none."""
    ra = catalogue["ra"]
    dec = catalogue["dec"]
    known = np.isfinite(ra) & np.isfinite(dec)
    wrong = known & ((np.abs(dec) > 90.0) | (ra < -360.0) | (ra > 720.0))
    if wrong.any():
        row = int(np.flatnonzero(wrong)[0])
        raise InputError(
            f"row {row + 1} is no place on the sky: is the unit another one?",
            file=path,
            key="ra, dec",
            value=f"{ra[row]:g}, {dec[row]:g}",
            allowed="degrees; ra_hour, ra_rad, dec_rad for others",
        )
    if not known.all():
        catalogue.notes.append(f"{(~known).sum()} rows have no place: left out")
    return catalogue.take(known)


def _keys(table: Table, maps: Mapping[str, str], bands: Sequence[str], path: PathLike) -> dict[Key, str]:
    """Return {Key: column}: the mapped ones, then columns that are called as a quantity.

    One letter is not enough: z may be a redshift or a band, a and b anything. Of a magnitude and a flux of one band
    that are not mapped, the magnitude is taken.
    """
    keys: dict[Key, str] = {}
    known: dict[str, str] = {}
    for text, name in maps.items():
        key = parse_key(text, bands)
        if name not in table.colnames:
            had = ", ".join(table.colnames)
            raise InputError("no such column", file=path, key=f"--map {text}", value=name, allowed=had)
        if key.whole in known:
            raise InputError("given twice", key="--map", value=key.whole)
        keys[key] = name
        known[key.whole] = name
    for name in sorted(table.colnames, key=lambda name: name.lower().startswith("flux_")):  # magnitudes first
        try:
            key = parse_key(name.lower(), bands)
        except InputError:
            continue
        same = {f"mag_{key.band}", f"flux_{key.band}"} if key.band else {key.whole}
        if not same & set(known) and len(key.whole) > 1:
            keys[key] = name
            known[key.whole] = name
    return keys


def _not_used(table: Table, keys: Mapping[Key, str], bands: Iterable[str]) -> list[str]:
    """Return sentences about columns that are used, those that are not, and quantities that have none."""
    left = [name for name in table.colnames if name not in keys.values()]
    more = f" and {len(left) - NAMED} more" if len(left) > NAMED else ""
    notes = [f"{key.whole}: from column {name}" for key, name in keys.items()]
    notes += [f"columns not used: {', '.join(left[:NAMED])}{more}"] if left else []
    known = {key.whole for key in keys}
    if not any(f"{kind}_{band}" in known for band in bands for kind in ("mag", "flux")):
        notes.append(
            "no magnitude is mapped (mag_B, flux_B): photometry is not evaluated, and matching is by place alone"
        )
    if "z" not in known:
        notes.append("no column is mapped as z: redshifts are not evaluated")
    if not ({"e1", "e2"} <= known or ("pa" in known and ("q" in known or {"a", "b"} <= known))):
        notes.append("neither e1 and e2 nor a, b and pa are mapped: shapes are not evaluated")
    return notes


def _numbers(column: Column, name: str, path: PathLike) -> FloatArray:
    values = np.ma.asarray(column)
    if values.dtype.kind not in "biuf" or values.ndim != 1:
        raise InputError("must be numbers, one in a row", file=path, key=f"column {name}", value=str(values.dtype))
    return np.ma.filled(values.astype(float), np.nan)


def read_any(path: PathLike) -> Table:
    """Return an astropy Table of a file, units kept, or of a folder of bricks. Raises InputError if it is none."""
    from astropy.table import Table

    path = Path(path)
    if path.is_dir():
        return _of_bricks(path)
    form = FORMATS.get(path.suffix.lower())
    if form is None:
        raise InputError("unknown kind of table", file=path, value=path.suffix, allowed=", ".join(FORMATS))
    if not path.is_file():
        raise InputError("no such file", file=path)
    try:
        if form == "fits":
            check_headers(path)
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # units that FITS does not know, and the like
                return _of_fits(path)
        if form == "parquet":
            return _of_parquet([path])
        lines = read_text(path, "utf-8-sig", LARGEST).splitlines()
        if not any(line.strip() for line in lines):
            raise InputError("the table is empty: no heading", file=path)
        return Table.read(lines, format=form)
    except InputError:
        raise
    except Exception as exc:  # astropy's readers raise exceptions of many types
        raise InputError(f"not a table that can be read: {str(exc).splitlines()[0]}", file=path) from None


def _of_bricks(folder: Path) -> Table:
    """Return the rows of all parquet files below a folder. Raises InputError if there is none, or they differ."""
    files = sorted(folder.rglob("*.parquet"))
    if not files:
        raise InputError("no parquet file is below this folder", file=folder)
    try:
        return _of_parquet(files)
    except Exception as exc:  # pyarrow's exceptions are of many types
        raise InputError(f"not bricks of one table: {str(exc).splitlines()[0]}", file=folder) from None


def _of_parquet(files: Iterable[Path]) -> Table:
    import pyarrow as pa
    import pyarrow.parquet as pq
    from astropy.table import Table

    read = pa.concat_tables([pq.ParquetFile(file).read() for file in files])
    return Table({name: read[name].to_numpy() for name in read.column_names})


def _of_fits(path: Path) -> Table:
    """Return the first table of a FITS file that is not LDAC's copy of the image header."""
    from astropy.io import fits
    from astropy.table import Table

    with fits.open(path) as file:
        numbers = [k for k, hdu in enumerate(file) if isinstance(hdu, fits.BinTableHDU | fits.TableHDU)]
        numbers = [k for k in numbers if file[k].name != "LDAC_IMHEAD"]
    if not numbers:
        raise InputError("a FITS file without a table", file=path)
    return Table.read(path, hdu=numbers[0])
