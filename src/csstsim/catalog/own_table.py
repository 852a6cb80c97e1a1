"""A catalogue from a table: places, magnitudes in one band or more, and shapes; no code needed.

    catalog: {kind: "csstsim.catalog.own_table:TableCatalog", options: {file: objects.csv}}

Columns are those of `catalog.table.COLUMNS` (units there, and in `catalog.base`), and two that spare typing: `type`
(star, galaxy or quasar; left out: star) and `size` (a galaxy's half-light radius, arcsec, of disk and bulge alike).
`ra`, `dec` and one of mag_nuv ... mag_y are needed; `id` counts from 1 if left out. Magnitudes are AB, observed,
through the camera's own bands, before lensing. Spectra are smooth ones that have all magnitudes given, as
catalog.colours says; lines want a catalogue with `load_sed` (catalog.base).
"""

from functools import cached_property
from pathlib import Path

import numpy as np

from csstsim.catalog.base import CatalogBase
from csstsim.catalog.colours import colour_spectra
from csstsim.catalog.mock_object import MockObjects
from csstsim.catalog.table import BANDS, COLUMNS, GALAXY, STAR, TYPES, ObjectTable
from csstsim.config import SHIPPED
from csstsim.errors import InputError
from csstsim.fits_headers import check_headers
from csstsim.instrument.camera import load_camera
from csstsim.instrument.filter import GRID
from csstsim.text_file import read_text

FORMATS = {".csv": "ascii.csv", ".ecsv": "ascii.ecsv", ".fits": "fits"}
FAINTEST = 100.0  # mag; beyond it numbers stand for something else
_UNITS = {
    **dict.fromkeys(("ra", "dec"), "deg"), **dict.fromkeys(("size", "size_disk", "size_bulge"), "arcsec"),
    **dict.fromkeys(("pmra", "pmdec"), "mas / yr"), "parallax": "mas", "rv": "km / s",
}  # fmt: skip
_OPTIONS = ("file", "columns", "instrument")


class TableCatalog(CatalogBase):
    """Objects of a table.

    options: `file` (.csv, .ecsv or .fits), or `columns`, {name: list of values}; `instrument`, the folder of the camera
    whose bands are meant (default: the one shipped). Raises InputError for a table that cannot be used.
    """

    def __init__(self, options, region):
        super().__init__(options, region)
        for name in set(self.options) - set(_OPTIONS):
            raise InputError("unknown key", key="catalog.options", value=name, allowed=", ".join(_OPTIONS))
        if ("file" in self.options) == ("columns" in self.options):
            raise InputError("give either file or columns", key="catalog.options")
        self._load()

    def _load(self):
        file = self.options.get("file")
        columns = read_table(Path(file)) if file else self.options["columns"]
        self._table = object_table(columns, file or "catalog.options.columns")
        self.objs = MockObjects(self._table)

    @cached_property
    def _filters(self):
        camera = load_camera(Path(self.options.get("instrument") or SHIPPED / "instrument"))
        filters = {name.lower(): filter_ for name, filter_ in camera.filters.items()}
        return [filters[band] for band in BANDS]

    def load_seds(self, rows):
        """Return (len(rows), 18001) spectra [photon / s / m2 / A] on the paper's grid."""
        table = self._table.take(np.asarray(rows, dtype=int))
        return colour_spectra(np.stack([table[f"mag_{band}"] for band in BANDS], axis=1), self._filters)

    def load_sed(self, obj):
        """Return the spectrum of one object: Table of WAVELENGTH [A] and FLUX [photon / s / m2 / A]."""
        from astropy.table import Table

        mags = np.array([[getattr(obj, f"mag_{band}") for band in BANDS]])
        return Table({"WAVELENGTH": GRID, "FLUX": colour_spectra(mags, self._filters)[0]})

    def load_norm_filt(self, obj):
        """Return None: the spectra are absolute."""
        return None


def read_table(path):
    """Return {name: values} of a table's file, blanks as NaN. Raises InputError if it is none."""
    from astropy.table import Table

    if path.suffix.lower() not in FORMATS:
        raise InputError("a table of unknown kind", file=path, key="catalog.options.file", allowed=", ".join(FORMATS))
    form = FORMATS[path.suffix.lower()]
    if form == "fits":
        check_headers(path)
    try:
        table = Table.read(path if form == "fits" else read_text(path), format=form)
        return plain_columns(table)
    except InputError:
        raise
    except Exception as exc:  # astropy's readers raise whatever they meet
        raise InputError(f"not a table that can be read: {str(exc).splitlines()[0]}", file=path) from None


def plain_columns(table):
    """Return {name: numpy array} of an astropy Table, blanks as NaN or "", units turned into csstsim's.

    Raises InputError for a unit that is not one of what the column holds, or a column of more than numbers and words.
    """
    return {name: _plain(name, table[name]) for name in table.colnames}


def _plain(name, column):
    unit, wanted = getattr(column, "unit", None), _UNITS.get(name)
    if unit is not None and wanted is not None and str(unit) != wanted:
        try:
            column = np.ma.filled(np.ma.asarray(column, dtype=float), np.nan) * unit.to(wanted)
        except (TypeError, ValueError):
            raise InputError("a unit that does not fit", key=name, value=str(unit), allowed=wanted) from None
    values = np.ma.asarray(getattr(column, "value", column))
    if values.dtype.kind not in "biufUS" or values.ndim != 1:
        raise InputError("must hold one number or word a row", key=name, value=f"{values.dtype}, {values.shape}")
    if values.dtype.kind == "S":
        values = values.astype(str)
    if values.dtype.kind in "biu" and np.ma.is_masked(values):
        values = values.astype(float)
    return np.ma.filled(values, {"f": np.nan, "U": ""}.get(values.dtype.kind, 0))


def object_table(columns, where):
    """Return columns, {name: (n,) values}, as an ObjectTable with ids, types and sizes [arcsec].

    Raises InputError, which names `where`.
    """
    columns = {name: np.asarray(values) for name, values in columns.items()}
    lengths = {name: len(values) if values.ndim == 1 else values.shape for name, values in columns.items()}
    if len(set(lengths.values())) > 1:
        raise InputError("columns differ in length", file=where, value=str(lengths))
    given = [f"mag_{band}" for band in BANDS if f"mag_{band}" in columns]
    for name in ("ra", "dec", *given):
        if name not in columns:
            raise InputError("a column is missing", file=where, key=name, allowed="ra, dec, one of mag_nuv to mag_y")
        if columns[name].dtype.kind not in "iuf":
            raise InputError("must be numbers", file=where, key=name, value=str(columns[name].dtype))
    if not given:
        allowed = ", ".join(f"mag_{band}" for band in BANDS)
        raise InputError("a column is missing: magnitudes", file=where, key="mag_r", allowed=allowed)
    count = len(columns["ra"])
    mags = np.stack([columns[name] for name in given]).astype(float)
    for bad, message in (
        (~np.isfinite(mags).any(axis=0), "has no magnitude"),
        ((np.abs(mags) > FAINTEST).any(axis=0), f"has a magnitude beyond +-{FAINTEST:g}; leave it blank"),
    ):
        if bad.any():
            raise InputError(f"row {np.flatnonzero(bad)[0] + 1} {message}", file=where, key=", ".join(given))
    columns.setdefault("id", np.arange(1, count + 1))
    if "type" in columns:
        columns["obj_type"] = _types(columns.pop("type"), where)
    if "size" in columns:
        size, galaxy = columns.pop("size"), np.asarray(columns.get("obj_type", np.full(count, STAR))) == GALAXY
        for part in ("size_disk", "size_bulge"):
            columns.setdefault(part, np.where(galaxy, size, 0.0))
    extras = {name if name in COLUMNS else f"user_{name}": values for name, values in columns.items()}
    try:
        return ObjectTable.complete(extras)
    except InputError as error:
        raise InputError(str(error), file=where) from None


def _types(names, where):
    words = [str(name).strip().lower() for name in names]
    unknown = sorted(set(words) - set(TYPES))
    if unknown:
        raise InputError("unknown type", file=where, key="type", value=unknown[0], allowed=", ".join(TYPES))
    return np.array([TYPES.index(word) for word in words], np.int8)
