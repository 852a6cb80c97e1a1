"""The PSF of an image's stars: known profiles come back, through GalSim's own reader of PSFEx's files."""

import galsim
import numpy as np
import pytest
from galsim.des import DES_PSFEx

from csstsim.catalog.table import ObjectTable
from csstsim.studies.release.star_psf import StarPsf, _star, select_stars, star_psf, write_psfex

SIDE, NOISE = 600, 0.02  # px; of a pixel, star fluxes are about 300
PEAK, SIZE, SHAPE = 0.01, 0.01, 0.005  # of the peak, of the size, of the shear


def image_of(count, shear=0.0, seed=3):
    """Return (image, x, y, flux) of stars: Gaussians of FWHM 2 px times a pixel, sheared more to the right."""
    rng = np.random.default_rng(seed)
    side = int(np.ceil(np.sqrt(count)))
    grid = np.linspace(30, SIDE - 30, side)
    x, y = (v.ravel()[:count] + rng.uniform(-0.5, 0.5, count) for v in np.meshgrid(grid, grid))
    flux = rng.uniform(200, 400, count)
    image = galsim.ImageD(SIDE, SIDE, xmin=0, ymin=0)
    for one in zip(x, y, flux, strict=True):
        star = profile(shear * (one[0] / SIDE - 0.5)).withFlux(one[2])
        box = galsim.BoundsI(round(one[0]) - 20, round(one[0]) + 20, round(one[1]) - 20, round(one[1]) + 20)
        star.drawImage(image[box & image.bounds], center=galsim.PositionD(one[0], one[1]), scale=1.0, add_to_image=True)
    return image.array + rng.normal(0, NOISE, image.array.shape), x, y, flux


def profile(g1):
    return galsim.Gaussian(fwhm=2.0).shear(g1=g1)


@pytest.mark.parametrize("count, shear", [(12, 0.0), (64, 0.1)])
def test_a_known_profile_is_recovered_at_any_position(tmp_path, count, shear):
    image, x, y, flux = image_of(count, shear)
    model = star_psf(image, np.full(image.shape, NOISE), np.zeros(image.shape, np.uint8), x, y, flux, 2.2)
    assert model.stars == count and len(model.planes) == (3 if count >= 30 else 1)
    true = galsim.Convolve(profile(0.0), galsim.Pixel(1.0))
    assert abs(model.fwhm - true.calculateFWHM()) < 0.05
    write_psfex(tmp_path / "a.psf", model)
    read = DES_PSFEx(str(tmp_path / "a.psf"))
    for position in (60.0, 300.0, 540.0):
        rendered = read.getPSF(galsim.PositionD(position + 1, 301)).drawImage(
            nx=41, ny=41, scale=1.0, method="no_pixel"
        )
        exact = profile(shear * (position / SIDE - 0.5)).drawImage(nx=41, ny=41, scale=1.0)
        assert np.abs(rendered.array - exact.array).max() < PEAK * exact.array.max()
        seen, true_shape = (galsim.hsm.FindAdaptiveMom(one) for one in (rendered, exact))
        assert abs(seen.moments_sigma / true_shape.moments_sigma - 1) < SIZE
        assert abs(seen.observed_shape.g1 - true_shape.observed_shape.g1) < SHAPE


def test_bad_pixels_do_not_count():
    image, x, y, flux = image_of(12)
    quality = np.zeros(image.shape, np.uint8)
    for k in range(12):
        quality[round(y[k]) + 2, round(x[k]) - 3 : round(x[k]) + 3] = 4
    spoilt = np.where(quality > 0, 1e4, image)
    noise = np.full(image.shape, NOISE)
    good = star_psf(image, noise, quality, x, y, flux, 2.2)
    assert np.array_equal(star_psf(spoilt, noise, quality, x, y, flux, 2.2).planes, good.planes)


def test_pixels_without_an_error_do_not_count():
    """An error of 0, which calibration gives to no pixel that it knows, is none."""
    image, x, y, flux = image_of(12)
    noise, quality = np.full(image.shape, NOISE), np.zeros(image.shape, np.uint8)
    for k in range(12):
        quality[round(y[k]) + 2, round(x[k]) - 3 : round(x[k]) + 3] = 4
    good = star_psf(image, noise, quality, x, y, flux, 2.2)
    unknown = star_psf(np.where(quality > 0, 1e4, image), np.where(quality > 0, 0, noise), 0 * quality, x, y, flux, 2.2)
    assert np.array_equal(unknown.planes, good.planes)


def test_errors_of_a_stars_pixels_are_noise_and_a_hundredth_of_their_value():
    """So that the brightest star does not decide alone: its pixels are known no better than to a hundredth."""
    rng = np.random.default_rng(2)
    image, error = rng.normal(0, 100, (40, 50)), rng.uniform(0.5, 2.0, (40, 50))
    star = _star(image, error, np.zeros(image.shape, np.uint8), 23.7, 18.2, 250.0)
    rows, columns = slice(18 - 10, 18 + 11), slice(24 - 10, 24 + 11)
    assert star.values == pytest.approx(image[rows, columns].ravel() / 250)
    assert star.errors == pytest.approx(np.hypot(error, image / 100)[rows, columns].ravel() / 250)
    assert star.weights.sum(axis=1) == pytest.approx(1.0)


def test_chi2_is_one_of_stars_whose_errors_are_right():
    """Of faint stars, whose pixels have noise alone; with errors twice as large it is a quarter."""
    image, x, y, _ = image_of(25)
    noise = np.random.default_rng(4).normal(0, 10.0, image.shape)
    good, flux = np.zeros(image.shape, np.uint8), image_of(25)[3]
    one, half = (star_psf(image + noise, np.full(image.shape, error), good, x, y, flux, 2.2) for error in (10.0, 20.0))
    assert one.chi2 == pytest.approx(1.0, abs=0.1) and half.chi2 == pytest.approx(0.25, abs=0.03)


@pytest.mark.parametrize("fwhm", [1.6, 3.0])
def test_stars_that_say_nothing_leave_the_gaussian_whose_pixels_add_up_to_one(tmp_path, fwhm):
    image, x, y, flux = image_of(12)
    model = star_psf(0 * image, np.full(image.shape, 1e9), np.zeros(image.shape, np.uint8), x, y, flux, fwhm)
    write_psfex(tmp_path / "a.psf", model)
    rendered = DES_PSFEx(str(tmp_path / "a.psf")).getPSF(galsim.PositionD(301, 301))
    assert rendered.drawImage(nx=41, ny=41, scale=1.0, method="no_pixel").array.sum() == pytest.approx(1.0, abs=1e-3)
    assert model.fwhm == pytest.approx(fwhm, abs=0.05)


def test_few_stars_give_no_model():
    image, x, y, flux = image_of(4)
    assert star_psf(image, np.ones(image.shape), np.zeros(image.shape, np.uint8), x, y, flux, 2.0) is None


def test_stars_that_are_chosen():
    n = 6
    table = ObjectTable({
        "star": np.array([1, 1, 1, 0, 1, 1], bool), "flags": np.array([0, 4, 0, 0, 0, 0], np.int32),
        "snr": np.array([50.0, 90, 20, 90, 200, 60]), "flux_psf": np.array([50.0, 90, 20, 90, 200, 60]),
        "x": np.arange(n) * 100.0, "y": np.zeros(n),
    })  # fmt: skip
    assert select_stars(table).tolist() == [4, 5, 0]
    near = table.with_columns(x=np.array([0.0, 100, 200, 300, 300 + 5, 500]))
    assert select_stars(near).tolist() == [5, 0]


def test_the_model_changes_from_the_middle_of_the_image_to_each_edge(monkeypatch):
    """In the least squares, a star's weight in a change is its distance from the middle over half of the image."""
    matrices = []

    def solve(matrix, seen, **named):
        matrices.append(abs(matrix.tocsc()))
        return (np.zeros(matrix.shape[1]),)

    monkeypatch.setattr("scipy.sparse.linalg.lsqr", solve)
    rng = np.random.default_rng(2)
    x, y = rng.uniform(20, 80, 30), rng.uniform(20, 40, 30)
    x[0], y[0] = 49.5, 29.5  # the middle of 100 x 60 px, from 0
    image = rng.normal(0, NOISE, (60, 100))
    noise, good = np.full(image.shape, NOISE), np.zeros(image.shape, np.uint8)
    model = star_psf(image, noise, good, x, y, np.full(30, 300.0), 2.2)
    assert (model.zero, model.scale) == ((50.5, 30.5), (50.0, 30.0))
    [matrix] = matrices
    parts = [matrix[:, first : first + 45**2] for first in range(0, 3 * 45**2, 45**2)]
    mean, *changes = (part.max(axis=1).toarray() for part in parts)
    per_star = [(change / mean).reshape(30, -1) / 0.3 for change in changes]
    np.testing.assert_allclose(per_star[0], np.abs(x - 49.5)[:, None] / 50 * np.ones(441), atol=1e-12)
    np.testing.assert_allclose(per_star[1], np.abs(y - 29.5)[:, None] / 30 * np.ones(441), atol=1e-12)


def test_stars_count_if_all_their_pixels_lie_inside(monkeypatch):
    """More than 11 px from the first and the last pixel; five are enough for a model, 30 for a change."""
    monkeypatch.setattr("csstsim.studies.release.star_psf.ITERATIONS", 1)
    rng = np.random.default_rng(1)
    image = rng.normal(0, NOISE, (90, 120))
    noise, good = np.full(image.shape, NOISE), np.zeros(image.shape, np.uint8)
    middle = [60.0, 61.0, 62.0, 63.0], [40.0, 41.0, 42.0, 43.0]

    def stars(x, y, more=0):
        x, y = ([*inner, *[inner[0]] * more, one] for inner, one in zip(middle, (x, y), strict=True))
        found = star_psf(image, noise, good, np.array(x), np.array(y), np.full(len(x), 300.0), 2.0)
        return found and (found.stars, len(found.planes))

    for inside in ((11.1, 45.0), (107.9, 45.0), (45.0, 11.1), (45.0, 77.9)):
        assert stars(*inside) == (5, 1)
    for outside in ((11.0, 45.0), (108.0, 45.0), (45.0, 11.0), (45.0, 78.0)):
        assert stars(*outside) is None
    assert [stars(50.0, 45.0, more) for more in (24, 25)] == [(29, 1), (30, 3)]


def test_a_file_has_the_zero_and_scale_of_each_axis(tmp_path):
    from astropy.io import fits

    model = StarPsf(np.zeros((3, 45, 45)), (300.5, 280.25), (299.0, 281.0), 37, 2.5, 1.25)
    write_psfex(tmp_path / "a.psf", model)
    header = fits.getheader(tmp_path / "a.psf", 1)
    wanted = {
        "POLZERO1": 300.5, "POLSCAL1": 299.0, "POLZERO2": 280.25, "POLSCAL2": 281.0, "POLNAXIS": 2, "POLGRP1": 1,
        "POLGRP2": 1, "POLNGRP": 1, "POLDEG1": 1, "PSF_FWHM": 2.5, "PSF_SAMP": 0.5, "CHI2": 1.25, "LOADED": 37,
        "ACCEPTED": 37, "PSFNAXIS": 3, "PSFAXIS1": 45, "PSFAXIS2": 45, "PSFAXIS3": 3,
    }  # fmt: skip
    assert {name: header[name] for name in wanted} == wanted


def test_the_brightest_stars_above_the_limit_are_chosen():
    """S/N above 30, 150 stars at most; neighbours of a fiftieth of the light or more within 14 px, and flags, count."""
    n = 152
    snr = 30.0 + np.arange(n)
    table = {
        "star": np.ones(n, bool), "flags": np.zeros(n, np.int32), "snr": snr, "flux_psf": np.full(n, 100.0),
        "x": np.zeros(n), "y": np.arange(n) * 20.0,
    }  # fmt: skip
    assert select_stars(ObjectTable(table)).tolist() == list(range(151, 1, -1))
    pair = {"star": np.ones(2, bool), "flags": np.zeros(2, np.int32), "snr": np.array([50.0, 31.0])}
    for apart, faint, rows in (
        (14.1, 99.0, [0, 1]), (13.9, 99.0, []), (13.9, 2.0, []), (13.9, 1.9, [0]), (13.9, np.nan, [0]),
    ):  # fmt: skip
        positions = {"x": np.zeros(2), "y": np.array([0.0, apart]), "flux_psf": np.array([100.0, faint])}
        assert select_stars(ObjectTable(pair | positions)).tolist() == rows, (apart, faint)
    for bit in range(8):
        one = pair | {"flags": np.array([1 << bit, 0], np.int32), "flux_psf": np.array([9.0, 9.0])}
        spoilt = bit in (0, 1, 2, 6, 7)
        far = ObjectTable(one | {"x": np.zeros(2), "y": np.array([0.0, 99.0])})
        assert select_stars(far).tolist() == ([1] if spoilt else [0, 1]), bit
