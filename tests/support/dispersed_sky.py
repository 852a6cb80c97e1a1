"""A user's catalogue with only the paper's four methods, behind a grating."""

import numpy as np
from astropy.table import Table

from csstsim.base.units import ab_photon_density
from csstsim.catalog.astrometry.reduction import icrs
from csstsim.catalog.base import CatalogBase, Region
from csstsim.catalog.light.object_spectra import catalog_spectra
from csstsim.catalog.mock_object import MockObject
from csstsim.catalog.selection.select import ChipView, Noise, select_objects
from csstsim.instrument.chip import Window
from csstsim.instrument.filter import GRID
from csstsim.optics.geometry.wcs import ChipWCS
from csstsim.optics.scatter.scattered_light import Scattered
from csstsim.render.drawing import Drawing
from csstsim.render.slitless.draw_dispersed import draw_dispersed
from support.canvases import blank
from support.csst import BANDS
from support.grating_scene import GV, disperser_of

EXPTIME, NOISE = 150.0, Noise(sky=0.2, dark=0.02, read_noise=5.0)
EVERYWHERE = Window(-6000, 16000, -6000, 16000)


class Flat(CatalogBase):
    """MockObjects of the options: flat f_nu at AB magnitude `ab`; `dip`: a value of their spectra at 5000 A."""

    def __init__(self, options, region=None):
        super().__init__(options, region or Region((), (), (), BANDS))
        self._load()

    def _load(self):
        self.objs.extend(self.options["objects"])

    def load_sed(self, obj):
        flux = ab_photon_density(GRID, obj.ab)
        if hasattr(obj, "dip"):
            flux[np.abs(GRID - 5000) < 1] = obj.dip
        return Table({"WAVELENGTH": GRID, "FLUX": flux})

    def load_norm_filt(self, obj):
        return None


class Sky:
    """Objects at pixels of chip 29: selected, their spectra, drawn."""

    def __init__(self, camera, pointing, observer, psf, objects):
        self.camera, self.psf, self.observer = camera, psf, observer
        self.wcs, self.disperser = ChipWCS(camera.chips[GV], pointing), disperser_of(camera, GV)
        placed = []
        for x, y, values in objects:
            ra, dec = icrs(*self.wcs.pixel_to_world(x, y), observer)
            placed.append(MockObject(**({"ra": float(ra), "dec": float(dec), "type": "star"} | values)))
        self.catalog = Flat({"objects": placed})

    def select(self, window=EVERYWHERE, mag_limit=None, **how):
        seen = self.wcs, self.observer, window, self.camera.filters["GV"], self.camera.telescope, EXPTIME, NOISE
        return select_objects(self.catalog, ChipView(*seen, box=16, disperser=self.disperser, **how), mag_limit)

    def draw(self, objects, window, fidelity="noise_free", tables=None, key=5, dtype=np.float32, scattered=None, **how):
        """Return (image, table, orders, counted)."""
        canvas = blank(window, dtype, **how)
        drawing = Drawing(
            self.wcs,
            self.psf,
            EXPTIME,
            scattered or Scattered(),
            fidelity,
            NOISE.variance(EXPTIME),
            np.uint64(key),
            tables,
        )
        result = draw_dispersed(canvas, objects, catalog_spectra(objects, self.catalog), self.disperser, drawing)
        return canvas.expected, *result, canvas.counted
