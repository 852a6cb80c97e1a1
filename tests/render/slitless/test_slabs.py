"""Slabs against sums by hand, GalSim and photons: light, position, width, edges, error by number."""

from dataclasses import replace

import galsim
import numpy as np
import pytest
from scipy.special import ndtr
from support.canvases import blank, counting
from support.grating_scene import PIXEL, SIGMA_PX, SPLIT, by_hand, gaussian_psf, scene_of, spectrum_of

from csstsim.catalog.flags import OUTSIDE_PSF_HULL
from csstsim.instrument.chip import Window
from csstsim.optics.scatter.scattered_light import Scattered, scattered_light
from csstsim.render.slitless.dispersed_photons import shoot_spectra
from csstsim.render.slitless.slabs import PER_PX, densities, draw_spectra, meets
from csstsim.render.slitless.traces import Traces

SIGMA = 5.0
WINDOW = Window(1500, 6200, 4780, 4920)
X, Y = 3800.3, 4850.37
REACH = 15


def draw(scene, spectra, disperser, psf, window=WINDOW, reach=REACH, wing=0.0, dtype=float, **how):
    """Return (image, Drawn)."""
    canvas = blank(window, dtype, response=how.pop("response", None))
    count = len(scene)
    spectra = np.broadcast_to(spectra, (count, len(disperser.edges) - 1))
    visits = disperser.visits(scene.x, scene.y, np.full(count, max(reach, wing)))
    traces = Traces(spectra, visits, disperser)
    return canvas.expected, draw_spectra(canvas, scene.sized(reach, wing), traces, psf, **how)


def whole(disperser, spectrum, x=X, y=Y, window=WINDOW, piece=0):
    return sum(
        by_hand(disperser, window, x, y, spectrum * disperser.rates[piece, o], o, piece)
        for o in range(len(disperser.orders))
    )


def rms(image, reference):
    return np.sqrt(((image - reference) ** 2).sum() / (reference**2).sum())


def moments(image):
    y, x = np.indices(image.shape)
    mean = [(image * at).sum() / image.sum() for at in (x, y)]
    return [*mean, *((image * (at - m) ** 2).sum() / image.sum() for at, m in zip((x, y), mean, strict=True))]


@pytest.mark.parametrize("line", [None, (5500.0, 5501.0), (3850.0, 3851.0)])
def test_a_star_is_the_sum_over_its_spectrum(psf, disperser, line):
    """Pixel by pixel 5e-4 of the rms; the first order's light 1e-6, centroid 2e-5 px and variance 1e-4 px^2.

    Faint orders have fewer slabs: light 1e-3, centroid 1e-3 px, variance 1e-2 px^2.
    """
    spectrum = spectrum_of(disperser, 1e6, *line) if line else spectrum_of(disperser, 1e6)
    image, out = draw(scene_of(psf, X, Y), spectrum, disperser, psf)
    assert rms(image, whole(disperser, spectrum)) < 5e-4
    assert out.drawn.sum() == pytest.approx(image.sum(), rel=1e-9)
    for o, (x0, x1, y0, y1) in enumerate(out.box[0]):
        light = spectrum * disperser.rates[0, o]
        loose = 1 if disperser.orders[o] == 1 else 50
        assert out.drawn[0, o] == pytest.approx(light.sum(), rel=loose * (1e-6 if x0 > WINDOW.x0 else 1e-4))
        cut = slice(y0 - WINDOW.y0, y1 - WINDOW.y0), slice(x0 - WINDOW.x0, x1 - WINDOW.x0)
        found, wanted = moments(image[cut]), moments(by_hand(disperser, WINDOW, X, Y, light, o, 0)[cut])
        assert np.abs(np.subtract(found, wanted))[:2].max() < loose * 2e-5
        # Across, that of a Gaussian to 15 px; along, of up to 1000 px, twice the length times the centroid's
        assert abs(found[3] - wanted[3]) < loose * 1e-4
        assert abs(found[2] - wanted[2]) < loose * (1e-4 + 1e-7 * wanted[2])
    lit = np.zeros(WINDOW.shape, bool)
    for x0, x1, y0, y1 in out.box[0]:
        lit[y0 - WINDOW.y0 : y1 - WINDOW.y0, x0 - WINDOW.x0 : x1 - WINDOW.x0] = True
    assert not image[~lit].any()


def test_more_slabs_are_nearer_the_truth(psf, disperser):
    """Of the rms: below 7e-2, 8e-3 and 1e-3 with 1, 2 and 4 slabs a pixel, at phases all over a pixel."""
    spectrum = spectrum_of(disperser, 1e6, 4320, 4321) + spectrum_of(disperser, 1e6)
    worst = []
    for count in (1, 2, 4, 8):
        errors = []
        for shift in (0.0, 0.13, 0.29, 0.44):
            scene = scene_of(psf, X + shift, Y + shift)
            image, _ = draw(scene, spectrum, disperser, psf, per_px=count)
            errors.append(rms(image, whole(disperser, spectrum, X + shift, Y + shift)))
        worst.append(max(errors))
    assert worst[0] < 7e-2 and worst[1] < 8e-3 and worst[2] < 1e-3 and worst[3] <= worst[2]
    assert worst[0] > 5 * worst[1] > 25 * worst[2]
    assert PER_PX == 4


def test_colours_do_not_come_in_steps(psf, disperser):
    """Peak of each column over the sum by hand: the PSF grows smoothly along the first order, 1e-3 everywhere."""
    spectrum = spectrum_of(disperser, 1e6)
    image, _ = draw(scene_of(psf, X, Y), spectrum, disperser, psf)
    light = spectrum * disperser.rates[0, 3]
    expected = by_hand(disperser, WINDOW, X, Y, light, 3, 0)
    lit = expected.max(axis=0) > 0.02 * expected.max()
    lit[: 4300 - WINDOW.x0] = False
    assert lit.sum() > 300
    ratio = image[:, lit].max(axis=0) / expected[:, lit].max(axis=0)
    assert np.abs(ratio - 1).max() < 1e-3


def galaxy_by_hand(index, size, bulge, matrix, x, y, window, sigma):
    """GalSim's galaxy under a Gaussian PSF, of light 1."""
    parts = []
    for n, radius, light in zip(index, size, (1 - bulge, bulge), strict=True):
        if light > 0:
            profile = galsim.Sersic(n, half_light_radius=radius).transform(*(np.asarray(matrix) / PIXEL).ravel())
            parts.append(profile.withFlux(light))
    params = galsim.GSParams(folding_threshold=1e-4, maximum_fft_size=16384)
    profile = galsim.Convolve(galsim.Sum(parts), galsim.Gaussian(sigma=sigma, gsparams=params), gsparams=params)
    image = galsim.ImageD(window.nx, window.ny, xmin=window.x0, ymin=window.y0)
    return profile.drawImage(image, scale=1.0, center=galsim.PositionD(x, y)).array


@pytest.mark.parametrize(
    "index, size, bulge, matrix",
    [
        ((1, 4), (0.25, 0.1), 0.0, [[1.2, 0.3], [0.3, 0.8]]),
        ((1, 4), (0.6, 0.05), 0.3, [[1.0, 0.0], [0.0, 1.0]]),  # a bulge that is a point in a wide disk
        ((1, 4), (0.5, 0.1), 0.0, [[0.35, 0.0], [0.0, 2.8]]),  # edge-on, across the dispersion
    ],
)
def test_a_galaxys_line_is_galsims(psf, disperser, index, size, bulge, matrix):
    """One wavelength, where the PSF has sigma 1.0 px: 3e-3 of the rms, most of it GalSim's and the profiles' own."""
    spectrum = spectrum_of(disperser, 1e6, 4972, 4973)
    bin = np.flatnonzero(spectrum)[0]
    wave = disperser.edges[bin : bin + 2].mean()
    p, q, r, s = disperser.gratings.left.orders[1].lines(X, Y)
    x, y = X + p + q * wave, Y + r + s * wave
    window = Window(4400, 4620, 4750, 4950)
    scene = scene_of(psf, X, Y, index=index, size=size, bulge=bulge, matrix=matrix)
    image, out = draw(scene, spectrum, disperser, psf, window=window, reach=80)
    expected = 1e6 * galaxy_by_hand(index, size, bulge, matrix, x, y, window, 1.0)
    assert rms(image, expected) < 3e-3
    # Stamps are squares of 80 px
    assert image.sum() == pytest.approx(expected.sum(), rel=2e-3)
    assert np.subtract(moments(image)[:2], moments(expected)[:2]) == pytest.approx(0, abs=5e-3)
    assert out.flags[0] == 0


@pytest.mark.parametrize("kind", ["star", "disk", "both"])
@pytest.mark.parametrize("line", [None, (5200.0, 5220.0)])
def test_photons_agree_within_poisson(psf, tables, disperser, kind, line):
    """2e6 electrons: chi^2 over pixels, over squares of 10 px and over orders."""
    index, bulge = {"star": ((0, 0), 0.0), "disk": ((1, 0), 0.0), "both": ((1, 4), 0.3)}[kind]
    scene = scene_of(psf, X, Y, index=index, size=(0.3, 0.15), bulge=bulge)
    spectrum = spectrum_of(disperser, 2e6, *line) if line else spectrum_of(disperser, 2e6)
    window = Window(1500, 6200, 4650, 5050)
    reach = REACH if kind == "star" else 90
    image, out = draw(scene, spectrum, disperser, psf, window=window, reach=reach)
    canvas, visits = counting(window), disperser.visits(scene.x, scene.y, np.array([float(reach)]))
    traces = Traces(spectrum[None], visits, disperser)
    drawn, _ = shoot_spectra(canvas, scene, traces, np.array([3], np.uint64), tables)
    counted = canvas.counted
    for image_, counted_ in ((image, counted), (squares(image), squares(counted))):
        used = image_ > 20
        chi2 = ((counted_ - image_)[used] ** 2 / image_[used]).sum()
        assert abs(chi2 - used.sum()) < SIGMA * np.sqrt(2 * used.sum())
    lost = 2e-3 if kind == "both" else 0.0  # of the bulge's light, beyond the stamp
    assert (np.abs(drawn - out.drawn) < SIGMA * np.sqrt(out.drawn) + lost * out.drawn)[0].all()


def squares(image):
    return image.reshape(image.shape[0] // 10, 10, -1, 10).sum(axis=(1, 3))


def test_a_window_shows_what_the_chip_shows(psf, disperser):
    """The same to 2e-5 of the brightest pixel; what a box on the window says is where its light is."""
    scene = scene_of(psf, np.array([X, 3300.2]), np.array([Y, 4860.9]), index=(1, 4), bulge=0.2, size=(0.2, 0.1))
    spectrum = spectrum_of(disperser, 1e6)
    image, _ = draw(scene, spectrum, disperser, psf, reach=40)
    for window in (Window(4200, 4500, 4820, 4870), Window(4321, 4360, 4850, 4853), Window(3790, 3830, 4840, 4870)):
        part, out = draw(scene, spectrum, disperser, psf, window=window, reach=40)
        cut = slice(window.y0 - WINDOW.y0, window.y1 - WINDOW.y0), slice(window.x0 - WINDOW.x0, window.x1 - WINDOW.x0)
        assert np.abs(part - image[cut]).max() < 2e-5 * image.max()  # blocks of 16 px begin elsewhere
        assert out.drawn.sum() == pytest.approx(part.sum(), rel=1e-9)
        x0, x1, y0, y1 = out.box[out.box[..., 1] > 0].T
        assert x0.min() >= window.x0 and x1.max() <= window.x1 and y0.min() >= window.y0 and y1.max() <= window.y1
    single, _ = draw(scene, spectrum, disperser, psf, reach=40, dtype=np.float32)
    assert np.abs(single - image).max() < 1e-6 * image.max()


def test_the_response_is_that_of_the_pixel(psf, disperser):
    response = np.random.default_rng(1).uniform(0.5, 1.0, WINDOW.shape).astype(np.float32)
    scene, spectrum = scene_of(psf, X, Y), spectrum_of(disperser, 1e6)
    bare, _ = draw(scene, spectrum, disperser, psf)
    image, out = draw(scene, spectrum, disperser, psf, response=response)
    assert np.abs(image - bare * response).max() < 1e-6 * bare.max()
    assert out.drawn.sum() == pytest.approx(image.sum(), rel=1e-9)


@pytest.mark.parametrize("offset", [-10.3, -0.7, 0.0, 0.4, 10.2])
def test_a_star_on_the_split_is_divided_as_its_direct_image(psf, disperser, offset):
    """Each grating's light is the Gaussian's on its side, to 1.5e-3; 5e-4 more in all: cubics dip below 0."""
    spectrum = spectrum_of(disperser, 1e6, 5544, 5545)  # sigma 1.2 px
    window = Window(4000, 7200, 4800, 4900)
    image, out = draw(scene_of(psf, SPLIT + offset, Y), spectrum, disperser, psf, window=window)
    right = ndtr(offset / 1.2)
    for o, number in enumerate(disperser.orders):
        if number in (0, 1):
            total = disperser.rates[0, o] @ spectrum
            assert out.drawn[:, o] == pytest.approx(np.array([1 - right, right]) * total, abs=1.5e-3 * total)
            assert out.drawn[:, o].sum() == pytest.approx(total, rel=5e-4)
    assert image.min() >= 0


def test_a_wide_galaxy_on_the_split(psf, disperser):
    """What each grating draws is the direct image's light on its side: GalSim's image, summed."""
    spectrum = spectrum_of(disperser, 1e6, 4972, 4973)
    x, window = SPLIT - 6.2, Window(4000, 7200, 4650, 5050)
    scene = scene_of(psf, x, Y, index=(1, 4), size=(0.5, 0.1), bulge=0.2)
    _, out = draw(scene, spectrum, disperser, psf, window=window, reach=90)
    direct = galaxy_by_hand((1, 4), (0.5, 0.1), 0.2, np.eye(2), x, Y, Window(5431, 5631, 4760, 4940), 1.0)
    left = direct[:, : int(SPLIT + 0.5) - 5431].sum() / direct.sum()
    assert 0.6 < left < 0.9
    assert out.drawn[:, 3] / out.drawn[:, 3].sum() == pytest.approx([left, 1 - left], abs=1e-3)
    assert out.drawn[:, 3].sum() == pytest.approx(1e6, rel=3e-3)


@pytest.mark.parametrize("wing", [0.0, 150.0, 900.0])
def test_wings_are_divided_too(camera, disperser, wing, tmp_path):
    """A star near and far from the split: the light of both gratings together is that of the star far from any edge."""
    psf = gaussian_psf(tmp_path / "dim.h5", light=0.95)
    scattered = Scattered(scattered_light(camera, camera.filters["GV"]).wing)
    spectrum = spectrum_of(disperser, 1e6, 5500, 5600)
    window = Window(3600, 7400, 3850, 5850)
    sums = {}
    for x in (4500.0, SPLIT - 100.0, SPLIT - 10.0, SPLIT, SPLIT + 60.0):
        _, out = draw(scene_of(psf, x, Y), spectrum, disperser, psf, window=window, wing=wing, scattered=scattered)
        sums[x] = out.drawn[:, disperser.orders.index(0)].sum()  # the zeroth order, whose place hardly moves
    alone = spectrum @ disperser.rates[0, 2]
    assert 0.97 * alone < sums[4500.0] < 0.999 * alone  # 95% in the box, and the wing as far as the window goes
    for x in list(sums)[1:]:
        assert sums[x] == pytest.approx(sums[4500.0], rel=1e-3)


def test_borders_of_the_chip_and_of_the_frame(psf, disperser):
    """About the four sides: what falls on the frame is the sum by hand; a star outside is dark, on the edge halved."""
    chip = Window(0, 9216, 4700, 5000)
    spectrum = spectrum_of(disperser, 1e6)
    for x, piece in ((-700.3, 0), (-1500.0, 0), (5.2, 0), (9210.7, 1), (9500.4, 1), (9800.1, 1)):
        image, out = draw(scene_of(psf, x, Y), spectrum, disperser, psf, window=chip)
        expected = whole(disperser, spectrum, x, Y, chip, piece)
        assert expected.sum() > 1e3
        assert image.sum() == pytest.approx(expected.sum(), rel=1e-4)
        assert np.abs(image - expected).max() < 2e-3 * expected.max()
        assert out.drawn.sum() == pytest.approx(image.sum(), rel=1e-9)
    image, out = draw(scene_of(psf, 9216 + 1500.0, Y), spectrum, disperser, psf, window=chip)
    assert len(out.drawn) == 0 and not image.any()
    line = spectrum_of(disperser, 1e6, 5544, 5545)
    (x0, *_), (_, x1, y0, y1) = disperser.rectangles
    for x, y in ((x0, 3000.3), (x1, 3000.3), (3000.3, y0), (3000.3, y1)):
        around = Window(int(x) - 2000, int(x) + 2000, int(y) - 30, int(y) + 30)
        _, out = draw(scene_of(psf, x, y), line, disperser, psf, window=around)
        assert out.drawn[:, disperser.orders.index(1)].sum() == pytest.approx(5e5, rel=2e-3)
        assert out.flags[0] == OUTSIDE_PSF_HULL
    top = Window(2000, 6000, 0, 60)  # a star above and below the chip's rows, 2 px up by the wedge
    for y, smallest in ((-6.0, 10.0), (-40.0, 0.0)):
        image, _ = draw(scene_of(psf, X, y), spectrum, disperser, psf, window=top)
        expected = whole(disperser, spectrum, X, y, top)
        assert image.sum() == pytest.approx(expected.sum(), rel=2e-3, abs=1e-6)
        assert (image.sum() > smallest) == (smallest > 0)


def test_no_light_and_no_object(psf, disperser):
    scene = scene_of(psf, X, Y)
    image, out = draw(scene, 0 * disperser.rates[0, 0], disperser, psf)
    assert not image.any() and not out.drawn.any() and not out.box.any()
    image, out = draw(scene.take(np.zeros(0, int)), disperser.rates[0, 0], disperser, psf)
    assert out.drawn.shape == (0, 5)
    line = spectrum_of(disperser, 1.0, 5500, 5501)
    image, out = draw(scene, line, disperser, psf)
    assert image.sum() == pytest.approx(line @ disperser.rates[0].sum(axis=0), rel=1e-6)
    single, _ = draw(replace(scene, electrons=0 * scene.electrons), line, disperser, psf)
    assert (single == image).all()  # of no use here: the spectrum has the light
    assert max(SIGMA_PX) * 10 <= REACH


class Shapes:
    """What `densities` reads of a scene: one object, its disk and its bulge."""

    def __init__(self, light, size, matrix=((1, 0), (0, 1)), spot=None, index=(1.0, 4.0)):
        self.component_fractions, self.matrix = np.array([light]), np.array([matrix], float)
        self.sersic = np.array([[(index[0], 0.0, size[0]), (index[1], 0.0, size[1])]])
        self.spot = None if spot is None else np.array([spot])

    def __len__(self):
        return 1


@pytest.mark.parametrize(("scene", "largest", "wanted"), [
    (Shapes((1, 0), (1, 1)), 64, 8), (Shapes((0, 1), (1, 1)), 64, 32), (Shapes((0, 1), (1, 1)), 16, 16),
    (Shapes((0.5, 0.5), (1, 1)), 64, 16), (Shapes((1, 0), (4, 1)), 64, 2), (Shapes((1, 0), (99, 1)), 64, 1),
    (Shapes((1, 0), (1, 1), ((2, 0), (0, 1))), 64, 4), (Shapes((1, 0), (1, 1), ((1, 0), (0, 2))), 64, 8),
    (Shapes((1, 0), (1, 1), ((0, -2), (1, 0))), 64, 4), (Shapes((1, 0), (1, 1), index=(0.5, 4.0)), 64, 8),
    (Shapes((1, 0), (1, 1), index=(2.5, 4.0)), 64, 16), (Shapes((1, 0), (4, 1), spot=0), 64, 64),
    (Shapes((1, 0), (4, 1), spot=3), 32, 32), (Shapes((1, 0), (4, 1), spot=-1), 64, 2),
])  # fmt: skip
def test_slabs_per_pixel_by_hand(scene, largest, wanted):
    """8 per half-light radius of a disk along x and 24 of a bulge, as a power of two; spots as dense as points."""
    assert densities(scene, largest).tolist() == densities(scene, np.array([largest])).tolist() == [wanted]


def test_stamps_meet_a_window_that_they_reach():
    """On either side of each axis; points above and below a window in turn have it between them."""
    window = Window(100, 140, 20, 50)
    x, y = np.array([110.0, 120.0]), np.array([30.0, 31.0])
    for dx, dy, inside in (
        (0, 0, True), (-22, 0, True), (-23, 0, False), (31, 0, True), (32, 0, False), (0, -13, True), (0, -14, False),
        (0, 21, True), (0, 22, False), (31, 21, True), (31, 22, False), (32, 21, False),
    ):  # fmt: skip
        assert meets(x + dx, y + dy, 2.0, window) == inside, (dx, dy)
    assert meets(np.array([50.0, 500.0]), np.array([30.0, 31.0]), 2.0, window)
