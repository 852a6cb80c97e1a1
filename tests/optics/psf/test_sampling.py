"""psf.yaml's cells per pixel: sets read as the reference renderer reads them, against direct optics.

benchmarks/psf_sampling.py measures every band and reader; here one band of each kind, at four positions in a pixel.
"""

import galsim
import numpy as np
import pytest

from csstsim.base.errors import InputError
from csstsim.optics.psf.chip_errors import chip_coefficients
from csstsim.optics.psf.psf_file import half_pixels, pixel_response
from csstsim.optics.psf.psf_set import chip_optics
from csstsim.optics.psf.sampling import oversampling_of
from csstsim.optics.psf.wavefront import load_wavefront
from csstsim.render.imaging.reference import GSPARAMS, PSF_MAXK

BOX, HALF = 32, 10  # px


def size_and_shape(image, x, y):
    """Size^2 (px^2), e1, e2 about a known centre, weighted with a Gaussian of 3 px."""
    axis = np.arange(-HALF, HALF + 1)
    dx, dy = axis - x, axis[:, None] - y
    weight = image * np.exp(-0.5 * (dx**2 + dy**2) / 9)
    xx, yy, xy = (np.sum(weight * m) / weight.sum() for m in (dx * dx, dy * dy, dx * dy))
    return np.array([xx + yy, (xx - yy) / (xx + yy), 2 * xy / (xx + yy)])


def worst(camera, name, oversampling):
    """Return the largest relative error of size^2 and of ellipticity at positions in a pixel, and the mean of both."""
    filter_, wavefront = camera.filters[name], load_wavefront(camera.psf)
    chip = next(c for c in camera.chips.values() if c.filter == name)
    coefficients = chip_coefficients(wavefront, camera.psf, chip, 4607.5, 4615.5)

    def optics(m):
        made, kernel = chip_optics(chip, filter_, camera.psf, wavefront, m, BOX * m)
        transfers = [o.transfer(coefficients) for o in made]
        return lambda centre: np.mean(
            [o.image(t, kernel, centre) for o, t in zip(made, transfers, strict=True)], axis=0
        )

    direct, step = optics(1), 1 / oversampling
    response = pixel_response(optics(oversampling)((0.0, 0.0)), oversampling)
    point = galsim.InterpolatedImage(
        galsim.ImageD(response), scale=step, normalization="sb", x_interpolant="quintic",
        gsparams=galsim.GSParams(**GSPARAMS), _force_maxk=PSF_MAXK, _force_stepk=2 * np.pi / (len(response) * step),
    )  # fmt: skip
    cut = slice(BOX // 2 - HALF, BOX // 2 + HALF + 1)
    errors = []
    for x, y in ((0.03, -0.22), (0.28, 0.28), (-0.47, 0.03), (-0.22, -0.47)):
        truth = direct((-0.5 - x, -0.5 - y))[cut, cut]
        image = galsim.ImageD(2 * HALF + 1, 2 * HALF + 1)
        point.drawImage(image, scale=1.0, method="no_pixel", center=image.true_center + galsim.PositionD(x, y))
        wanted, got = size_and_shape(truth, x, y), size_and_shape(image.array, x, y)
        errors.append(np.abs([got[0] / wanted[0] - 1, got[1] - wanted[1], got[2] - wanted[2]]))
        assert image.array.sum() == pytest.approx(truth.sum(), abs=1e-4)  # of the star's light
    return np.max(errors, axis=0)


@pytest.mark.parametrize("name", ["u", "z"])
def test_the_cells_of_a_band_reach_the_goal(camera, name):
    size, *shape = worst(camera, name, oversampling_of(name, camera.psf))
    assert size < 1e-3
    assert max(shape) < 1e-4


def test_two_cells_do_not_in_the_blue(camera):
    assert max(worst(camera, "u", 2)[1:]) > 2e-4


def test_auto_is_the_data_file_and_else_as_asked(camera):
    assert oversampling_of("z", camera.psf) == 2
    assert oversampling_of("NUV", camera.psf) == 4
    assert oversampling_of("NUV", camera.psf, 2) == 2
    for params in ({}, {"oversampling": {"NUV": 3}}, {"oversampling": {"NUV": True}}, {"oversampling": {"u": 4}}):
        with pytest.raises(InputError, match=r"psf\.yaml: oversampling\.NUV: bad sampling.*allowed: 2, 4"):
            oversampling_of("NUV", params)


def test_sums_of_cells_are_exact():
    rng = np.random.default_rng(5)
    fine = rng.random((3, 64, 64))
    assert np.array_equal(half_pixels(fine, 2), fine)
    half = half_pixels(fine, 4)
    assert half.shape == (3, 32, 32)
    assert half[1, 3, 5] == pytest.approx(fine[1, 6:8, 10:12].sum())
    odd = half_pixels(fine[:, 1:-1, 1:-1], 4)  # 62 cells: 31 half pixels, of which the middle 30
    assert odd == pytest.approx(half[:, 1:-1, 1:-1])
    # A pixel centred on the star is the same whatever the cells
    four, two = pixel_response(fine, 4), pixel_response(half, 2)
    assert four.shape == (3, 61, 61)
    assert four[:, 30, 30] == pytest.approx(two[:, 15, 15])
    assert four[0, 30, 30] == pytest.approx(fine[0, 30:34, 30:34].sum())
