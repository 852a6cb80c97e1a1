"""PSF photometry of a known Gaussian: effective area in closed form; errors of partly lost light."""

import numpy as np
import pytest
from measure.slitless import below

from csstsim.measure.catalogue import point_source_snr
from csstsim.measure.light.centroid import windowed_positions
from csstsim.measure.light.photometry import BLUR, CORE, fit_sources, psf_model, psf_tables, table_steps

SIGMA = 5.0
STAR = 0.95  # px, sigma of the fabricated PSF


def test_effective_pixels_in_closed_form(fabricate):
    """1 / sum p^2 of a Gaussian integrated over pixels, the light beyond the table left out."""
    line = np.diff(below(np.arange(-12, 14) - 0.5, STAR))
    model = psf_model(fabricate.psf, (0, 0), (200, 200))
    assert model.n_eff == pytest.approx(1 / ((line**2).sum() ** 2 * fabricate.LIGHT**2), rel=0.01)


@pytest.mark.parametrize("fraction", [1.0, 0.25])
@pytest.mark.parametrize("flux", [300.0, 20_000.0])
def test_flux_errors_are_the_scatter_where_light_was_lost(fabricate, fraction, flux):
    """400 stars of whose light a fraction was counted, divided by it: pulls of width 1, and the formula's S/N."""
    image = np.zeros((640, 640))
    x, y = (v.ravel().astype(float) for v in np.meshgrid(np.arange(20, 620, 30), np.arange(20, 620, 30)))
    x, y = x + 0.3, y - 0.2
    fabricate.add_stars(image, x, y, np.full(len(x), flux))
    rng = np.random.default_rng(68)
    counted = rng.poisson(fraction * (image + fabricate.SKY)) + rng.normal(0, fabricate.READ_NOISE, image.shape)
    frame = (counted / fraction - fabricate.SKY).astype(np.float32)
    variance = (fraction * fabricate.SKY + fabricate.READ_NOISE**2) / fraction**2
    rms = np.full(frame.shape, np.sqrt(variance), np.float32)
    model = psf_model(fabricate.psf, (0, 0), frame.shape)
    fit = fit_sources(
        frame, rms, np.zeros(frame.shape, np.uint8), x, y, np.full(len(x), fraction), model.at(x, y),
    )  # fmt: skip
    pull = (fit.flux - flux) / fit.flux_error
    assert pull.std() == pytest.approx(1.0, abs=SIGMA / np.sqrt(2 * len(x)))
    # One weight for all pixels is at most a third worse than the optimal ones
    optimal = flux / point_source_snr(flux * fraction, variance * fraction**2, model.n_eff[0])
    assert 0.95 < np.median(fit.flux_error) / optimal < 1.35


def test_the_psf_of_a_cell_is_that_of_its_middle(fabricate):
    """Two by two cells of a frame that begins at pixel 1000, 2000: asked for where their pixels' middle lies."""
    asked = []

    class Recorder(type(fabricate.psf)):
        def at(self, x, y):
            asked.append((x, y))
            return super().at(x, y)

    model = psf_model(Recorder(), (1000, 2000), (600, 600), cell_px=300)
    middles = [(1000 + x, 2000 + y) for y in (149.5, 449.5) for x in (149.5, 449.5)]
    assert sorted(asked) == sorted(middles)
    cells = model.cell(*np.transpose(middles))
    assert sorted(cells.tolist()) == list(range(len(middles)))
    for number, position in zip(cells, middles, strict=True):
        assert asked[number] == position


SHARP = 0.62  # px, sigma of a sharp PSF
LIGHT_OFF, LIGHT_CUT = 2e-4, 1e-3  # of the flux: allowed; at least that much with two cells to a pixel


@pytest.mark.parametrize(("cells", "off"), [(4, LIGHT_OFF), (2, None)])
def test_the_flux_does_not_depend_on_the_position_in_the_pixel(cells, off):
    """A Gaussian integrated over pixels by erf, without noise; two cells to a pixel do not have its sharp peak."""

    class Sharp:
        oversampling = cells

        def at(self, x, y):
            line = np.diff(below((np.arange(257) - 128) / cells, SHARP))
            return np.repeat(np.outer(line, line)[None], 4, axis=0)

        def mixed(self, function):
            return lambda x, y: function(self.at(x, y))

    line = np.arange(20, 420, 40)
    phase = np.linspace(-0.5, 0.5, line.size)
    x, y = (v.ravel() for v in np.meshgrid(line + phase, line - phase))
    image = np.zeros((440, 440))
    for x0, y0 in zip(x, y, strict=True):
        columns, rows = (np.diff(below(np.arange(441) - 0.5 - v, SHARP)) for v in (x0, y0))
        image += 1e4 * np.outer(rows, columns)
    model = psf_model(Sharp(), (0, 0), image.shape)
    assert model.per_pixel == cells
    fit = fit_sources(
        image.astype(np.float32), np.ones(image.shape, np.float32), np.zeros(image.shape, np.uint8), x, y,
        np.ones(len(x)), model.at(x, y),
    )  # fmt: skip
    worst = np.abs(fit.flux / 1e4 - 1).max()
    assert worst < off if off else worst > LIGHT_CUT


@pytest.mark.parametrize("window", [1.5, 2.4])
def test_noise_in_the_position_biases_the_flux_as_foreseen(fabricate, window):
    """Mean pull of 10,000 stars at windowed positions, in closed form to second order: +0.03 and -0.04."""
    snr, line = 18.0, np.arange(20, 630, 24)
    x, y = (v.ravel() for v in np.meshgrid(line + 0.2, line - 0.3))
    square = 1.0 / psf_model(fabricate.psf, (0, 0), (640, 640)).n_eff[0]
    flux = 0.5 * snr * (snr + np.sqrt(snr**2 + 4 * fabricate.VARIANCE / square))
    stars = np.zeros((640, 640))
    fabricate.add_stars(stars, x, y, np.full(x.size, flux))
    model, rms = (
        psf_model(fabricate.psf, (0, 0), stars.shape),
        np.full(stars.shape, fabricate.VARIANCE**0.5, np.float32),
    )
    pulls = []
    for seed in range(15):
        noisy = (fabricate.add_noise(stars, 900 + seed) - fabricate.SKY).astype(np.float32)
        found = windowed_positions(noisy, x, y, np.full(x.size, window))
        unusable = np.zeros(noisy.shape, np.uint8)
        fit = fit_sources(noisy, rms, unusable, found.x, found.y, np.ones(x.size), model.at(x, y))
        pulls += [*((fit.flux - flux) / fit.flux_error)]
    expected = _mean_pull(fabricate, flux, 0.2, -0.3, window)
    assert np.mean(pulls) == pytest.approx(expected, abs=SIGMA / np.sqrt(len(pulls)))


def _mean_pull(fabricate, flux, dx, dy, window):
    """To second order in the noise, of sums over pixels: windowed position, fit with equal weights, its error."""
    edges, e = np.arange(-12, 14) - 0.5, 1e-3

    def psf(u, v):
        return fabricate.LIGHT * np.outer(*(np.diff(below(edges - position, STAR)) for position in (v, u)))

    p, middle = psf(dx, dy), edges[:-1] + 0.5
    offset = np.broadcast_to(middle - dx, p.shape), np.broadcast_to((middle - dy)[:, None], p.shape)
    slope = (psf(dx + e, dy) - psf(dx - e, dy)) / (2 * e), (psf(dx, dy + e) - psf(dx, dy - e)) / (2 * e)
    variance, w = fabricate.VARIANCE + flux * p, np.exp(-0.5 * (offset[0] ** 2 + offset[1] ** 2) / window**2)
    noise, bias = (p**2 * variance).sum(), 0.0
    for u, q in zip(offset, slope, strict=True):
        a = w * u / (flux * (w * (1 - u**2 / window**2) * p).sum())
        bias += (a * q * variance).sum() - 0.5 * flux * (q**2).sum() * (a**2 * variance).sum()
    return bias / np.sqrt(noise) - 0.5 * (p**3).sum() / np.sqrt(noise)


def fitted(fabricate, image, x, y, unusable=None, counted=1.0, rms=2.0):
    """Return the PsfFits of an image (ny, nx) of the fabricated PSF."""
    model = psf_model(fabricate.psf, (0, 0), image.shape)
    x, y = np.array(x, float), np.array(y, float)
    unusable = np.zeros(image.shape, np.uint8) if unusable is None else unusable
    noise = np.full(image.shape, rms, np.float32)
    fraction = np.full(len(x), counted)
    return fit_sources(image.astype(np.float32), noise, unusable, x, y, fraction, model.at(x, y))


def test_the_light_in_a_circle_is_that_of_the_gaussian(fabricate):
    """Through pixels it is a Gaussian of variance 1/12 more: 1 - exp(-r2 / 2 sigma2), edge pixels in 25 parts."""
    model = psf_model(fabricate.psf, (0, 0), (100, 100))
    for radius in (1.5, 2.5, 4.0):
        fraction = fabricate.LIGHT * (1 - np.exp(-0.5 * radius**2 / (STAR**2 + 1 / 12)))
        assert model.enclosed(radius) == pytest.approx(fraction, abs=0.01)
    assert model.kernel(2).shape == (5, 5) and model.kernel(2)[2, 2] == model.kernel(5).max()
    assert [table_steps(cells) for cells in (1, 2, 4, 6, 8)] == [2, 2, 4, 2, 4]


@pytest.mark.parametrize("wider", [0.0, 0.3, 0.8])
def test_the_spread_of_a_wider_source_in_closed_form(fabricate, wider):
    """Of Gaussians s, t the sum of products is 1 / (2 pi (s2 + t2)): spread is what the blur adds to the overlap."""
    line = np.diff(below(np.arange(-25, 27) - 0.5, np.hypot(STAR, wider)))
    fit = fitted(fabricate, 1e5 * np.outer(line, line), [25.0], [25.0])
    star, source = STAR**2 + 1 / 12, STAR**2 + wider**2 + 1 / 12
    wanted = (star + source) / (star + BLUR**2 + source) - 2 * star / (2 * star + BLUR**2)
    assert fit.spread[0] == pytest.approx(wanted, abs=3e-4) and (fit.spread[0] > 3e-3) == (wider > 0)


def test_unusable_pixels_in_the_core_give_their_bits_and_others_none(fabricate):
    """Columns of x, rows of y: 2 px off along x and 3 px along y is core, 4 px is not; edges leave pixels out."""
    image = np.zeros((60, 80))
    x, y = [30.2, 60.1, 3.0], [20.1, 40.2, 55.0]
    for a, b in zip(x[:2], y[:2], strict=True):
        fabricate.add_stars(image, [a], [b], [9000.0])
    clean = fitted(fabricate, image, x, y)
    unusable = np.zeros(image.shape, np.uint8)
    unusable[20 + CORE, 30 - 2], unusable[20, 30 + CORE + 1], unusable[40 - CORE, 60 + CORE] = 4, 2, 1
    spoilt = image.copy()
    spoilt[unusable > 0] = 1e6
    found = fitted(fabricate, spoilt, x, y, unusable)
    assert found.unusable.tolist() == [4, 1, 0] and (clean.unusable == 0).all()
    assert found.flux[:2] == pytest.approx([9000.0, 9000.0], rel=5e-3) and found.flux[2] == 0.0
    assert clean.chi2[:2] == pytest.approx(0.0, abs=0.02)


def test_chi2_and_errors_have_the_noise_of_pixels_and_light(fabricate):
    """One pixel is 10 off where the noise is 2: of 441 pixels chi2 has 25 / 440; the error is that of n_eff pixels."""
    image = np.zeros((61, 61))
    n_eff = psf_model(fabricate.psf, (0, 0), image.shape).n_eff[0]
    image[30 + 9, 30 - 9] = 10.0
    fit = fitted(fabricate, image, [30.0], [30.0])
    assert fit.chi2[0] == pytest.approx(25 / 440, rel=1e-4) and fit.flux_error[0] == pytest.approx(
        2 * np.sqrt(n_eff), rel=1e-3
    )
    alone = np.zeros((61, 61))
    fabricate.add_stars(alone, [30.0], [30.0], [1e5])
    line = np.diff(below(np.arange(-10, 12) - 0.5, STAR))
    p = fabricate.LIGHT * np.outer(line, line)
    wanted = np.sqrt((p**2 * (4 + 1e5 * p / 0.5)).sum()) / (p**2).sum()
    assert fitted(fabricate, alone, [30.0], [30.0], counted=0.5).flux_error[0] == pytest.approx(wanted, rel=0.01)


def test_the_kernel_is_the_psf_in_the_middle_of_the_frame(fabricate):
    """Of three by three parts, each with its own width."""

    class Widening(type(fabricate.psf)):
        def at(self, x, y):
            line = np.diff(below((np.arange(257) - 128) * 0.5, 0.8 + 0.001 * x + 0.0005 * y))
            return np.repeat(np.outer(line, line)[None], 4, axis=0)

    kernel = psf_model(Widening(), (0, 0), (300, 300), cell_px=100).kernel(4)
    line = np.diff(below(np.arange(-4, 6) - 0.5, 0.8 + 0.0015 * 149.5))
    assert kernel == pytest.approx(np.outer(line, line), abs=2e-3 * line.max() ** 2)


def test_a_psf_is_the_mean_of_its_sub_bands(fabricate):
    """Four Gaussians of unlike widths and light: the tables of all uses are those of their mean."""
    lines = [np.diff(below((np.arange(257) - 128) * 0.5, sigma)) for sigma in (0.8, 1.0, 1.3, 1.7)]
    bands = np.array([light * np.outer(line, line) for line, light in zip(lines, (0.7, 0.9, 1.0, 1.2), strict=True)])

    class Bands(type(fabricate.psf)):
        def __init__(self, images):
            self.images = images

        def at(self, x, y):
            return self.images

    of_bands, of_mean = (Bands(images) for images in (bands, np.repeat(bands.mean(axis=0)[None], 4, axis=0)))
    one, other = (psf_model(psf, (0, 0), (100, 100)) for psf in (of_bands, of_mean))
    for name in ("coefficients", "blurred", "n_eff"):
        assert getattr(one, name) == pytest.approx(getattr(other, name), rel=1e-9, abs=1e-12), name
    assert psf_tables(of_bands)(0, 0) == pytest.approx(psf_tables(of_mean)(0, 0), rel=1e-9, abs=1e-12)
