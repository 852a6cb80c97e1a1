"""The picture of docs/galaxy_shapes.md: galaxies of each kind in r, and one with its knots through GV."""

from pathlib import Path
from types import SimpleNamespace

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from astropy.io import fits

from csstsim.base.rng import stream
from csstsim.catalog.row_files import with_images
from csstsim.catalog.table import GALAXY, ObjectTable
from csstsim.instrument.chip import Window
from csstsim.optics.geometry.wcs import ChipWCS
from csstsim.optics.gratings.dispersion import Disperser
from csstsim.optics.psf.psf_file import PsfSet
from csstsim.optics.psf.psf_set import PsfSampling, make_psf
from csstsim.optics.scatter.scattered_light import scattered_light
from csstsim.render.canvas import Canvas
from csstsim.render.drawing import Drawing
from csstsim.render.imaging import draw
from csstsim.render.slitless.draw_dispersed import draw_dispersed
from csstsim.studies.bench.imaging.cases import Position, Shape, make_row
from csstsim.studies.bench.imaging.methods import drawing_of
from csstsim.studies.bench.setting import POINTING, Setting

HALF, GV, LINE = 60, 29, 5300.0
SHAPE = {"e1": 0.25, "e2": 0.2}
DISK = {"size_disk": 1.0, "size_bulge": 0.25, "bulge_frac": 0.2} | SHAPE
PANELS = {
    "disk, n = 0.5": {"size_disk": 0.8, "n_disk": 0.5} | SHAPE,
    "n = 4": {"size_disk": 0.8, "n_disk": 4.0} | SHAPE,
    "30 knots": DISK | {"knots": 30, "knots_frac": 0.5},
}


def spiral(folder):
    """Return the columns of a galaxy with an image of two arms."""
    y, x = (np.indices((241, 241)) - 120) * 0.03
    r, angle = np.hypot(x, y / 0.6), np.arctan2(y / 0.6, x)
    pixels = np.exp(-r / 0.7) * (1 + 0.9 * np.cos(2 * angle + 5 * np.log(r + 0.05))) + 3 * np.exp(-((r / 0.15) ** 2))
    fits.writeto(folder / "spiral.fits", pixels, overwrite=True)
    columns = {"image_file": np.array([str(folder / "spiral.fits")]), "image_scale": np.array([0.03])}
    return with_images(columns | {"image_pa": np.array([30.0])}, np.array([GALAXY]), "columns")


def panel(setting, columns):
    """Return the expected image of a galaxy in r."""
    x, y = setting.psf.nodes_xy[len(setting.psf.nodes_xy) // 2]
    row = make_row(setting, stream(1, "figure"), 3, Position(x, y), Shape(1e6, 0.0, 0.5), (0.25,) * 4)
    row = row.with_columns(**{name: np.atleast_1d(value) for name, value in columns.items()})
    row = row.with_columns(reach=np.array([120], np.int32))
    window = Window(round(x) - HALF, round(x) + HALF + 1, round(y) - HALF, round(y) + HALF + 1)
    canvas = Canvas(np.zeros(window.shape), window)
    draw.draw_objects(canvas, row, drawing_of(setting, SimpleNamespace(id=3), "noise_free"))
    return canvas.expected


def dispersed(camera, folder):
    """Return the expected light of a bulge's continuum and its disk's knots in a line, about the line, through GV."""
    chip, band, x, y = camera.chips[GV], camera.filters["GV"], 2500.0, 4600.0
    make_psf(
        folder / "GV.h5", chip, band, camera.psf, PsfSampling(2), camera_digest=camera.digest,
        scattered=scattered_light(camera, band),
    )  # fmt: skip
    psf, wcs = PsfSet(folder / "GV.h5", chip=GV), ChipWCS(chip, POINTING)
    disperser = Disperser(camera.gratings[GV], band, camera.telescope)
    ra, dec = wcs.pixel_to_world(np.full(2, x), np.full(2, y))
    table = ObjectTable.complete({
        "id": [1, 2], "obj_type": GALAXY, "ra": ra, "dec": dec, "ra_orig": ra, "dec_orig": dec, "x": [x, x],
        "y": [y, y], "size_disk": [0.3, 1.5], "knots": [0, 12], "knots_frac": [0.0, 1.0], "n_disk": [2.5, 1.0],
        "reach": [100, 100], "lost": 1e-4, "wing": 0.0, **{f"flux{k}": [10.0, 5.0] for k in range(4)},
    }, ())  # fmt: skip

    def spectra(rows, edges):
        centres = 0.5 * (edges[1:] + edges[:-1])
        kinds = np.stack([np.full(len(centres), 2e-3), 0.4 * np.exp(-0.5 * ((centres - LINE) / 3) ** 2)])
        return kinds[rows]

    p, q, r, s = disperser.gratings.left.orders[1].lines(np.array([x]), np.array([y]))[0]
    column, row = round(x + p + q * LINE), round(y + r + s * LINE)
    window = Window(column - HALF, column + HALF + 1, row - HALF, row + HALF + 1)
    canvas = Canvas(np.zeros(window.shape), window)
    draw_dispersed(canvas, table, spectra, disperser, Drawing(wcs, psf, 150.0, None, "noise_free", 60.0, np.uint64(1)))
    return canvas.expected


def draw_figure(path: Path, setting: Setting, folder: Path) -> None:
    """Draw the panels to a PNG file; folder: for files on the way."""
    images = {name: panel(setting, columns) for name, columns in PANELS.items()}
    images["image of a spiral"] = panel(setting, spiral(folder))
    images["bulge, and knots in a line, GV"] = dispersed(setting.camera, folder)
    figure, axes = plt.subplots(1, len(images), figsize=(12, 2.75), layout="constrained")
    for axis, (name, image) in zip(axes, images.items(), strict=True):
        top = image.max()
        axis.imshow(np.arcsinh(image / (0.02 * top)), origin="lower", cmap="gray_r", vmin=0)
        axis.set_title(name, fontsize=9)
        axis.set_axis_off()
    figure.savefig(path, dpi=110)
