"""For the stability suite: an exposure made from a catalogue's bare columns, and the light that it must have.

catalog.selection selects and flags, render.imaging.draw draws. As a program it draws a crowd and prints the result:

    python exposure.py PSF_FILE FIDELITY OBJECTS
"""

import hashlib
import json
import resource
import sys
from dataclasses import dataclass

import numpy as np
import pytest
from scipy.special import gammainc
from support.canvases import blank
from support.csst import BANDS

from csstsim.base.rng import stream
from csstsim.base.shipped import SHIPPED
from csstsim.catalog.astrometry.ephemeris import observer
from csstsim.catalog.astrometry.reduction import icrs
from csstsim.catalog.base import CatalogBase, Region
from csstsim.catalog.flags import NOT_RENDERED
from csstsim.catalog.selection.select import ChipView, Noise, select_objects
from csstsim.catalog.table import GALAXY, ObjectTable
from csstsim.instrument.camera import load_camera
from csstsim.instrument.chip import Window
from csstsim.optics.geometry.wcs import ChipWCS
from csstsim.optics.psf.psf_file import PsfSet
from csstsim.optics.scatter.scattered_light import Scattered, read_scattered
from csstsim.render.drawing import Drawing
from csstsim.render.imaging import draw, reference
from csstsim.render.psf_table import make_table
from csstsim.render.scene import Scene, make_scene
from csstsim.studies.bench.setting import POINTING

WINDOW = Window(4000, 4400, 5000, 5300)
ARCMIN2 = Window(4000, 4811, 5000, 5811)  # a square arc minute
EXPTIME = 100.0  # s
NOISE = Noise(sky=0.3, dark=0.02, read_noise=5.0)
X, Y = 4200.3, 5149.8  # near its middle
SCALE = 0.074  # arcsec per pixel
FIDELITIES = ("standard", "noise_free", "preview")
_ANGLES = 2 * np.pi * (np.arange(20000) + 0.5) / 20000


class Listed(CatalogBase):
    """Objects as columns, with their electrons / s in the four sub-bands."""

    def __init__(self, table, rates):
        super().__init__({}, Region((), (), (), BANDS))
        self._table, self._rates = table, rates

    def _load(self): ...

    def load_sed(self, obj): ...

    def load_norm_filt(self, obj): ...

    def load_fluxes(self, rows, filter, telescope):
        return self._rates[rows].copy()


@dataclass(frozen=True, eq=False)
class Exposure:
    """What came of an exposure."""

    image: np.ndarray  # expected electrons
    counted: np.ndarray | None
    table: ObjectTable
    scene: Scene  # of the objects that could be drawn

    @property
    def light(self):
        """All electrons, expected and counted, (ny, nx) float64."""
        return self.image + (0.0 if self.counted is None else self.counted.astype(float))

    def check(self):
        """Hold what must hold of every exposure: finite, nothing negative, all light accounted for; return self."""
        table, light = self.table, self.light
        assert np.isfinite(light).all() and light.min() >= 0
        names = ("drawn", "fraction", "ms", "electrons") + (("error",) if "reference" not in table["method"] else ())
        for name in names:
            assert np.isfinite(table[name]).all() and (table[name] >= 0).all(), name
        # Pixels are float32, added to one by one
        assert light.sum() == pytest.approx(table["drawn"].sum(), rel=1e-4, abs=1e-30)
        return self

    def digest(self):
        """Return a hash of the planes and the truth, the clock left out."""
        total = hashlib.sha256(self.image.tobytes())
        total.update(b"" if self.counted is None else self.counted.tobytes())
        for name in sorted(set(self.table.names) - {"ms"}):
            total.update(self.table[name].tobytes())
        return total.hexdigest()


class Site:
    """A chip under one pointing; `expose` makes an Exposure of objects on it."""

    def __init__(self, camera, psf, tables):
        self.camera, self.psf, self.tables = camera, psf, tables
        self.wcs = ChipWCS(camera.chips[9], POINTING)
        self.craft = observer(POINTING.mjd, POINTING.sat_position, POINTING.sat_velocity)

    def expose(
        self, x, y, fidelity="standard", *, electrons=1e4, window=WINDOW, key=1, wings=False, spoilt=(), **columns
    ):
        """Return the Exposure of objects at pixels x, y, checked (Exposure.check).

        electrons: of the exposure, before magnification, (n,) or one for all; anything is allowed. spoilt: (column,
        row, value) put in at last. wings: whether light goes beyond the PSF's box. columns: of the catalogue.
        """
        x, y = np.broadcast_arrays(*(np.atleast_1d(np.asarray(v, float)) for v in (x, y)))
        ra, dec = icrs(*self.wcs.pixel_to_world(x, y), self.craft)
        catalogue = ObjectTable.complete({"id": np.arange(len(x)), "ra": ra, "dec": dec} | columns, BANDS)
        for name, row, value in spoilt:
            catalogue[name][row] = value
        rates = np.repeat(np.broadcast_to(np.asarray(electrons, float), len(x))[:, None] / (4 * EXPTIME), 4, axis=1)
        scattered = Scattered(read_scattered(self.psf).wing) if wings else Scattered()
        seen = self.wcs, self.craft, window, self.camera.filters["r"], self.camera.telescope, EXPTIME, NOISE
        table = select_objects(Listed(catalogue, rates), ChipView(*seen, scattered=scattered, box=32))
        canvas, how = blank(window), (fidelity, NOISE.variance(EXPTIME), np.uint64(key), self.tables)
        drawing = Drawing(self.wcs, self.psf, EXPTIME, scattered, *how)
        drawn = (reference if fidelity == "reference" else draw).draw_objects(canvas, table, drawing)
        image, counted = canvas.expected, canvas.counted
        good = table.take(drawn["flags"] & NOT_RENDERED == 0)
        return Exposure(image, counted, drawn, make_scene(good, self.wcs, self.psf, EXPTIME)).check()


def inside(scene, i, bounds):
    """Return the share of galaxy i's profile within x0, x1, y0, y1 (half-open), before the PSF: along rays, exactly."""
    x0, x1, y0, y1 = bounds
    way = scene.matrix[i] @ np.stack([np.cos(_ANGLES), np.sin(_ANGLES)])  # px per arcsec
    edges = np.array([[x0, x1], [y0, y1]]) - 0.5 - np.array([[scene.x[i]], [scene.y[i]]])
    at = edges[:, :, None] / way[:, None, :]  # arcsec
    enter, leave = at.min(axis=1).max(axis=0), at.max(axis=1).min(axis=0)
    total = 0.0
    for light, (n, b, r) in zip(scene.component_fractions[i], scene.sersic[i], strict=True):
        if light > 0 and n > 0:
            reached = [
                gammainc(2 * n, b * (np.maximum(t, 0) / r) ** (1 / n)) for t in (enter, np.maximum(enter, leave))
            ]
            total += light * (reached[1] - reached[0]).mean()
    return total


def stamp_bounds(x, y, reach, window):
    """Return x0, x1, y0, y1 of a stamp's pixels on a window."""
    column, row = round(x), round(y)
    return (
        max(column - reach, window.x0), min(column + reach + 1, window.x1),
        max(row - reach, window.y0), min(row + reach + 1, window.y1),
    )  # fmt: skip


def crowd(n, seed=1, window=WINDOW):
    """Return (x, y, columns) of n galaxies and stars on a window, as a faint sky has them."""
    rng = stream(seed, "stability", "crowd")
    x, y = rng.uniform(window.x0, window.x1, n) - 0.5, rng.uniform(window.y0, window.y1, n) - 0.5
    columns = {
        "obj_type": np.where(rng.random(n) < 0.9, GALAXY, 0).astype(np.int8), "size_disk": rng.lognormal(-1.2, 0.5, n),
        "size_bulge": rng.lognormal(-2.0, 0.5, n), "bulge_frac": rng.random(n), "e1": rng.uniform(-0.4, 0.4, n),
        "e2": rng.uniform(-0.4, 0.4, n),
        "electrons": np.exp(rng.uniform(0, np.log(1e3), n)) * np.where(rng.random(n) < 1e-3, 1e3, 1.0),
    }  # fmt: skip
    return x, y, columns


def main(psf_file, fidelity, count):
    psf = PsfSet(psf_file, chip=9)
    site = Site(load_camera(SHIPPED / "instrument"), psf, make_table(psf))
    x, y, columns = crowd(100, window=ARCMIN2)
    site.expose(x, y, fidelity, window=ARCMIN2, **columns)  # compiled, and what stays in memory is there
    before = resource.getrusage(resource.RUSAGE_SELF)
    x, y, columns = crowd(int(count), window=ARCMIN2)
    got = site.expose(x, y, fidelity, window=ARCMIN2, **columns)
    after = resource.getrusage(resource.RUSAGE_SELF)
    about = {"digest": got.digest(), "drawn": got.table["drawn"].sum(), "electrons": got.table["electrons"].sum()}
    about |= {"bytes": 1024 * (after.ru_maxrss - before.ru_maxrss), "cpu_s": after.ru_utime - before.ru_utime}
    print(json.dumps(about))


if __name__ == "__main__":
    main(*sys.argv[1:])
