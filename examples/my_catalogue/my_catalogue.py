"""A catalogue of one's own: objects in a CSV table, a text file a spectrum, magnitudes in any filter."""

from functools import lru_cache
from pathlib import Path

import numpy as np
from astropy import units as u
from astropy.table import Table

from csstsim.catalog.base import CatalogBase
from csstsim.catalog.mock_object import MockObject


class CsvCatalogue(CatalogBase):
    """options: `table`, a CSV file; the spectra it names lie beside it. `curves`: folder of filter curves."""

    PATHS = ("table", "curves")  # relative to the campaign's file

    def __init__(self, options, region):
        super().__init__(options, region)
        self.file, self.curves = Path(options["table"]), Path(options["curves"])
        self._load()

    def _load(self):
        for row in Table.read(self.file, format="ascii.csv"):
            given = {name: row[name] for name in row.colnames if row[name] is not np.ma.masked}
            self.objs.append(MockObject(**given))

    def load_sed(self, obj):
        wave, flux = read(self.file.parent / obj.spectrum)  # rest frame: angstrom, erg / s / cm2 / angstrom
        return Table({"WAVELENGTH": wave * (1 + obj.z) * u.AA, "FLUX": flux / (1 + obj.z) * ERG})

    def load_norm_filt(self, obj):
        if not hasattr(obj, "filter"):  # its spectrum has the height it is observed with
            return None
        wave, response = read(self.curves / obj.filter)
        return Table({"WAVELENGTH": wave, "SENSITIVITY": response})


ERG = u.erg / (u.s * u.cm**2 * u.AA)


@lru_cache(maxsize=1000)
def read(path):
    """Return the two columns of a text file."""
    table = Table.read(path, format="ascii.csv", comment="#")
    return tuple(np.asarray(table[name], dtype=float) for name in table.colnames)
