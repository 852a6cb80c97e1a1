"""Lines of resolved galaxies, rendered by the renderer without noise: the image with the line less that without it."""

import numpy as np
import pytest
from measure.slitless import binned
from scipy.special import ndtr
from support.dispersed_sky import EXPTIME, Flat, Sky
from support.grating_scene import GV, PIXEL, gaussian_psf

from csstsim.base.units import C_A_S, H_J_S, ab_photon_density
from csstsim.instrument.chip import Window
from csstsim.instrument.filter import GRID
from csstsim.measure.spectra.chosen_orders import Choice
from csstsim.measure.spectra.extract import DispersedImage, Sources, extract_spectra
from csstsim.measure.spectra.line_fluxes import LineFluxes
from csstsim.measure.spectra.line_image import LineImage, point_transforms
from csstsim.measure.spectra.line_profile import ACROSS, ALONG, OFFSETS, Shapes, broadened, psf_profile
from csstsim.measure.spectra.spectral_model import make_model
from csstsim.stages.parts.shapes import shapes_of

WINDOW, PLACE, Z = Window(3990, 4500, 4740, 4860), (3500.3, 4800.2), 0.42
LINE = 3728.48 * (1 + Z)  # [OII], angstrom
SKY, READ_NOISE = 60.0, 5.0  # electron
FLUX, SHIFT = 0.02, 0.1  # tolerances: of the flux, and px
SIGMA = 0.9  # px


class Emitter(Flat):
    """A flat spectrum with [OII] of `photons` / s / m2."""

    def load_sed(self, obj):
        return {"WAVELENGTH": GRID, "FLUX": spectrum(obj.photons)}


def spectrum(photons):
    return ab_photon_density(GRID, 22.0) + photons * np.exp(-0.5 * (GRID - LINE) ** 2) / np.sqrt(2 * np.pi)


@pytest.fixture(scope="module")
def psf(tmp_path_factory):
    return gaussian_psf(tmp_path_factory.mktemp("psf") / "g.h5")


@pytest.fixture(scope="module")
def rendered(camera, make_pointing, observe, psf):
    """Function of photons and a shape: (expected image, truth table, orders, WCS, edges of bins)."""

    def draw(photons, **shape):
        galaxy = {"id": 1, "type": "galaxy", "bulge_frac": 0.0, "size_bulge": 0.1, "photons": photons, "ab": 22.0}
        sky = Sky(camera, make_pointing(), observe(make_pointing()), psf, [(*PLACE, galaxy | shape)])
        sky.catalog.__class__ = Emitter
        image, table, orders, _ = sky.draw(sky.select(WINDOW), WINDOW, dtype=np.float64)
        return image, table, orders, sky.wcs, sky.disperser.edges

    return draw


def measured(camera, psf, photons, scene, z=Z):
    """(row of [OII] in the table of lines, electrons of a photon / s / m2)."""
    image, table, orders, wcs, edges = scene
    bands, area = camera.filters["GV"].psf_wavelength, camera.telescope.area_m2
    model = make_model(camera.gratings[GV], area * EXPTIME, psf.at(*PLACE), psf.oversampling, bands)
    each = binned(spectrum(photons), edges)
    sources = Sources(shapes_of(table, wcs), lambda rows, edges: np.array([each] * len(rows)), edges)
    marks, lines = np.zeros(image.shape, np.uint8), LineFluxes(np.array([z]))
    frame = DispersedImage(WINDOW, (image + SKY).astype(np.float32), marks, None, READ_NOISE)
    extract_spectra(frame, orders, sources, model, psf, choice=Choice(snr_min=0.0), lines=lines)
    found = lines.table()
    [k] = np.flatnonzero(found["line"] == "[OII]")
    one = orders.take(orders["order"] == 1)
    steps = np.gradient(model.cumulative[model.pair(one)], GRID)
    return found.take([k]), model.photons * float(np.interp(LINE, GRID, steps))


@pytest.mark.parametrize("size", [0.1, 0.3, 0.6])
@pytest.mark.parametrize(("e1", "e2"), [(0.0, 0.0), (0.3, 0.0), (-0.15, 0.26), (0.1, -0.28)])
@pytest.mark.parametrize("photons", [3.0, 30.0])
def test_flux_and_position_are_those_of_the_image(camera, psf, rendered, size, e1, e2, photons):
    """Of all pixels, with the line and without: flux to 2%, position to 0.1 px, whatever the galaxy's slant."""
    scene = rendered(photons, size_disk=size, e1=e1, e2=e2)
    line = (scene[0] - rendered(0.0, size_disk=size, e1=e1, e2=e2)[0]).sum(axis=0)
    found, electrons = measured(camera, psf, photons, scene)
    wavelength = found["wavelength"][0]
    flux = found["flux"][0] * wavelength / (H_J_S * C_A_S * 1e3) * electrons
    assert flux == pytest.approx(line.sum(), rel=FLUX)
    assert found["flux_true"][0] == pytest.approx(found["flux"][0], rel=FLUX)
    columns = np.arange(WINDOW.x0, WINDOW.x1)
    near = np.abs(columns - found["column"][0]) < 60
    position = (line * columns)[near].sum() / line[near].sum()
    assert found["column"][0] + found["shift"][0] == pytest.approx(position, abs=SHIFT)


@pytest.mark.parametrize("off", [-0.3, 0.2])  # px
def test_a_line_next_to_its_position_is_found_there(camera, psf, rendered, off):
    """A redshift that is wrong by a part of a column: the shift is right to 0.02 px, its error that of the S/N."""
    scene = rendered(30.0, size_disk=0.2)
    right, _ = measured(camera, psf, 30.0, scene)
    one = scene[2].take(scene[2]["order"] == 1)
    z = (LINE + off / one["q"][0]) / 3728.48 - 1
    found, _ = measured(camera, psf, 30.0, scene, z)
    assert found["column"][0] - right["column"][0] == pytest.approx(off, abs=1e-3)
    assert found["shift"][0] == pytest.approx(-off, abs=0.02)
    width = 0.2 / PIXEL  # px, of the image: between the half-light radius and twice that
    assert width / 2 < found["shift_err"][0] * found["snr"][0] < 3 * width


def image_of(light=(1.0, 0.0), radius=((0.0, 0.0), (0.0, 0.0)), slant=0.0, sigma=SIGMA):
    """(LineImage of a Gaussian PSF in half pixels, its cells of (4, n, n))."""
    line = np.diff(ndtr((np.arange(129) - 64) / 2 / sigma))
    cells = np.repeat(np.outer(line, line)[None], 4, axis=0)
    light, bands = np.asarray(light), np.array([4000.0, 5000.0, 6000.0, 7000.0])
    return LineImage(lambda: point_transforms(cells, 2), bands, light, np.asarray(radius), slant), cells


@pytest.mark.parametrize("x0", [0.0, 0.3, 0.5, -0.49])
def test_a_point_is_the_psf_in_pixels(x0):
    """Gaussian through pixels: error functions, to 2e-4 of the light; weights that know their row."""
    image, _ = image_of()
    x, y = np.arange(-50, 51) - x0, np.arange(-6, 7) + 0.2
    weights = np.outer(np.linspace(1.0, 2.0, len(x)), np.arange(len(y)))
    along, across = (ndtr((one + 0.5) / SIGMA) - ndtr((one - 0.5) / SIGMA) for one in (x, y))
    wanted = along * (weights * across).sum(axis=1)
    assert image.extracted(5432.1, x, y, weights) == pytest.approx(wanted, abs=2e-4 * weights.max())


@pytest.mark.parametrize("radius", [0.7, 4.0, 9.0])
def test_all_rows_together_are_the_profile_along_the_trace(radius):
    """Disk and bulge, slanted: sums over rows with weights of 1 are the collapsed profile to 1e-3 of the light."""
    light, radii = (0.7, 0.3), np.array([[radius, radius / 2], [radius / 2, radius / 4]])
    image, cells = image_of(light, radii, 0.6)
    profile = broadened(psf_profile(cells, 2, ALONG), light, radii[ALONG])[0]
    x, rows = np.arange(-20, 21) + 0.25, np.arange(-31, 32) * 1.0
    wanted = np.interp(x + 0.5, OFFSETS, profile) - np.interp(x - 0.5, OFFSETS, profile)
    found = image.extracted(4000.0, x, rows, np.ones((len(x), len(rows))))
    assert found == pytest.approx(wanted, abs=1e-3)


def test_a_slanted_galaxy_leans():
    """The mean row of a column follows rho b / a x, as of any ellipse; without slant it stays."""
    for slant in (0.0, 0.7, -0.5):
        image, _ = image_of((1.0, 0.0), np.array([[4.0, 0.0], [3.0, 0.0]]), slant, sigma=0.3)
        x, y = np.arange(-6, 7) * 1.0, np.arange(-31, 32) * 1.0
        rows = image.extracted(5000.0, x, y, np.tile(y, (len(x), 1))) / image.extracted(
            5000.0, x, y, np.ones((len(x), len(y)))
        )
        assert np.polyfit(x, rows, 1)[0] == pytest.approx(slant * 3.0 / 4.0, abs=0.02)


def test_the_slant_is_that_of_the_matrix():
    matrix = np.array([[[2.0, 1.5], [0.0, 1.0]], [[3.0, 0.0], [0.0, 1.0]], [[0.0, 0.0], [0.0, 0.0]]])
    points = np.random.default_rng(4).normal(size=(2, 200_000))
    found = Shapes.of(matrix, np.tile([1.0, 0.0], (3, 1)), np.ones((3, 2))).slant
    assert found[0] == pytest.approx(np.corrcoef(matrix[0] @ points)[0, 1], abs=0.01)
    assert found[1:].tolist() == [0.0, 0.0]


@pytest.mark.parametrize("axis, offset", [(ALONG, 1.25), (ACROSS, -2.25)])
def test_a_profile_is_that_of_its_axis(axis, offset):
    """A point next to the middle, 1.25 px in x and -2.25 px in y: half of its flux lies below."""
    cells = np.zeros((4, 32, 32))
    cells[:, 16 - 5, 16 + 2] = 1.0  # [y, x], two to a pixel: from -2.5 to -2, from 1 to 1.5 px
    for profile in psf_profile(cells, 2, axis):
        assert np.interp(0.5, profile, OFFSETS) == pytest.approx(offset, abs=1e-9)
