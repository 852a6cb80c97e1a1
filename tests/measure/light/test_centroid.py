"""Windowed positions against sep's, sources without one, and their errors against noisy images."""

import numpy as np
import pytest

from csstsim.base.rng import stream
from csstsim.measure.light.centroid import position_errors, windowed_positions
from csstsim.measure.light.photometry import psf_model

PX = 1e-3


@pytest.fixture(scope="module")
def stars(fabricate):
    rng, line = stream(80, "stars"), np.arange(40, 400, 40)
    x, y = (v.ravel() + rng.uniform(-0.5, 0.5, line.size**2) for v in np.meshgrid(line, line))
    image = np.zeros((440, 440))
    fabricate.add_stars(image, x, y, np.full(x.size, 20000.0))
    return x, y, image


@pytest.mark.parametrize("window", [1.5, 2.1, 6.0])
def test_positions_are_those_of_sep(fabricate, stars, window):
    import sep

    x, y, image = stars
    for picture in (image, fabricate.add_noise(image, 81) - fabricate.SKY):
        picture = picture.astype(np.float32)
        start, sigma = (np.rint(x), np.rint(y)), np.full(x.size, window)
        theirs = sep.winpos(picture, *start, sigma)
        our_x, our_y, failed = windowed_positions(picture, *start, sigma)
        assert not failed.any()
        # The edge of the window, four sigma out, runs through pixels; there the noise of wide ones is larger
        assert np.abs(our_x - theirs[0]).max() < PX * window and np.abs(our_y - theirs[1]).max() < PX * window
    clean_x, clean_y, _ = windowed_positions(image.astype(np.float32), *start, np.full(x.size, 1.5))
    assert np.abs(clean_x - x).max() < 2 * PX and np.abs(clean_y - y).max() < 2 * PX


def test_where_there_is_no_light_there_is_no_position():
    one = np.ones(1)
    for image in (np.zeros((9, 9)), -np.ones((9, 9)), np.full((9, 9), np.nan)):
        assert windowed_positions(image.astype(np.float32), 4 * one, 4 * one, 1.5 * one).failed.all()
    flat = np.ones((9, 9), np.float32)
    assert windowed_positions(flat, -50 * one, 4 * one, 1.5 * one).failed.all()
    x, y, failed = windowed_positions(flat, 4 * one, 4 * one, 1.0 * one)
    assert not failed.any() and (x[0], y[0]) == pytest.approx((4.0, 4.0))
    assert [len(v) for v in windowed_positions(flat, one[:0], one[:0], one[:0])] == [0, 0, 0]


@pytest.mark.parametrize(("extended", "window"), [(False, 1.5), (False, 2.1), (True, 3.0)])
def test_the_error_is_the_scatter(fabricate, stars, extended, window):
    """81 stars, 2 axes, 10 times: the width is known to 2.5 %, 5 sigma are 0.125."""
    x, y, image = stars
    model, pulls, sigma = psf_model(fabricate.psf, (0, 0), image.shape), [], np.full(x.size, window)
    rms = np.full(image.shape, fabricate.VARIANCE**0.5, np.float32)
    for seed in range(10):
        noisy = (fabricate.add_noise(0.1 * image, 82 + seed) - fabricate.SKY).astype(np.float32)
        found_x, found_y, _ = windowed_positions(noisy, x, y, sigma)
        error = position_errors(
            noisy, rms, found_x, found_y, sigma, np.full(x.size, extended), np.full(x.size, 2000.0), np.ones(x.size),
            model.at(x, y),
        )  # fmt: skip
        pulls += [*(found_x - x) / error, *(found_y - y) / error]
    assert 0.875 < np.std(pulls) < 1.125
    nothing = position_errors(
        np.zeros((9, 9), np.float32), rms[:9, :9].copy(), np.full(1, 4.0), np.full(1, 4.0), np.ones(1),
        np.full(1, extended), np.zeros(1), np.ones(1), model.at([4.0], [4.0]),
    )  # fmt: skip
    assert np.isinf(nothing).all()


@pytest.mark.parametrize("transpose", [False, True])
@pytest.mark.parametrize("sign", [1, -1])
def test_pixels_beyond_four_sigma_do_not_count(transpose, sign):
    """A symmetric source in the middle of a pixel; light 4.0 sigma away counts, that of the next pixel does not."""
    image = np.zeros((41, 37), np.float32)
    y, x = np.indices(image.shape)
    image += np.exp(-0.5 * ((x - 18) ** 2 + (y - 20) ** 2) / 1.5**2).astype(np.float32)
    if transpose:
        image = np.ascontiguousarray(image.T)
    middle = (20.0, 18.0) if transpose else (18.0, 20.0)

    def found(away):
        spoilt = image.copy()
        at = [int(middle[1]), int(middle[0])]
        at[1 if transpose else 0] += sign * away
        spoilt[tuple(at)] += 1e3
        x, y, failed = windowed_positions(
            spoilt, np.array([middle[0]]), np.array([middle[1]]), np.array([2.0])
        )  # fmt: skip
        assert not failed.any()
        return x[0], y[0]

    assert found(9) == middle
    moved = np.subtract(found(8), middle)
    along = moved[0 if transpose else 1]
    assert sign * along > 1e-3 and moved[1 if transpose else 0] == pytest.approx(0, abs=1e-9)
