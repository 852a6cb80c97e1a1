"""Knots and images as spots: transforms against direct sums, extents, coefficients of images, alias tables."""

import numpy as np
import pytest

from csstsim.render.parts.spots import Spots, alias_table, image_coefficients, in_pixels
from csstsim.render.psf_table import spline_coefficients

KNOTS_U, KNOTS_V = np.array([1.0, -2.0, 0.5, 3.0, -1.0]), np.array([0.5, 1.5, -3.0, 4.0, 0.0])
EVEN = np.array([[0.0, 0.1, 0.4], [0.2, 0.0, 0.3], [0.5, 0.7, 0.1], [0.0, 0.6, 0.0]]) / 2.9  # 4 rows, 3 columns
ODD = np.array([[0.3, 0.0], [0.1, 0.2], [0.0, 0.9], [0.4, 0.0], [0.0, 0.5]]) / 2.4
MATRIX, SIZE, LAST = np.array([[0.9, 0.3], [-0.2, 1.4]]), 64, 20


@pytest.fixture(scope="module")
def spots():
    return Spots([2, 3], KNOTS_U, KNOTS_V, [EVEN, ODD])


def lit(image):
    """Return (u, v, light) of the lit pixels, row by row, from the middle of the image."""
    ny, nx = image.shape
    some = [(x - (nx - 1) / 2, y - (ny - 1) / 2, image[y, x]) for y in range(ny) for x in range(nx) if image[y, x] > 0]
    u, v, light = np.transpose(some)
    return u, v, light / light.sum()


GROUPS = {
    0: (KNOTS_U[:2], KNOTS_V[:2], np.full(2, 1 / 2)), 1: (KNOTS_U[2:], KNOTS_V[2:], np.full(3, 1 / 3)),
    2: lit(EVEN), 3: lit(ODD),
}  # fmt: skip


@pytest.mark.parametrize("group", GROUPS)
def test_a_transform_is_the_sum_over_spots(spots, group):
    """sum of light exp(-2 pi i f . r), times the transform of a pixel's quadratic B-spline for images; 2e-5."""
    u, v, light = GROUPS[group]
    for got, wanted in zip(spots.group(group), (u, v, light), strict=True):
        assert got == pytest.approx(wanted)
    got = spots.transform(group, MATRIX, SIZE, LAST)
    assert got.shape == (2 * LAST + 1, LAST + 1) and got.dtype == np.complex64
    x, y = MATRIX @ np.stack([u, v])
    for row, column in [(LAST, 0), (LAST + 3, 5), (LAST - 7, 11), (LAST, 20), (0, 0), (2 * LAST, 0), (LAST - 15, 2)]:
        f = np.array([column, row - LAST]) / SIZE
        wanted = (light * np.exp(-2j * np.pi * (f[0] * x + f[1] * y))).sum()
        if group > 1:
            wanted *= np.prod(np.sinc(MATRIX.T @ f)) ** 3
        assert abs(got[row, column] - wanted) < 2e-5, (row, column)
    beyond = np.hypot(np.arange(-LAST, LAST + 1)[:, None], np.arange(LAST + 1)) > LAST
    assert not got[beyond].any()


def test_what_spots_know_of_their_groups(spots):
    assert len(spots) == 4 and spots.start.tolist() == [0, 2, 5, 5 + 8, 5 + 8 + 6]
    assert spots.blur.tolist() == [0, 0, 1, 1]
    assert spots.image(0) is None and spots.image(1) is None
    assert spots.image(2) is EVEN and spots.image(3) is ODD
    # three half pixels of the spline beyond the farthest lit pixel, along both axes
    corners = np.hypot(1, 1.5), np.hypot(0.5, 2)
    wanted = [2.5, 5.0, corners[0] + np.sqrt(4.5), corners[1] + np.sqrt(4.5)]
    assert spots.extent == pytest.approx(wanted)
    assert len(Spots()) == 0 and Spots().extent.tolist() == [] and Spots([0]).extent.tolist() == [0.0]


def drawn(keep, other):
    """Return the probabilities with which an alias table draws."""
    fraction = keep / len(keep)
    np.add.at(fraction, other, (1 - keep) / len(keep))
    return fraction


@pytest.mark.parametrize("light", [[1.0], [2.0, 2.0], [1.0, 0.0, 3.0], [0.1, 5.0, 0.2, 0.7, 0.0, 3.0, 3.0]])
def test_an_alias_table_draws_each_as_often_as_its_light(light):
    light = np.array(light)
    assert drawn(*alias_table(light)) == pytest.approx(light / light.sum(), abs=1e-12)


def test_sampled_spots_are_drawn_by_their_light(spots):
    """Knots evenly; an image's pixels by numbers within their group."""
    start, u, v, keep, other, blur = spots.sampled
    assert (keep[:5] == 1).all() and start is spots.start and blur is spots.blur
    for group in (2, 3):
        part = slice(start[group], start[group + 1])
        a, b, light = GROUPS[group]
        assert u[part].tolist() == a.tolist() and v[part].tolist() == b.tolist()
        assert drawn(keep[part].copy(), other[part]) == pytest.approx(light, abs=1e-12)


def test_coefficients_give_the_pixels_of_a_smooth_image_back():
    """And the light in pixels of one spline is 1/6, 2/3, 1/6 along each axis."""
    one = np.zeros((3, 5))
    one[1, 2] = 1.0
    line = np.array([1 / 6, 2 / 3, 1 / 6])
    assert in_pixels(one)[:, 1:4] == pytest.approx(np.outer(line, line)) and in_pixels(one).sum() == pytest.approx(1)
    y, x = np.mgrid[:21, :25]
    image = 7.0 * np.exp(-0.5 * ((x - 13.3) ** 2 / 4 + (y - 9.6) ** 2 / 2.5))
    coefficients = image_coefficients(image)
    assert coefficients.shape == (23, 27) and coefficients.min() >= 0
    assert coefficients.sum() == pytest.approx(1)
    assert np.abs(in_pixels(coefficients)[1:-1, 1:-1] - image / image.sum()).max() < 1e-4 * image.max() / image.sum()


def test_single_bright_pixels_get_no_negative_coefficients():
    """Steps of Richardson and Lucy: the light stays at its pixels, by its fraction; splines cannot give it all back."""
    image = np.zeros((9, 11))
    image[2, 3], image[6, 8] = 3.0, 1.0
    coefficients = image_coefficients(image)
    assert coefficients.min() >= 0 and coefficients.sum() == pytest.approx(1)
    seen = in_pixels(coefficients)
    for y, x, fraction in ((3, 4, 0.75), (7, 9, 0.25)):
        assert coefficients[y - 1 : y + 2, x - 1 : x + 2].sum() == pytest.approx(fraction, abs=1e-6)
        assert seen[y, x] == pytest.approx(4 / 9 * fraction, rel=1e-3)


def test_an_image_with_bright_pixels_is_nearer_than_by_cutting_what_is_negative():
    """The divergence of Kullback and Leibler, which the steps lower, is a half of that of coefficients cut at zero."""
    image = np.ones((9, 11))
    image[4, 6], image[2, 2] = 30.0, 10.0
    cut, below = spline_coefficients(np.pad(image, 1))
    assert below > 1e-3 * image.sum()

    def divergence(coefficients):
        seen = in_pixels(coefficients / coefficients.sum())[1:-1, 1:-1]
        fraction = image / image.sum()
        return (fraction * np.log(fraction / seen)).sum()

    assert divergence(image_coefficients(image)) < 0.7 * divergence(cut)
