"""The embedded mock universe as a catalogue: tables read from parquet, spectra computed from their coefficients."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from csstsim.base.digest import digest, file_digest
from csstsim.base.errors import InputError
from csstsim.base.shipped import SHIPPED
from csstsim.catalog.base import CatalogBase, Region
from csstsim.catalog.changing import columns as changing
from csstsim.catalog.galaxy_shapes.component_light import ComponentLight
from csstsim.catalog.galaxy_shapes.full_components import full_components, load_numbers
from csstsim.catalog.light.embedded_spectra import rates, spectra, spectrum_parameters
from csstsim.catalog.light.grating_bound import MARGIN, grating_rate
from csstsim.catalog.light.photometry import subband_weights
from csstsim.catalog.mock_object import MockObject, MockObjects
from csstsim.catalog.table import OPTIONAL, QUASAR, STAR, ObjectTable
from csstsim.catalog.truth_bricks import SED_COLUMNS, brick_meta, read_brick
from csstsim.instrument.filter import GRID, Filter
from csstsim.universe.changing.numbers import number_error, numbers_of
from csstsim.universe.parameters import load_universe

if TYPE_CHECKING:
    from collections.abc import Mapping

    from astropy.table import Table

    from csstsim.base.types import FloatArray, IntArray
    from csstsim.catalog.changing.motion import Interval
    from csstsim.instrument.telescope import Telescope


class SceneCatalog(CatalogBase):
    """A table of objects in the form of the truth bricks, from one file.

    options: `file` (parquet, written by ObjectTable.write, e.g. rows cut out of truth bricks) and `universe`, the
    folder of the spectra's numbers (default: the shipped one). Raises InputError for a damaged or foreign file.
    """

    PATHS: ClassVar[tuple[str, ...]] = ("file", "universe")

    def __init__(self, options: Mapping[str, Any], region: Region) -> None:
        super().__init__(options, region)
        self.universe = load_universe(self.options.get("universe") or SHIPPED / "universe")
        self._load()

    def _load(self) -> None:
        for name in set(self.options) - {"file", "universe"}:
            raise InputError("unknown key", key="catalog.options", value=name, allowed="file, universe")
        if "file" not in self.options:
            raise InputError("required key is missing", key="catalog.options.file")
        file = Path(self.options["file"])
        table = ObjectTable.read(file)
        missing = [name for name in SED_COLUMNS if name not in table]
        if missing:
            raise InputError("not a table of the embedded universe", file=file, key=missing[0])
        self._set(table, [file_digest(file)])

    def _set(self, table: ObjectTable, record: list[dict[str, Any] | str]) -> None:
        self._table = table
        self._record = record
        self.objs = MockObjects(table)  # type: ignore[assignment] # like a list; objects are created on access

    @property
    def truth_hash(self) -> str:
        """16 hex digits of the records of the bricks read; of a scene, of its file."""
        return digest(self._record)

    def load_sed(self, obj: MockObject) -> Table:
        """Return the spectrum of one object: Table of WAVELENGTH [A] and FLUX [photon / s / m2 / A]."""
        from astropy.table import Table

        row = ObjectTable({name: [value] for name, value in obj.values.items()})
        return Table({"WAVELENGTH": GRID, "FLUX": spectra(self.universe, row)[0]})

    def load_norm_filt(self, obj: MockObject) -> None:
        """Return None: the spectra are absolute."""
        return None

    def load_seds(self, rows: IntArray) -> FloatArray:
        """Return (len(rows), 18001) spectra on the paper's grid."""
        return spectra(self.universe, self._table.take(np.asarray(rows, dtype=int)))

    def load_fluxes(self, rows: IntArray, filter: Filter, telescope: Telescope) -> FloatArray:
        """Return (len(rows), 4) electrons / s by linear algebra: those of `load_seds`, to 1e-4."""
        parameters = spectrum_parameters(self._table).take(np.asarray(rows, dtype=int))
        return rates(self.universe, parameters, subband_weights(filter, telescope))

    def load_binned(self, rows: IntArray, edges: FloatArray) -> FloatArray:
        """Return the means of spectra over bins, as CatalogBase.load_binned, without sampling each spectrum."""
        from csstsim.catalog.light.binned_spectra import binned

        return binned(self.universe, spectrum_parameters(self._table).take(np.asarray(rows, dtype=int)), edges)


class EmbeddedCatalog(SceneCatalog):
    """The objects of a region, from its bricks.

    options: `brick_file` (brick number -> path) and the inputs from which the bricks must be made: `seed`, `universe`
    (universe.parameters.Universe), `camera`, `lensing`, `structure`; `components`: `full` for those of
    catalog.galaxy_shapes.full_components. Raises InputError for a missing, damaged or foreign brick.
    """

    _light: ComponentLight | None

    def __init__(self, options: Mapping[str, Any], region: Region) -> None:
        CatalogBase.__init__(self, options, region)
        self.universe = self.options["universe"]
        self._light = None
        self._load()

    def component_shares(self, rows: IntArray, filter: Filter) -> dict[str, FloatArray] | None:
        """Return {column: (len(rows),)} as CatalogBase.component_shares, with `components: full`; otherwise None."""
        if self._light is None:
            return None
        bulge, _, knots = self._light.through(filter, self._table.take(rows)).astype(np.float32).T
        return {"bulge_frac": bulge, "knots_frac": knots}

    def rate_bound(self, rows: IntArray, filter: Filter, telescope: Telescope) -> FloatArray | None:
        """Return the rates of the bricks' magnitudes plus 5% (for a grating, from the bands that cover it), or None."""

        def column(band: Filter) -> str:
            return f"mag_{band.name.lower()}"

        def rates(band: Filter) -> FloatArray:
            return 10.0 ** (0.4 * (band.zeropoint(telescope) - self._table[column(band)][rows]))

        if column(filter) in self._table:
            return MARGIN * rates(filter)
        bands = tuple(band for band in self.options["camera"].filters.values() if column(band) in self._table)
        return grating_rate(filter, bands, rates)

    def _load(self) -> None:
        brick_file = self.options["brick_file"]
        key = {name: self.options[name] for name in ("seed", "universe", "camera", "lensing", "structure")}
        key["bright_stars"] = self.options.get("bright_stars")
        parts: list[ObjectTable] = []
        records: list[dict[str, Any] | str] = []
        for pix in self.region.bricks:
            brick = read_brick(brick_file(pix), brick_meta(pix=pix, **key))
            parts.append(brick.take(self.region.contains(brick["ra"], brick["dec"])))
            records.append(brick.meta)
        table = ObjectTable.concat(parts)
        visitors = self.options.get("visitors")
        if self.options.get("components") == "full":
            table = full_components(table)
            self._light = ComponentLight(self.universe)
            records.append({"components": load_numbers().model_dump()})
        if visitors is not None:
            still = changing.completed({name: default for name, (_, default, _) in changing.MOTION.items()}, len(table))
            plain = {
                name: np.full(len(visitors), OPTIONAL[name][1], OPTIONAL[name][0])
                for name in set(table) & set(OPTIONAL)
            }
            table = ObjectTable.concat([table.with_columns(**still), visitors.with_columns(**plain)])
            records = [*records, digest([visitors[name].tolist() for name in ("id", "ra", "dec")])]
        self._set(table, records)

    def dimming(self, rows: IntArray, interval: Interval, filter: Filter) -> FloatArray | None:
        """Return (len(rows),) mag by which stars and quasars are fainter, as CatalogBase.dimming.

        option `varying`: which kinds vary, of universe.changing.numbers.KINDS.
        """
        from csstsim.universe.changing.variable_quasars import quasar_changes
        from csstsim.universe.changing.variable_stars import star_changes

        kinds = self.options.get("varying", ())
        rows = np.asarray(rows, dtype=int)
        laws = (("variable_stars", STAR, star_changes), ("variable_quasars", QUASAR, quasar_changes))
        if not {name for name, *_ in laws} & set(kinds):
            return None
        change = np.zeros(len(rows))
        for kind, obj_type, law in laws:
            variable = np.flatnonzero(self._table["obj_type"][rows] == obj_type)
            if kind not in kinds or not len(variable):
                continue
            numbers = numbers_of(self.universe.folder, kind)
            wavelength = float(np.average(filter.wavelength, weights=filter.throughput))
            try:
                objects = self._table.take(rows[variable])
                mags = law(self.options["seed"], objects, [interval.middle], wavelength, numbers)
            except (KeyError, TypeError, ValueError, IndexError) as exc:
                raise number_error(self.universe.folder, kind, exc) from exc
            change[variable] = mags[:, 0]
        return change
