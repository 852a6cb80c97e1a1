"""A catalogue from a table: positions, magnitudes in one band or more, and shapes; no code needed.

    catalog: {kind: "csstsim.catalog.own_table:TableCatalog", options: {file: objects.csv}}

Columns are those of `catalog.table.COLUMNS` (units there, and in examples/my_catalogue/README.md), and three
shorthands: `type` (star, galaxy or quasar; default star), `size` (half-light radius, arcsec, of both disk and bulge of
a galaxy) and `n` (Sersic index of a galaxy without a bulge). `ra`, `dec` and a magnitude in one of the camera's bands
(mag_nuv ... mag_y of the shipped one) are needed; without `id`, ids count from 1. Magnitudes are AB, observed, through
the camera's bands, before lensing. Spectra are smooth and reproduce all magnitudes given (catalog.light.colours);
emission lines need a catalogue with `load_sed` (catalog.base). Cells may be blank; a row that cannot be rendered is
refused (catalog.object_table). A galaxy's shape is given by `size`, `n`, `bulge_frac`, `e1` and `e2`; a shape
that only other columns describe (`q`, `pa`, `re` and the like) is refused with the conversion formula
(catalog.galaxy_shapes.unsupported_shapes). An object may move or vary: columns rate_ra, rate_dec, rate_mjd,
trail_width, var_period, var_amplitude, var_phase and light_curve (catalog.changing.columns). Other columns are copied
to the truth table as `user_<name>`.
"""

from __future__ import annotations

import hashlib
import mmap
import re
from collections.abc import Callable, Mapping
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from csstsim.base.errors import InputError
from csstsim.base.help_page import explained
from csstsim.catalog.base import CatalogBase, Region
from csstsim.catalog.changing.light_curves import LightCurves, dimming
from csstsim.catalog.light.photometry import subband_weights
from csstsim.catalog.mock_object import MockObject, MockObjects
from csstsim.catalog.object_table import object_table, read_table
from csstsim.catalog.row_files import digest_of, files_of
from csstsim.catalog.table import FILE_COLUMNS
from csstsim.instrument.camera import Camera, load_camera
from csstsim.instrument.filter import GRID, Filter

if TYPE_CHECKING:
    from astropy.table import Table

    from csstsim.base.types import FloatArray, IntArray, PathLike
    from csstsim.catalog.changing.motion import Interval
    from csstsim.catalog.light.file_spectra import FileSpectra
    from csstsim.instrument.telescope import Telescope

_NEEDLE = re.compile(rb"image_file|spectrum_file")
COLUMNS_KEY = "catalog.options.columns"  # what errors name instead of a file
_OPTIONS = ("file", "columns", "instrument", "light_curves")


class TableCatalog(CatalogBase):
    """Objects of a table, as a catalogue.

    Parameters
    ----------
    options : mapping
        `file`, a path (.csv, .ecsv, .fits or .parquet; the last two for millions of rows), or `columns`, {name: (n,)
        values}. Optional are `instrument`, the camera with the bands of the magnitudes, as in a campaign (the default
        is the shipped one), and `light_curves`, the file of the curves that the column light_curve names
        (catalog.changing.light_curves).
    region : Region
        The region of the sky that is simulated; the table may contain more.

    Raises
    ------
    InputError
        For a table that cannot be used.
    """

    PATHS: ClassVar[tuple[str, ...]] = ("file", "instrument", "light_curves")

    @explained("table of objects")
    def __init__(self, options: Mapping[str, Any], region: Region) -> None:
        super().__init__(options, region)
        _check_options(self.options)
        if ("file" in self.options) == ("columns" in self.options):
            raise InputError("give either file or columns", key="catalog.options")
        self._load()

    def _load(self) -> None:
        file = self.options.get("file")
        columns = read_table(file) if file else self.options["columns"]
        self._table = object_table(columns, self._bands, file or COLUMNS_KEY)
        self.objs = MockObjects(self._table)  # type: ignore[assignment] # like a list; objects are created on access
        curves = self.options.get("light_curves")
        self._curves = LightCurves(read_table(curves), curves, self._camera.filters) if curves else None
        names = self._table.get("light_curve", np.zeros(0, str))
        if self._curves:
            self._curves.check(names)
        elif (names != "").any():
            raise InputError(
                "the table names light curves: the option that names their file is missing",
                key="catalog.options.light_curves",
                value=str(names[names != ""][0]),
            )

    def dimming(self, rows: IntArray, interval: Interval, filter: Filter) -> FloatArray | None:
        """Return (len(rows),) mag by which objects are fainter, as CatalogBase.dimming, with the curves of the file."""
        return dimming(self._table, np.asarray(rows, dtype=int), interval, filter, self._curves)

    @classmethod
    def files(cls, options: Mapping[str, Any]) -> tuple[PathLike, ...]:
        """Return the files of the table, of its light curves, and those that its rows name: they affect the pixels.

        Raises InputError for options of another kind, and for columns of files with other values.
        """
        _check_options(options)
        file = options.get("file")
        curves = options.get("light_curves")
        named = (curves,) if curves else ()
        if not file:
            return (*named, *files_of(options.get("columns") or {}, COLUMNS_KEY))
        return (file, *named, *(files_of(read_table(file), file) if _may_name_files(file) else ()))

    @cached_property
    def truth_hash(self) -> str:
        """16 hex digits of the table's (n,) columns and of the files that they name."""
        total = hashlib.sha256()
        for name in self._table:
            values = self._table[name]
            if name in FILE_COLUMNS:  # their content, not their paths
                values = np.array([digest_of(text) for text in values.tolist()], dtype=str)
            total.update(name.encode() + (values.astype(str) if values.dtype == object else values).tobytes())
        return total.hexdigest()[:16]

    @cached_property
    def _camera(self) -> Camera:
        return load_camera(self.options.get("instrument"))

    @property
    def _bands(self) -> dict[str, Filter]:
        """{band: Filter} of the camera."""
        return self._camera.bands

    @property
    def _filters(self) -> list[Filter]:
        return list(self._bands.values())

    def load_seds(self, rows: IntArray) -> FloatArray:
        """Return (len(rows), 18001) spectra [photon / s / m2 / A] on the paper's grid."""
        from csstsim.catalog.light.colours import colour_spectra

        return self._mixed(
            rows, len(GRID), lambda mags: colour_spectra(mags, self._filters), lambda files, at: files.spectra(at)
        )

    def load_fluxes(self, rows: IntArray, filter: Filter, telescope: Telescope) -> FloatArray:
        """Return (len(rows), 4) electrons / s: those of `load_seds`, to 1e-9, without its samples."""
        from csstsim.catalog.light.colours import colour_rates

        weights = subband_weights(filter, telescope)
        return self._mixed(
            rows,
            len(weights),
            lambda mags: colour_rates(mags, self._filters, weights),
            lambda files, at: files.rates(at, weights),
        )

    def load_binned(self, rows: IntArray, edges: FloatArray) -> FloatArray:
        """Return (len(rows), bins) photon / s / m2 / angstrom, as CatalogBase.load_binned, without samples of each."""
        from csstsim.catalog.light.colours import colour_bins

        return self._mixed(
            rows,
            len(edges) - 1,
            lambda mags: colour_bins(mags, self._filters, edges),
            lambda files, at: files.bins(at, edges),
        )

    def _mixed(
        self,
        rows: IntArray,
        width: int,
        from_colours: Callable[[FloatArray], FloatArray],
        from_files: Callable[[FileSpectra, IntArray], FloatArray],
    ) -> FloatArray:
        """Return (len(rows), width): from_colours(mags), or from_files(FileSpectra, its rows) of rows with a file."""
        rows = np.asarray(rows, dtype=int)
        if self._file_spectra is None:
            return from_colours(self._mags(rows))
        files, index = self._file_spectra
        out = np.zeros((len(rows), width))
        has_file = index[rows] >= 0
        out[~has_file] = from_colours(self._mags(rows[~has_file]))
        out[has_file] = from_files(files, index[rows[has_file]])
        return out

    @cached_property
    def _file_spectra(self) -> tuple[FileSpectra, IntArray] | None:
        """(FileSpectra, (n,) the index of each row in it or -1), or None if no row has a spectrum from a file."""
        files = self._table.get("spectrum_file")
        if files is None or not (files != "").any():
            return None
        from csstsim.catalog.light.file_spectra import FileSpectra

        rows = np.flatnonzero(files != "")
        index = np.full(len(files), -1)
        index[rows] = np.arange(len(rows))
        return FileSpectra(files[rows], self._mags(rows), self._filters), index

    def _mags(self, rows: IntArray) -> FloatArray:
        """Return (len(rows), bands) AB magnitudes, NaN where the table gives none."""
        rows = np.asarray(rows, dtype=int)
        return np.stack([self._table[f"mag_{band}"][rows] for band in self._bands], axis=1)

    def load_sed(self, obj: MockObject) -> Table:
        """Return the spectrum of one object: Table of WAVELENGTH [A] and FLUX [photon / s / m2 / A]."""
        from astropy.table import Table

        from csstsim.catalog.light.colours import colour_spectra
        from csstsim.catalog.light.file_spectra import FileSpectra

        mags = np.array([[getattr(obj, f"mag_{band}") for band in self._bands]])
        if obj.spectrum_file:
            return Table(
                {"WAVELENGTH": GRID, "FLUX": FileSpectra([obj.spectrum_file], mags, self._filters).spectra([0])[0]}
            )
        return Table({"WAVELENGTH": GRID, "FLUX": colour_spectra(mags, self._filters)[0]})

    def load_norm_filt(self, obj: MockObject) -> None:
        """Return None: the spectra are absolute."""
        return None


def _check_options(options: Mapping[str, Any]) -> None:
    """Raise InputError for options that TableCatalog does not have, or whose values are of another kind."""
    for name in set(options) - set(_OPTIONS):
        raise InputError("unknown key", key="catalog.options", value=name, allowed=", ".join(_OPTIONS))
    for name in {"file", "light_curves"} & set(options):
        value = options[name]
        if not isinstance(value, str | Path) and not (value is None and name == "light_curves"):
            raise InputError("not the name of a file", key=f"catalog.options.{name}", value=value)
    columns = options.get("columns", {})
    if not isinstance(columns, Mapping) or not all(isinstance(name, str) for name in columns):
        value = type(columns).__name__ if not isinstance(columns, Mapping) else ", ".join(map(str, columns))
        raise InputError("not columns", key=COLUMNS_KEY, value=value, allowed="{name: list of values}")
    for name, values in columns.items():
        try:
            np.asarray(values)
        except ValueError:  # lists of different length
            raise InputError("must have one number or word per row", key=f"catalog.options.columns.{name}") from None


def _may_name_files(file: PathLike) -> bool:
    """Whether a table's bytes contain the name of a column of files; if not, its rows need not be read for them."""
    if not Path(file).is_file() or not Path(file).stat().st_size:
        return False
    with open(file, "rb") as opened, mmap.mmap(opened.fileno(), 0, access=mmap.ACCESS_READ) as content:
        return bool(_NEEDLE.search(content))
