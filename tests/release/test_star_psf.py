"""The PSF of an image's stars: known profiles come back, through GalSim's own reader of PSFEx's files."""

import galsim
import numpy as np
import pytest
from galsim.des import DES_PSFEx

from csstsim.catalog.table import ObjectTable
from csstsim.release.star_psf import chosen, star_psf, write_psfex

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
def test_a_known_profile_comes_back_at_any_place(tmp_path, count, shear):
    image, x, y, flux = image_of(count, shear)
    model = star_psf(image, np.full(image.shape, NOISE), np.zeros(image.shape, np.uint8), x, y, flux, 2.2)
    assert model.stars == count and len(model.planes) == (3 if count >= 30 else 1)
    true = galsim.Convolve(profile(0.0), galsim.Pixel(1.0))
    assert abs(model.fwhm - true.calculateFWHM()) < 0.05
    write_psfex(tmp_path / "a.psf", model)
    read = DES_PSFEx(str(tmp_path / "a.psf"))
    for place in (60.0, 300.0, 540.0):
        drawn = read.getPSF(galsim.PositionD(place + 1, 301)).drawImage(nx=41, ny=41, scale=1.0, method="no_pixel")
        exact = profile(shear * (place / SIDE - 0.5)).drawImage(nx=41, ny=41, scale=1.0)
        assert np.abs(drawn.array - exact.array).max() < PEAK * exact.array.max()
        seen, true_shape = (galsim.hsm.FindAdaptiveMom(one) for one in (drawn, exact))
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


@pytest.mark.parametrize("fwhm", [1.6, 3.0])
def test_stars_that_say_nothing_leave_the_gaussian_whose_pixels_add_up_to_one(tmp_path, fwhm):
    image, x, y, flux = image_of(12)
    model = star_psf(0 * image, np.full(image.shape, 1e9), np.zeros(image.shape, np.uint8), x, y, flux, fwhm)
    write_psfex(tmp_path / "a.psf", model)
    drawn = DES_PSFEx(str(tmp_path / "a.psf")).getPSF(galsim.PositionD(301, 301))
    assert drawn.drawImage(nx=41, ny=41, scale=1.0, method="no_pixel").array.sum() == pytest.approx(1.0, abs=1e-3)
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
    assert chosen(table).tolist() == [4, 5, 0]
    near = table.with_columns(x=np.array([0.0, 100, 200, 300, 300 + 5, 500]))
    assert chosen(near).tolist() == [5, 0]
