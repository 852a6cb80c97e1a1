"""The reference renderer for spectra: against monochromatic draws one by one, a closed form, and slabs and photons."""

import galsim
import numpy as np
import pytest
from render.imaging.test_reference import objects
from support.canvases import blank, counting

from csstsim.base.counter import object_keys
from csstsim.catalog.table import GALAXY
from csstsim.instrument.chip import Window
from csstsim.optics.geometry.wcs import ChipWCS
from csstsim.optics.gratings.dispersion import Disperser
from csstsim.optics.psf.psf_file import PsfSet, pixel_response
from csstsim.optics.psf.psf_set import PsfSampling, make_psf
from csstsim.optics.scatter.scattered_light import read_scattered, scattered_light
from csstsim.render.drawing import Drawing
from csstsim.render.imaging.reference import lattice
from csstsim.render.psf_table import read_tables, write_tables
from csstsim.render.scene import make_scene
from csstsim.render.slitless.dispersed_photons import shoot_spectra
from csstsim.render.slitless.reference_dispersed import draw_objects
from csstsim.render.slitless.slabs import draw_spectra
from csstsim.render.slitless.traces import Traces

CHIP, EXPTIME = 29, 150.0
X, Y = 2500.3, 4600.7  # on the left grating, whose first order lies to the right
FLUX = 1e-3  # relative: GalSim leaves out half a pixel at the edge of the PSF's box
EDGE = 2e-2  # relative: in the pixel on the line between two gratings light is taken as even
PIXEL = 5e-4  # of the peak: interpolations of the stored cells


@pytest.fixture(scope="module")
def setting(camera, make_pointing, tmp_path_factory):
    path, chip = tmp_path_factory.mktemp("psf") / "GV.h5", camera.chips[CHIP]
    band = camera.filters["GV"]
    scattered = scattered_light(camera, band)
    make_psf(path, chip, band, camera.psf, PsfSampling(2), camera_digest=camera.digest, scattered=scattered)
    psf = PsfSet(path, chip=CHIP)
    return Disperser(camera.gratings[CHIP], band, camera.telescope), ChipWCS(chip, make_pointing()), psf


def line_at(disperser, wavelength, electrons):
    """Light (bins,) / s of one bin, of so many electrons of the first order of the left grating in EXPTIME."""
    light = np.zeros(len(disperser.edges) - 1)
    k = np.searchsorted(disperser.edges, wavelength) - 1
    light[k] = electrons / EXPTIME / disperser.rates[0, disperser.orders.index(1), k]
    return light, 0.5 * (disperser.edges[k] + disperser.edges[k + 1]), k


def draw(setting, window, light, rows, **more):
    disperser, wcs, psf = setting
    canvas, drawing = blank(window), Drawing(wcs, psf, EXPTIME, **more)
    tables = draw_objects(
        canvas, rows, lambda rows, edges: np.repeat(light[None], len(rows), axis=0), disperser, drawing
    )
    return canvas.expected, *tables


def around(setting, wavelength, half, order=1):
    """A window about where light of that wavelength falls."""
    p, q, r, s = setting[0].gratings.left.orders[order].lines(np.array([X]), np.array([Y]))[0]
    x, y = X + p + q * wavelength, Y + r + s * wavelength
    return Window(round(x) - half, round(x) + half + 1, round(y) - half, round(y) + half + 1), (x, y), abs(q)


@pytest.mark.parametrize("kind", [{}, {"obj_type": GALAXY, "size_disk": 0.3}])
def test_one_bin_is_galsims_own_monochromatic_images(setting, kind):
    """Eight draws along the bin by GalSim alone; the sum of two wavelengths' PSFs by their weights."""
    disperser, wcs, psf = setting
    light, wavelength, k = line_at(disperser, 5200.0, 1e4)
    window, (x, y), q = around(setting, wavelength, 45)
    rows = objects(wcs, X, Y, reach=64, rate=1e4 / EXPTIME, **kind)
    image, table, orders = draw(setting, window, light, rows)
    cells = np.tensordot(disperser.psf_weights[:, k], psf.at(X, Y), axes=1)
    point = lattice(galsim.ImageD(pixel_response(cells, psf.oversampling)), 1 / psf.oversampling, "sb")
    disk = galsim.Exponential(half_light_radius=0.3).transform(*wcs.jacobian(rows["ra"], rows["dec"])[0].ravel())
    profile = galsim.Convolve(disk.withFlux(1.0), point) if kind else point
    wanted = galsim.ImageD(window.nx, window.ny, xmin=window.x0, ymin=window.y0)
    length = q * (disperser.edges[1] - disperser.edges[0])
    for part in (np.arange(8) + 0.5) / 8 - 0.5:
        position = galsim.PositionD(x + part * length, y)
        (profile * (1e4 / 8)).drawImage(wanted, scale=1.0, method="no_pixel", center=position, add_to_image=True)
    assert np.abs(image - wanted.array).max() < PIXEL * wanted.array.max()
    assert image.sum(dtype=float) == pytest.approx(wanted.array.sum(), rel=FLUX)
    mine = orders["order"] == 1
    assert orders["electrons"][mine] == pytest.approx(1e4, rel=1e-9)
    assert orders["drawn"][mine] == pytest.approx(image.sum(dtype=float), rel=1e-5)
    assert table["method"][0] == "reference" and table["drawn"][0] == pytest.approx(orders["drawn"].sum(), rel=1e-6)


@pytest.mark.parametrize("order", [-1, 0, 1, 2])
def test_every_order_stands_where_its_lines_say(setting, order):
    """Centroid of the light of one bin: 0.01 px; light: its fraction of the PSF's box times the order's rate."""
    disperser, wcs, psf = setting
    light, wavelength, k = line_at(disperser, 5400.0, 1e5)
    window, (x, y), _ = around(setting, wavelength, 40, order)
    image, _, _ = draw(setting, window, light, objects(wcs, X, Y, reach=32, rate=1e3))
    cells = np.tensordot(disperser.psf_weights[:, k], psf.at(X, Y), axes=1)
    electrons = light[k] * EXPTIME * disperser.rates[0, disperser.orders.index(order), k]
    assert image.sum(dtype=float) == pytest.approx(electrons * cells.sum(), rel=FLUX)
    n = np.arange(len(cells)) / psf.oversampling - (len(cells) - 1) / 2 / psf.oversampling
    centre = (cells.sum(axis=0) @ n, cells.sum(axis=1) @ n) / cells.sum()
    got = [image.sum(axis=a, dtype=float) @ np.arange(81) / image.sum(dtype=float) for a in (0, 1)]
    assert np.array(got) == pytest.approx(np.array([x - window.x0, y - window.y0]) + centre, abs=0.01)


def test_slabs_and_photons_agree_with_it(setting, tmp_path_factory):
    """A disk of a smooth spectrum: slabs to PIXEL of the peak; 2e6 photons to chi2 of the pixels they can fill."""
    disperser, wcs, psf = setting
    centres = 0.5 * (disperser.edges[1:] + disperser.edges[:-1])
    light = 1 + 0.5 * np.sin(centres / 30.0)
    light *= 1e6 / EXPTIME / (light @ disperser.rates[0, disperser.orders.index(1)])
    window, _, _ = around(setting, 5300.0, 50)
    rows = objects(wcs, X, Y, GALAXY, reach=64, rate=1e6 / EXPTIME, size_disk=0.25)
    image, _, _ = draw(setting, window, light, rows)
    scene, traces = make_scene(rows, wcs, psf, EXPTIME), Traces(light[None] * EXPTIME, np.array([[0, 0, 0]]), disperser)
    canvas = blank(window, float)
    slabs = canvas.expected
    draw_spectra(canvas, scene.sized(64), traces, psf)
    assert np.abs(slabs - image).max() < PIXEL * image.max()
    path = tmp_path_factory.mktemp("tables") / "GV.tables.h5"
    write_tables(path, psf)
    canvas = counting(window)
    keys, table = object_keys(np.uint64(5), np.zeros(1, np.int64)), read_tables(path, psf)
    shoot_spectra(canvas, scene, traces, keys, table)
    counted = canvas.counted
    filled = image > 20
    chi2 = ((counted - image)[filled] ** 2 / image[filled]).mean()
    assert chi2 == pytest.approx(1.0, abs=5 * np.sqrt(2 / filled.sum()))


def test_at_the_split_two_pieces_share_the_light(setting):
    """A star on the line between the gratings: each visit has its side's part of the PSF, together all of it."""
    disperser, wcs, psf = setting
    split = disperser.gratings.split - 0.5
    light, _, k = line_at(disperser, 5200.0, 1e4)
    window = Window(int(split) - 1100, int(split) + 1100, 4500, 4700)
    rows = objects(wcs, split + 0.2, 4600.0, reach=32, rate=1e4 / EXPTIME)
    image, _, orders = draw(setting, window, light, rows)
    first = orders["order"] == 1
    cells = np.tensordot(disperser.psf_weights[:, k], psf.at(split + 0.2, 4600.0), axes=1)
    assert len(orders["drawn"][first]) == 2 and orders["cut"][first].all()
    assert orders["drawn"][first].sum() == pytest.approx(1e4 * cells.sum(), rel=EDGE)
    edges = (np.arange(len(cells) + 1) - len(cells) / 2) / psf.oversampling
    left = np.interp(-0.2, edges, np.append(0.0, np.cumsum(cells.sum(axis=0)))) / cells.sum()
    by_name = dict(zip(orders["grating"][first], orders["drawn"][first], strict=True))
    fraction = by_name[disperser.gratings.left.name] / orders["drawn"][first].sum()
    assert fraction == pytest.approx(left, abs=EDGE + 0.005)
    assert image.sum(dtype=float) > 0


def test_wings_are_those_of_slabs(setting):
    """Light beyond the box: the same electrons and the same pixels far from the trace."""
    disperser, wcs, psf = setting
    light, wavelength, _ = line_at(disperser, 5200.0, 1e7)
    window, _, _ = around(setting, wavelength, 150)
    rows = objects(wcs, X, Y, reach=32, rate=1e7 / EXPTIME, wing=np.array([140.0]))
    scattered = read_scattered(psf)
    image, table, _ = draw(setting, window, light, rows, scattered=scattered)
    scene, traces = make_scene(rows, wcs, psf, EXPTIME), Traces(light[None] * EXPTIME, np.array([[0, 0, 0]]), disperser)
    canvas = blank(window, float)
    slabs = canvas.expected
    draw_spectra(canvas, scene.sized(32, 140.0), traces, psf, scattered)
    far = np.zeros(window.shape, bool)
    far[:100], far[:, :100] = True, True
    assert image[far].sum(dtype=float) == pytest.approx(slabs[far].sum(), rel=1e-5) and image[far].sum() > 1e3
    assert image.sum(dtype=float) == pytest.approx(slabs.sum(), rel=FLUX)
    assert table["drawn"][0] == pytest.approx(image.sum(dtype=float), rel=1e-5)


def test_nothing_to_draw(setting):
    light = np.zeros(len(setting[0].edges) - 1)
    window, _, _ = around(setting, 5200.0, 20)
    image, table, orders = draw(setting, window, light, objects(setting[1], X, Y, rate=0.0))
    assert not image.any() and len(orders) == 0 and table["method"][0] == "none"
    image, table, orders = draw(setting, window, light, objects(setting[1], [], []))
    assert not image.any() and len(table) == 0 and len(orders) == 0
