"""ObjectTable: many astronomical objects as columns (a struct of arrays), stored in parquet files.

A chip has some 76,000 objects; one Python object each, with its own spectrum, would be too slow. A
`MockObject` (the paper's unit of input) is a view of one row.
"""

from __future__ import annotations

import json
import zlib
from collections.abc import Iterable, Iterator, Mapping
from typing import TYPE_CHECKING, Any, Self, TypeAlias

import numpy as np

from csstsim.base.errors import InputError, first_line
from csstsim.base.files.atomic import atomic_path
from csstsim.base.files.file_log import logged
from csstsim.base.plural import number_of
from csstsim.base.types import AnyArray, BoolArray, PathLike

if TYPE_CHECKING:
    import pyarrow as pa
    import pyarrow.parquet as pq
    from numpy.typing import ArrayLike


STAR = 0
GALAXY = 1
QUASAR = 2
ASTEROID = 3
SATELLITE = 4
TYPES = ("star", "galaxy", "quasar", "asteroid", "satellite")  # by obj_type; all but galaxies are points

ROWS = 1_000_000  # of a part

ColumnKind: TypeAlias = tuple[type[Any], Any, str]  # type of the values, default value, meaning


def lensed(obj_type: ArrayLike) -> BoolArray:
    """Return (n,) bool: objects behind the lens. Stars, asteroids and satellites are in front of it."""
    return (np.asarray(obj_type) == GALAXY) | (np.asarray(obj_type) == QUASAR)


_MOST = 1 << 28  # values in a file: the fullest possible brick (4 million objects), 2 GB
_META_KEY = b"csstsim"
_SUMS_KEY = b"csstsim_checksums"

# Columns every catalogue has: type, default value, and meaning. NaN means "not known": a galaxy
# without a size is flagged, one without a parallax is not. Magnitudes in the camera's bands come after z (MAGNITUDE).
COLUMNS: dict[str, ColumnKind] = {
    "id": (np.int64, 0, "the object's number"),
    "obj_type": (np.int8, STAR, "0 star, 1 galaxy, 2 quasar, 3 asteroid, 4 satellite"),
    "ra": (np.float64, np.nan, "deg, ICRS at J2000; moved by pmra ... parallax if a star"),
    "dec": (np.float64, np.nan, "deg"),
    "z": (np.float32, 0.0, "redshift"),
    "teff": (np.float32, 0.0, "K"),
    "logg": (np.float32, 0.0, "dex, of cm / s2"),
    "feh": (np.float32, 0.0, "dex"),
    "pmra": (np.float32, 0.0, "mas / yr, includes cos(dec)"),
    "pmdec": (np.float32, 0.0, "mas / yr"),
    "rv": (np.float32, 0.0, "km / s"),
    "parallax": (np.float32, 0.0, "mas"),
    "av": (np.float32, 0.0, "mag, Milky Way extinction"),
    "size_disk": (np.float32, 0.0, "arcsec, half-light radius (unlensed)"),
    "size_bulge": (np.float32, 0.0, "arcsec, half-light radius (unlensed)"),
    "bulge_frac": (np.float32, 0.0, "fraction of the flux in the bulge"),
    "e1": (np.float32, 0.0, "ellipticity (a - b) / (a + b), unlensed; axis 1 along +RA (east)"),
    "e2": (np.float32, 0.0, "the same, axis 2 at 45 deg towards north"),
    "kappa": (np.float32, 0.0, "convergence"),
    "gamma1": (np.float32, 0.0, "shear, axes of e1"),
    "gamma2": (np.float32, 0.0, "shear, axes of e2"),
    "stellarmass": (np.float32, np.nan, "solar masses, of a star"),
    "bulgemass": (np.float32, np.nan, "solar masses of stars, of a galaxy"),
    "diskmass": (np.float32, np.nan, "solar masses of stars, of a galaxy"),
    "veldisp": (np.float32, np.nan, "km / s, of a galaxy's stars"),
    "sfr": (np.float32, np.nan, "solar masses / yr, star formation of a galaxy now (Chabrier)"),
    "metallicity": (np.float32, np.nan, "mass fraction of metals in a galaxy's stars, weighted with their mass"),
    "stellarage": (np.float32, np.nan, "Gyr, mean age of a galaxy's stars, weighted with the mass formed"),
    "halomass": (
        np.float32,
        np.nan,
        "solar masses within 200 times the mean density, of the halo a galaxy lives in; NaN: it follows the smooth "
        "density",
    ),
    "satellite": (np.int8, -1, "0 the central galaxy of its halo, 1 a satellite; -1 as halomass NaN"),
    "gal_type": (np.int8, -1, "0 star-forming, 1 quiescent; -1 no galaxy, or not known"),
    "host": (np.int64, -1, "id of the galaxy a quasar lives in"),
    "flags": (np.int32, 0, "bits of csstsim.catalog.flags"),
}
# Columns that only some tables have, in the same form; a table without one is as if it had the default in every row.
OPTIONAL: dict[str, ColumnKind] = {
    "n_disk": (np.float32, 1.0, "Sersic index of the disk, 0.3 to 6.2"),
    "n_bulge": (np.float32, 4.0, "Sersic index of the bulge, 0.3 to 6.2"),
    "part_of": (np.int64, -1, "id of the object of which the row is a part with its own flux; -1: not a part"),
    "knots": (np.int32, 0, "number of knots: points of equal flux, at random positions in the disk's profile"),
    "knots_frac": (np.float32, 0.0, "fraction of the flux in knots"),
    "knots_turned": (np.int8, 0, "1: the knots are turned by 90 degrees, as in a twin campaign"),
    "image_file": (np.str_, "", "file of a galaxy's image, which is rendered in place of disk and bulge"),
    "image_scale": (np.float32, 0.0, "arcsec per pixel of the image; 0: by its WCS"),
    "image_pa": (np.float32, 0.0, "deg, from north through east: by how much the image is turned"),
    "image_radius": (np.float32, 0.0, "arcsec, from the middle of the image to its corners, before lensing"),
    "spectrum_file": (np.str_, "", "file of the spectrum's shape (tables; a class has load_sed)"),
}
FILE_COLUMNS = "image_file", "spectrum_file"
MAGNITUDE: ColumnKind = (np.float32, np.nan, "AB, of the catalogue's spectrum")


def columns_with(bands: Iterable[str]) -> dict[str, ColumnKind]:
    """Return COLUMNS with a magnitude mag_B for each of `bands`, the names of Camera.bands."""
    known = list(COLUMNS.items())
    at = list(COLUMNS).index("z") + 1
    return dict(known[:at] + [(f"mag_{band}", MAGNITUDE) for band in bands] + known[at:])


class ObjectTable(Mapping[str, AnyArray]):
    """Named columns of equal length; `meta` is a JSON-like dict that is stored with the table.

    `len(table)` is the number of rows; iteration and `in` are over column names.

    Parameters
    ----------
    columns : mapping
        {name: (n,) array}; units of csstsim's columns are in `catalog.table.COLUMNS`.
    meta : mapping, optional
        {name: JSON-like value}.

    Raises
    ------
    ValueError
        For columns of different length.
    """

    def __init__(self, columns: Mapping[str, ArrayLike], meta: Mapping[str, Any] | None = None) -> None:
        self._columns = {name: np.asarray(values) for name, values in columns.items()}
        self.meta = dict(meta or {})
        lengths = {name: len(values) for name, values in self._columns.items()}
        if len(set(lengths.values())) > 1:
            raise ValueError(f"columns of different length: {lengths}")
        self._length = next(iter(lengths.values()), 0)

    def __repr__(self) -> str:
        return f"<ObjectTable: {number_of(len(self), 'row')}; {', '.join(self._columns)}>"

    def __getitem__(self, name: str) -> AnyArray:
        return self._columns[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._columns)

    def __len__(self) -> int:
        return self._length

    def __contains__(self, name: object) -> bool:
        return name in self._columns

    def __bool__(self) -> bool:
        return self._length > 0

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, ObjectTable):
            return NotImplemented
        same_names = list(self) == list(other)
        return same_names and all(
            a.dtype == b.dtype and a.tobytes() == b.tobytes() if a.dtype != object else np.array_equal(a, b)
            for a, b in ((self[name], other[name]) for name in self)
        )

    __hash__ = None  # type: ignore[assignment]  # tables cannot be keys

    @property
    def names(self) -> tuple[str, ...]:
        """Column names, in order."""
        return tuple(self._columns)

    def take(self, rows: AnyArray | slice) -> ObjectTable:
        """Return some rows as a table.

        Parameters
        ----------
        rows : (m,) array of int, slice or (n,) array of bool
            Row numbers, in any order, or a mask.

        Returns
        -------
        ObjectTable
            These rows, in that order.
        """
        if isinstance(rows, np.ndarray) and rows.dtype.kind == "b":  # row numbers are three times as fast
            rows = np.flatnonzero(rows)
        return ObjectTable({name: values[rows] for name, values in self._columns.items()}, self.meta)

    def parts(self) -> Iterator[tuple[int, ObjectTable]]:
        """Yield the table in parts of ROWS rows, so that the results of one part can leave memory before the next.

        Yields
        ------
        first : int
            Number of the part's first row.
        part : ObjectTable
            The rows of the part.
        """
        for start in range(0, max(len(self), 1), ROWS):
            yield start, self.take(slice(start, start + ROWS))

    def with_columns(self, **columns: ArrayLike) -> ObjectTable:
        """Return a table with columns added or replaced; the others are shared, not copied.

        Parameters
        ----------
        **columns : (n,) array
            New columns by name.

        Returns
        -------
        ObjectTable
            With the same metadata.
        """
        return ObjectTable({**self._columns, **columns}, self.meta)

    @classmethod
    def complete(
        cls,
        columns: Mapping[str, ArrayLike],
        bands: Iterable[str],
        meta: Mapping[str, Any] | None = None,
        *,
        compact: bool = False,
    ) -> Self:
        """Return a table with every column of `columns_with(bands)` in its type, and other columns after these.

        Parameters
        ----------
        columns : mapping
            {name: (n,) array or scalar}, in the units of `catalog.table.COLUMNS`. A scalar fills a whole column.
            Columns that are not given have their default.
        bands : iterable of str
            Bands of the camera (Camera.bands).
        meta : mapping, optional
            {name: JSON-like value}.
        compact : bool
            Whether a scalar takes the memory of one value; such a column is read-only.

        Returns
        -------
        ObjectTable
            The complete table.

        Raises
        ------
        InputError
            For a value that does not fit its column.

        Examples
        --------
        >>> from csstsim.catalog.table import ObjectTable
        >>> table = ObjectTable.complete({"ra": [10.0, 10.1], "dec": -2.0, "mag_r": [18.0, 21.5]}, bands=["r"])
        >>> table["dec"].tolist(), table.take(table["mag_r"] > 20)["ra"].tolist()
        ([-2.0, -2.0], [10.1])
        """
        sized = [np.asarray(v) for v in columns.values() if np.ndim(v)]
        count = len(sized[0]) if sized else 0
        fill = np.broadcast_to if compact else lambda value, count: np.full(count, value)
        full = {}
        for name, (dtype, default, _) in columns_with(bands).items():
            values = _typed(name, np.asarray(columns.get(name, default)), dtype)
            full[name] = values if values.ndim else fill(values, count)
        extras = {name: np.asarray(v) for name, v in columns.items() if name not in full}
        extras |= {name: _typed(name, extras[name], OPTIONAL[name][0]) for name in extras if name in OPTIONAL}
        return cls(full | {name: v if v.ndim else fill(v, count) for name, v in extras.items()}, meta)

    @classmethod
    def concat(cls, tables: Iterable[ObjectTable]) -> Self:
        """Return all rows of several tables, in order.

        Parameters
        ----------
        tables : iterable of ObjectTable
            Each must have the columns of the first.

        Returns
        -------
        ObjectTable
            With the metadata of the first table, and columns (n,) for all rows.
        """
        tables = list(tables)
        if not tables:
            return cls.complete({}, ())
        return cls({name: np.concatenate([t[name] for t in tables]) for name in tables[0]}, tables[0].meta)

    def write(self, path: PathLike, meta: Mapping[str, Any] | None = None) -> None:
        """Write a parquet file under a temporary name, then rename it.

        Parameters
        ----------
        path : str or Path
            The file.
        meta : mapping, optional
            {name: JSON-like value} in place of the table's metadata.
        """
        import pyarrow as pa

        table = pa.table({name: _to_arrow(values) for name, values in self._columns.items()})
        write_parquet(path, table, self.meta if meta is None else meta)

    @classmethod
    def read(cls, path: PathLike, columns: Iterable[str] | None = None) -> Self:
        """Return the table in a parquet file of `write`.

        Parameters
        ----------
        path : str or Path
            The file.
        columns : iterable of str, optional
            Names of the columns to read; None: all.

        Returns
        -------
        ObjectTable
            With its metadata.

        Raises
        ------
        InputError
            For a damaged file, one that is not csstsim's, or one without one of `columns`.
        """
        import pyarrow as pa
        import pyarrow.parquet as pq

        try:
            with logged("read", path), pq.ParquetFile(path) as file:
                about = file.schema_arrow.metadata or {}
                meta = about.get(_META_KEY)
                names = file.schema_arrow.names if columns is None else list(columns)
                missing = sorted(set(names) - set(file.schema_arrow.names))
                twice = [name for name in names if file.schema_arrow.names.count(name) > 1]
                if twice or file.metadata.num_rows * len(names) > _MOST:
                    raise InputError("columns given twice, or too many rows", file=path, value=file.metadata.num_rows)
                table = None if meta is None or missing else file.read(columns=names)
        except (OSError, ValueError, pa.ArrowException) as exc:
            raise InputError(f"not a readable parquet file: {first_line(exc)}", file=path) from None
        if meta is None:
            raise InputError("a parquet file, but not one of csstsim's tables (no metadata)", file=path)
        if missing:
            raise InputError("the table lacks a column", file=path, key=missing[0])
        assert table is not None  # it has been read
        found = cls({name: _to_numpy(table[name]) for name in names}, _load_meta(path, meta))
        sums = _load_meta(path, about.get(_SUMS_KEY, b"{}"))
        if sums.get("") != _checksum(meta) or any(sums.get(name) != _checksum(found[name]) for name in names):
            raise InputError("damaged: a column does not have its recorded checksum; make it again", file=path)
        check_numbers(path, found, {*COLUMNS, *(name for name in found if name.startswith("mag_"))})
        return found


def _to_arrow(values: AnyArray) -> pa.Array:
    """Return a column as an Arrow array that shares its memory: pa.array imports pandas, if it is installed."""
    import pyarrow as pa

    kind = values.dtype.kind
    count = len(values)
    texts = kind == "U" or (kind == "O" and count and all(type(value) is str for value in values))
    if not (kind in "iufb" or texts) or values.ndim != 1 or not values.dtype.isnative:
        return pa.array(values)
    nothing_null = None
    if kind == "b":
        packed = pa.py_buffer(np.packbits(values, bitorder="little"))
        return pa.Array.from_buffers(pa.bool_(), count, [nothing_null, packed])
    if texts:
        encoded = [text.encode() for text in values.tolist()]
        ends = np.cumsum([0, *map(len, encoded)])
        if ends[-1] >= 2**31:  # more than this layout counts
            return pa.array(values)
        ends = ends.astype(np.int32)
        return pa.Array.from_buffers(
            pa.string(), count, [nothing_null, pa.py_buffer(ends), pa.py_buffer(b"".join(encoded))]
        )
    memory = pa.py_buffer(np.ascontiguousarray(values))
    return pa.Array.from_buffers(pa.from_numpy_dtype(values.dtype), count, [nothing_null, memory])


def _to_numpy(column: pa.ChunkedArray) -> AnyArray:
    """Return an Arrow column as an array, read-only; without nulls as `_to_arrow` has them, without pandas."""
    import pyarrow as pa

    if column.null_count or column.num_chunks > 1:
        return column.to_numpy()
    chunk = column.chunk(0) if column.num_chunks else pa.nulls(0, column.type)
    if pa.types.is_integer(chunk.type) or pa.types.is_floating(chunk.type):
        return np.from_dlpack(chunk)
    if pa.types.is_boolean(chunk.type):
        bits = np.frombuffer(chunk.buffers()[1], np.uint8)
        values = np.unpackbits(bits, bitorder="little")[chunk.offset :][: len(chunk)].astype(bool)
    elif pa.types.is_string(chunk.type):
        values = np.array(chunk.to_pylist(), object)
    else:
        return column.to_numpy()
    values.flags.writeable = False
    return values


def footer(path: PathLike) -> pq.FileMetaData:
    """Return the metadata of a parquet file (pyarrow.parquet.FileMetaData). Raises InputError for what is none."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    try:
        return pq.read_metadata(path)
    except (OSError, ValueError, pa.ArrowException) as exc:
        raise InputError(f"not a readable parquet file: {first_line(exc)}", file=path) from None


def check_numbers(path: PathLike, table: ObjectTable, names: Iterable[str]) -> None:
    """Raise InputError if a column of `names` in the table of a file does not have one number per row."""
    for name in names:
        if name in table and (table[name].dtype.kind not in "biuf" or table[name].ndim != 1):
            raise InputError("must be numbers", file=path, key=name, value=str(table[name].dtype))


def _typed(name: str, values: AnyArray, dtype: type[Any]) -> AnyArray:
    try:
        return _fit(values, np.dtype(dtype))
    except (TypeError, ValueError, OverflowError):
        raise InputError("does not fit the column", key=name, allowed=np.dtype(dtype).name) from None


def _fit(values: AnyArray, dtype: np.dtype[Any]) -> AnyArray:
    """Return an array in `dtype`. Raises ValueError for an integer that would change: a fraction, NaN, too large."""
    if dtype.kind != "i" or values.dtype == dtype:
        with np.errstate(over="ignore"):  # infinite: refused where that is no value
            return values.astype(dtype, copy=False)
    with np.errstate(invalid="ignore"):
        fitted = values.astype(dtype)
    if values.dtype.kind not in "OU" and (fitted != values).any():
        raise ValueError("an integer that does not fit")
    return fitted


def write_parquet(path: PathLike, table: pa.Table, meta: Mapping[str, Any]) -> None:
    """Write an Arrow table with `meta` and a checksum of each column (temporary name, fsync, rename)."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    text = json.dumps(meta, sort_keys=True).encode()
    sums = {"": _checksum(text)} | {name: _checksum(_to_numpy(table[name])) for name in table.column_names}
    about = {_META_KEY: text, _SUMS_KEY: json.dumps(sums).encode()}
    # Floats seldom repeat: dictionary encoding would cost more time than all the rest, and a third more space
    repeating = [field.name for field in table.schema if not pa.types.is_floating(field.type)]
    with atomic_path(path) as temporary:
        pq.write_table(table.replace_schema_metadata(about), temporary, compression="zstd", use_dictionary=repeating)


def _checksum(values: bytes | AnyArray) -> int:
    """CRC-32 of bytes or of a column; of their text for strings and lists, which have no plain bytes."""
    if isinstance(values, np.ndarray) and values.dtype == object:
        listed = values.tolist()
        if np.ndarray in set(map(type, listed)):
            listed = [value.tolist() if isinstance(value, np.ndarray) else value for value in listed]
        values = repr(listed).encode()
    return zlib.crc32(values.tobytes() if isinstance(values, np.ndarray) else values)


def _load_meta(path: PathLike, text: bytes) -> dict[str, Any]:
    try:
        return json.loads(text)
    except ValueError:  # also text that is not UTF-8
        raise InputError("damaged: its metadata cannot be read; make it again", file=path) from None
