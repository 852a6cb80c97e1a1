"""Adaptive moments against GalSim's HSM; missing pixels, failures, errors, and the correction for the PSF."""

import math

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from csstsim.base.rng import stream
from csstsim.measure.detection.maps import BIN
from csstsim.measure.light.moments import (
    SMOOTH,
    AdaptiveShapes,
    MeasuredShapes,
    adaptive_moments,
    measure_shapes,
    on_sky,
    reduced,
    without_psf,
)
from csstsim.measure.light.photometry import HALF, psf_model, render_psf
from csstsim.measure.light.pixels import Pixels

galsim = pytest.importorskip("galsim")

RELATIVE = 1e-4  # of sigma; absolute for distortions and, in px, for positions
N = 61
PSF = galsim.Gaussian(sigma=0.95).shear(e1=0.05, e2=-0.03)
GALAXIES = {
    "disc": galsim.Exponential(half_light_radius=4.0).shear(e1=0.2, e2=0.1),
    "small": galsim.Exponential(half_light_radius=1.5).shear(e1=-0.4, e2=0.2),
    "bulge": galsim.DeVaucouleurs(half_light_radius=4.0).shear(e1=-0.3, e2=0.2),
    "thin": galsim.Exponential(half_light_radius=6.0).shear(e1=0.5, e2=-0.6),
}
GAUSSIANS = {"round": (1.2, 0.0, 0.0), "long": (2.5, 0.3, -0.2), "needle": (3.0, 0.6, 0.5)}
PLACE = 30.3, 29.8


def picture(profile, position=PLACE, method="auto"):
    image = galsim.ImageD(N, N, xmin=0, ymin=0, scale=1.0)
    return profile.drawImage(image, center=galsim.PositionD(*position), method=method).array


def gaussian(sigma, e1, e2):
    return picture(galsim.Gaussian(sigma=sigma).shear(e1=e1, e2=e2), method="no_pixel")


def moments(image, smooth=0.0, position=PLACE, guess=2.0, unusable=None, segments=None):
    """Return (x, y, sigma, e1, e2, kurtosis); None if it failed. segments: at full size."""
    unusable = np.zeros(image.shape, np.uint8) if unusable is None else unusable
    segments = np.zeros(image.shape, np.int32) if segments is None else segments
    fit = adaptive_moments(
        image,
        unusable,
        np.ascontiguousarray(segments[::BIN, ::BIN]),
        7,
        *position,
        math.hypot(guess, smooth),
        smooth,
    )
    if fit.flux == 0.0:
        return None
    x, y, xx, xy, yy = fit.gaussian
    return np.array([x, y, (xx * yy - xy * xy) ** 0.25, (xx - yy) / (xx + yy), 2 * xy / (xx + yy), fit.kurtosis])


def peer(image, position=PLACE):
    centre = galsim.PositionD(position[0] + 1, position[1] + 1)
    found = galsim.hsm.FindAdaptiveMom(galsim.Image(image), guess_sig=2.0, guess_centroid=centre)
    x, y, shape = found.moments_centroid.x - 1, found.moments_centroid.y - 1, found.observed_shape
    return np.array([x, y, found.moments_sigma, shape.e1, shape.e2, 0.5 * found.moments_rho4 - 1])


def same(ours, theirs, relative=RELATIVE):
    assert ours[2] == pytest.approx(theirs[2], rel=relative)
    assert ours[[0, 1, 3, 4]] == pytest.approx(theirs[[0, 1, 3, 4]], abs=relative)


@pytest.mark.parametrize("name", GAUSSIANS)
def test_gaussians_are_what_they_are(name):
    sigma, e1, e2 = GAUSSIANS[name]
    ours = moments(gaussian(*GAUSSIANS[name]))
    same(ours, np.array([*PLACE, sigma, e1, e2]))
    assert abs(ours[5]) < RELATIVE
    same(moments(gaussian(*GAUSSIANS[name])), peer(gaussian(*GAUSSIANS[name])))


@pytest.mark.parametrize("smooth", [0.0, SMOOTH])
@pytest.mark.parametrize("name", GALAXIES)
def test_galaxies_as_galsim_has_them(name, smooth):
    """The widened weight gives the moments of an image that was really smoothed."""
    image = picture(galsim.Convolve(GALAXIES[name], PSF))
    theirs = peer(gaussian_filter(image, smooth, truncate=6.0) if smooth else image)
    ours = moments(image, smooth)
    same(ours, theirs)
    assert ours[5] == pytest.approx(theirs[5], abs=5e-4)


@pytest.mark.parametrize("smooth", [0.0, SMOOTH])
def test_noise_is_treated_as_galsim_treats_it(smooth):
    rng, done = stream(50, "moments noise"), 0
    clear = picture(galsim.Convolve(GALAXIES["disc"], PSF)) * 20000.0
    for _ in range(20):
        image = clear + rng.normal(0.0, 8.0, clear.shape)
        same(moments(image, smooth), peer(gaussian_filter(image, smooth, truncate=6.0) if smooth else image), 3e-4)
        done += 1
    assert done == 20


@pytest.mark.parametrize("shift", [(0.0, 0.0), (0.25, -0.4), (0.5, 0.5)])
def test_stars_of_the_model_of_an_aberrated_psf(shift):
    """An Airy disc with coma, astigmatism and jitter; pixels are too coarse for it: unsmoothed, it collapses."""

    class Airy:
        oversampling = 2

        def at(self, x, y):
            optics = galsim.OpticalPSF(
                lam=620, diam=2.0, coma1=0.04, astig1=0.03, scale_unit=galsim.arcsec, gsparams=galsim.GSParams(1e-3)
            )
            blurred = galsim.Convolve(optics, galsim.Gaussian(sigma=0.035))
            return blurred.drawImage(nx=256, ny=256, scale=0.037, use_true_center=True, dtype=float).array[None]

        def mixed(self, function):
            return lambda x, y: function(self.at(x, y))

    model = psf_model(Airy(), (0, 0), (100, 100))
    stamp = np.empty((2 * HALF + 1, 2 * HALF + 1))
    render_psf(model.coefficients[0], model.per_pixel, *shift, stamp)
    position = HALF + shift[0], HALF + shift[1]
    same(
        moments(stamp, SMOOTH, position, 0.8),
        peer(gaussian_filter(stamp, SMOOTH, truncate=6.0, mode="constant"), position),
    )
    if shift == (0.0, 0.0):
        assert moments(stamp, 0.0, position, 0.8) is None


@pytest.mark.parametrize("smooth", [0.0, SMOOTH])
@pytest.mark.parametrize("why", ["bad", "neighbour", "edge", "corner"])
def test_pixels_that_cannot_be_used_count_as_the_gaussian(why, smooth):
    image, position = gaussian(2.5, 0.3, -0.2), PLACE
    unusable, segments = np.zeros(image.shape, np.uint8), np.zeros(image.shape, np.int32)
    segments[25:35, 25:35] = 7  # its own
    if why == "bad":
        image[31:33, 27:30], unusable[31:33, 27:30] = 1e6, 1
        image[:, 33], unusable[:, 33] = np.nan, 4
    elif why == "neighbour":
        image[:, 36:], segments[:, 36:] = 3.0, 8
    else:
        column = 0 if why == "edge" else 29
        image, unusable, segments = (v[28:, column:] for v in (image, unusable, segments))
        position = PLACE[0] - column, PLACE[1] - 28
    image = np.ascontiguousarray(image)
    ours = moments(image, smooth, position, 2.0, np.ascontiguousarray(unusable), segments)
    expected = moments(gaussian(2.5, 0.3, -0.2), smooth)
    expected[:2] = position
    same(
        ours, expected, 1e-3 if why == "corner" else RELATIVE
    )  # with a third of the light missing, last steps are slow


def test_what_has_no_moments_fails():
    star = gaussian(1.5, 0.0, 0.0)
    blind = np.zeros(star.shape, np.uint8)
    blind[28:33, 28:33] = 1  # a saturated core
    two = star + 5.0 * picture(galsim.Gaussian(sigma=1.5), (PLACE[0] + 5.0, PLACE[1]))
    assert moments(star, SMOOTH) is not None
    assert moments(star, SMOOTH, unusable=blind) is None
    assert moments(two, SMOOTH) is None  # drawn to a brighter neighbour
    for nothing in (0.0 * star, -star, np.full(star.shape, np.nan), np.ones(star.shape)):
        assert moments(nothing, SMOOTH) is None
    assert moments(star, SMOOTH, position=(-40.0, 30.0)) is None  # off the frame
    assert moments(np.ones((1, 1)), SMOOTH, position=(0.0, 0.0)) is None
    assert moments(np.zeros((0, 0)), SMOOTH, position=(0.0, 0.0)) is None
    # Neither units nor tiny numbers matter
    for scale in (1e-300, 1e300):
        assert moments(scale * star, SMOOTH) == pytest.approx(moments(star, SMOOTH), rel=1e-9)


def table_of(source, psf):
    """Return the MeasuredShapes of `moments` of a source and of its PSF."""
    x, y, *shape = source
    one = [np.array([value]) for value in shape]
    star = [np.array([value]) for value in psf[2:]]
    return MeasuredShapes(np.array([x]), np.array([y]), AdaptiveShapes(*one), np.array([0.01]), AdaptiveShapes(*star))


def shapes_of(image, profile_psf):
    return table_of(moments(image, SMOOTH), moments(picture(profile_psf, (30.0, 30.0)), SMOOTH))


@pytest.mark.parametrize("name", GALAXIES)
def test_the_correction_is_galsims(name):
    image, star = picture(galsim.Convolve(GALAXIES[name], PSF)), picture(PSF, (30.0, 30.0))
    e, _, _ = without_psf(table_of(moments(image), moments(star)))
    theirs = galsim.hsm.EstimateShear(galsim.Image(image), galsim.Image(star), shear_est="BJ")
    assert (e.real[0], e.imag[0]) == pytest.approx((theirs.corrected_e1, theirs.corrected_e2), abs=2 * RELATIVE)


@pytest.mark.parametrize(("name", "bias"), [("disc", 0.002), ("small", 0.02), ("bulge", 0.02), ("thin", 0.002)])
def test_what_the_correction_leaves_of_the_shape(name, bias):
    """Without noise; `bias` relative to |e|: what a kurtosis alone does not know of a profile. Exact for Gaussians."""
    e, _, resolution = without_psf(shapes_of(picture(galsim.Convolve(GALAXIES[name], PSF)), PSF))
    true = {"disc": 0.2 + 0.1j, "small": -0.4 + 0.2j, "bulge": -0.3 + 0.2j, "thin": 0.5 - 0.6j}[name]
    assert abs(e[0] - true) < bias * abs(true)
    assert 0.2 < resolution[0] < 1.0
    exact = galsim.Gaussian(sigma=1.0).shear(e1=0.3, e2=0.4)
    e, _, resolution = without_psf(shapes_of(picture(galsim.Convolve(exact, PSF)), PSF))
    assert abs(e[0] - (0.3 + 0.4j)) < 1e-3  # pixels are squares
    e, error, resolution = without_psf(shapes_of(picture(PSF), PSF))
    assert abs(resolution[0]) < 1e-3 and np.isnan(e[0]) and np.isnan(error[0])  # a star
    for count in (0, 2):
        unknown = AdaptiveShapes(*np.full((4, count), np.nan))
        nothing = np.full(count, np.nan)
        found = without_psf(MeasuredShapes(nothing, nothing, unknown, nothing, unknown))
        assert all(column.shape == (count,) and np.isnan(column).all() for column in found)


@pytest.mark.parametrize(("name", "snr"), [("disc", 30), ("disc", 100), ("star", 20), ("star", 100)])
def test_errors_are_those_of_the_noise(fabricate, name, snr):
    """300 noisy images; the width of pulls of both components is known to 1 / sqrt(1200) = 2.9 %, 5 sigma is 0.15."""
    rng, rms, count = stream(51, "moments errors", name, snr), 8.0, 300
    model = psf_model(fabricate.psf, (0, 0), (N, N))
    profile = galsim.Gaussian(sigma=fabricate.SIGMA)
    if name == "disc":
        profile = galsim.Convolve(GALAXIES["disc"], profile)
    image = np.maximum(picture(profile), 0.0)
    flux = snr * snr / 2 + snr * math.sqrt(snr * snr / 4 + rms**2 / (image**2).sum())
    shapes = []
    for _ in range(count):
        noisy = (rng.poisson(flux * image) + rng.normal(0.0, rms, image.shape)).astype(np.float32)
        one = np.ones(1)
        pixels = Pixels(
            noisy,
            np.full(noisy.shape, rms, np.float32),
            np.zeros(noisy.shape, np.uint8),
            np.zeros(noisy.shape, np.int32),
        )
        x, y = PLACE[0] * one, PLACE[1] * one
        size = (3.0 if name == "disc" else 1.1) * one
        shapes.append(measure_shapes(pixels, np.zeros(1, int), x, y, size, np.ones(1, bool), one, model.at(x, y)))
    error = np.concatenate([one.error for one in shapes])
    source = AdaptiveShapes(*np.concatenate([one.source for one in shapes], axis=1))
    psf = AdaptiveShapes(*np.concatenate([one.psf for one in shapes], axis=1))
    good = np.isfinite(source.sigma)
    assert good.mean() > 0.97
    e = source.e1 + 1j * source.e2
    assert 0.85 < width(e[good], error[good]) < 1.15
    if name == "disc":
        e, error, _ = without_psf(MeasuredShapes(error, error, source, error, psf))
        good = np.isfinite(e)
        assert good.mean() > 0.9
        assert 0.85 < width(e[good], error[good]) < 1.2


def width(e, error):
    pull = (e - e.mean()) / error
    return math.sqrt(0.5 * np.mean(np.abs(pull) ** 2))


@pytest.mark.parametrize("pa", [0.0, 45.0, 133.0])
@pytest.mark.parametrize("parity", [1, -1])
def test_shapes_on_the_sky_are_the_truths(pa, parity):
    """A round source under a shear, through d(pixel)/d(sky): back comes the shear, east and north."""
    angle, g = np.radians(pa), 0.12 - 0.2j
    jacobian = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]]) @ np.diag([parity, 1.0])
    jacobian = (np.array([[1.001, 0.002], [-0.001, 0.998]]) @ jacobian / 0.074)[None]
    shear = np.array([[1 + g.real, g.imag], [g.imag, 1 - g.real]])
    m = (jacobian @ shear @ shear @ np.swapaxes(jacobian, 1, 2))[0]
    e = np.array([m[0, 0] - m[1, 1] + 2j * m[0, 1]]) / (m[0, 0] + m[1, 1])
    assert reduced(on_sky(e, jacobian))[0] == pytest.approx(g, abs=1e-12)
    assert np.isnan(reduced(on_sky(np.array([np.nan + 0j]), jacobian)))[0]


@pytest.mark.parametrize(("e1", "e2"), [(0.3, 0.0), (-0.3, 0.1), (0.0, 0.4), (0.2, -0.5)])
def test_the_table_of_shapes_has_the_signs_of_galsims(fabricate, e1, e2):
    """e1 along x, e2 towards +y at 45 deg, size and kurtosis, of source and of PSF, through what catalogues use."""
    image = picture(galsim.Gaussian(sigma=3.0).shear(e1=e1, e2=e2), position=(30.0, 30.0)).astype(np.float32) * 1e5
    model = psf_model(fabricate.psf, (0, 0), image.shape)
    zero, one = np.zeros(1, int), np.ones(1)
    pixels = Pixels(image, np.ones_like(image), np.zeros(image.shape, np.uint8), np.zeros(image.shape, np.int32))
    x = y = 30.0 * one
    found = measure_shapes(pixels, zero, x, y, 3.0 * one, np.ones(1, bool), one, model.at(x, y))
    pixel = 1 / 12 + SMOOTH**2  # px^2: of the pixel and of what is laid over all, which make a Gaussian rounder
    size2 = 9 / np.sqrt(1 - e1**2 - e2**2)
    assert [found.x[0], found.y[0]] == pytest.approx([30.0, 30.0], abs=1e-3)
    assert [found.source.e1[0], found.source.e2[0]] == pytest.approx(
        [e1 * size2 / (size2 + pixel), e2 * size2 / (size2 + pixel)], abs=3e-3
    )
    assert [found.psf.e1[0], found.psf.e2[0]] == pytest.approx([0.0, 0.0], abs=1e-3)  # a round PSF


def shape_error(fabricate, flux=1e5, rms=5.0, counted=1.0, unusable=None, segments=None):
    """Return the error of the distortion of a round Gaussian of 3 px, of isophote 7. segments: at full size."""
    image = (flux * gaussian(3.0, 0.0, 0.0)).astype(np.float32)
    model, one = psf_model(fabricate.psf, (0, 0), image.shape), np.ones(1)
    none = np.zeros(image.shape, np.uint8) if unusable is None else unusable
    isophotes = np.zeros(image.shape, np.int32) if segments is None else segments
    pixels = Pixels(image, np.full(image.shape, rms, np.float32), none, np.ascontiguousarray(isophotes[::BIN, ::BIN]))
    x, y = PLACE[0] * one, PLACE[1] * one
    found = measure_shapes(pixels, np.array([7]), x, y, 3 * one, one > 0, counted * one, model.at(x, y))
    return found.error[0]


def test_errors_of_shapes_have_the_noise_of_the_light_as_it_was_counted(fabricate):
    """Where the source is the noise, a quarter of the light makes twice the error; where the sky is, no other."""
    assert shape_error(fabricate, 1e6, 0.1, 0.25) == pytest.approx(2 * shape_error(fabricate, 1e6, 0.1), rel=1e-3)
    assert shape_error(fabricate, 1e3, 50.0, 0.25) == pytest.approx(shape_error(fabricate, 1e3, 50.0), rel=1e-2)


def test_errors_of_shapes_are_those_of_the_pixels_that_are_used(fabricate):
    """The source's own isophote is used; what is bad, or another's, has no noise, and the error is smaller."""
    plain = shape_error(fabricate)
    own, other, bad = (np.zeros((N, N), kind) for kind in (np.int32, np.int32, np.uint8))
    own[20:42, 20:42], other[:, 34:], bad[:, 34:] = 7, 8, 2
    assert shape_error(fabricate, segments=own) == pytest.approx(plain, rel=1e-9)
    lost = shape_error(fabricate, unusable=bad)
    assert lost < 0.97 * plain and shape_error(fabricate, segments=other) == pytest.approx(lost, rel=1e-6)


@pytest.mark.parametrize(("kurtosis", "known"), [(0.0, True), (-0.9, True), (-1.1, False)])
def test_a_resolution_above_one_gives_no_shape(kurtosis, known):
    """R = 1 - (1 / 2)^2 (1 + o) / (1 - o) for a source of twice the size; the error of a shape is divided by it."""
    shapes = table_of(np.array([0, 0, 2.0, 0.1, 0.0, kurtosis]), np.array([0, 0, 1.0, 0.0, 0.0, 0.0]))
    e, error, resolution = without_psf(shapes)
    size = math.sqrt(1 - 0.1**2)
    wanted = 1 - 0.25 * size * (1 + kurtosis) / (1 - kurtosis)
    assert resolution[0] == pytest.approx(wanted) and (wanted <= 1) == known
    assert np.isfinite(e[0]) == known
    if known:
        assert e[0] == pytest.approx(0.1 / wanted) and error[0] == pytest.approx(0.01 / wanted)
