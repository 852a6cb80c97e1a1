"""The embedded mock universe as a catalogue: bricks read from parquet, spectra made from their coefficients."""

import numpy as np

from csstsim.catalog.base import CatalogBase
from csstsim.catalog.mock_object import MockObjects
from csstsim.catalog.photometry import subband_weights
from csstsim.catalog.table import STAR, ObjectTable
from csstsim.config import digest
from csstsim.instrument.filter import GRID
from csstsim.universe.bricks import brick_meta, read_brick
from csstsim.universe.galaxy_sed import COEFFICIENTS


class EmbeddedCatalog(CatalogBase):
    """The bricks of a region.

    options: `brick_file` (brick number -> path) and what the bricks must have been made for: `seed`, `universe`
    (numbers.Universe), `camera`, `lensing`. Raises InputError for a missing, damaged or foreign brick.
    """

    def __init__(self, options, region):
        super().__init__(options, region)
        self.universe = self.options["universe"]
        self._load()

    def _load(self):
        brick_file = self.options["brick_file"]
        key = {name: self.options[name] for name in ("seed", "universe", "camera", "lensing")}
        bricks = [read_brick(brick_file(pix), brick_meta(pix=pix, **key)) for pix in self.region.bricks]
        self._table = ObjectTable.concat(bricks)
        self._metas = [brick.meta for brick in bricks]
        self.objs = MockObjects(self._table)

    @property
    def truth_hash(self):
        """16 hex digits of the records of all bricks read."""
        return digest(self._metas)

    def load_sed(self, obj):
        """Return the spectrum of one object: Table of WAVELENGTH [A] and FLUX [photon / s / m2 / A]."""
        from astropy.table import Table

        return Table(
            {"WAVELENGTH": GRID, "FLUX": self._spectra(ObjectTable({n: [v] for n, v in obj.values.items()}))[0]}
        )

    def load_norm_filt(self, obj):
        """Return None: the spectra are absolute."""
        return None

    def load_seds(self, rows):
        """Return (len(rows), 18001) spectra on the paper's grid."""
        return self._spectra(self._table.take(np.asarray(rows, dtype=int)))

    def load_fluxes(self, rows, filter, telescope):
        """Return (len(rows), 4) electrons / s by linear algebra: the same light as `load_seds`, to 1e-3."""
        table, weights = self._table.take(np.asarray(rows, dtype=int)), subband_weights(filter, telescope)
        star = table["obj_type"] == STAR
        flux = np.zeros((len(table), len(weights)))
        if star.any():
            some = table.take(star)
            flux[star] = self.universe.star_seds.integrate(some["teff"], some["feh"], weights)
        if not star.all():
            some = table.take(~star)
            flux[~star] = self.universe.galaxy_seds.integrate(some["z"], _mix(some), weights)
        return flux * table["sed_scale"].astype(float)[:, None]

    def _spectra(self, table):
        star = table["obj_type"] == STAR
        seds = np.zeros((len(table), len(GRID)))
        if star.any():
            some = table.take(star)
            shape = self.universe.star_seds.shape(some["teff"], some["feh"])
            seds[star] = shape * some["sed_scale"].astype(float)[:, None]
        if not star.all():
            some = table.take(~star)
            seds[~star] = self.universe.galaxy_seds.spectra(some["z"], _mix(some), some["sed_scale"])
        return seds


def _mix(table):
    return np.column_stack([table[f"coeff{k}"] for k in range(COEFFICIENTS)])
