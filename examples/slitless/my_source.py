"""A galaxy with emission lines, of a spectrum of one's own."""

import numpy as np
from astropy.table import Table

from csstsim.catalog.base import CatalogBase
from csstsim.catalog.mock_object import MockObject

LINES = {4861.3: 0.5, 4958.9: 0.5, 5006.8: 1.5}  # angstrom at rest: peak [photon / s / m2 / angstrom]
WIDTH = 6.0  # angstrom, sigma as observed
CONTINUUM = 0.1  # photon / s / m2 / angstrom


class EmissionLineGalaxy(CatalogBase):
    """options: `ra`, `dec` [deg] and `z`, the redshift."""

    def __init__(self, options, region):
        super().__init__(options, region)
        self._load()

    def _load(self):
        place = {name: self.options[name] for name in ("ra", "dec", "z")}
        self.objs.append(MockObject(id=1, type="galaxy", size_disk=0.15, e1=0.2, **place))

    def load_sed(self, obj):
        wave = np.arange(2000.0, 11000.5, 0.5)
        flux = np.full(wave.size, CONTINUUM)
        for rest, peak in LINES.items():
            flux += peak * np.exp(-0.5 * ((wave - rest * (1 + obj.z)) / WIDTH) ** 2)
        return Table({"WAVELENGTH": wave, "FLUX": flux})

    def load_norm_filt(self, obj):
        return None  # FLUX is absolute
