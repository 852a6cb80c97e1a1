"""Moments and visible errors against closed forms for Gaussians, and their statistics against drawn images."""

import numpy as np
import pytest

from csstsim.bench.imaging.measures import NAMES, errors, moments
from csstsim.bench.summary import summarise

SIGMA = 3.0  # px, of the weight
ROUNDING = 1e-8
HALF = 40


def gaussian(xx, yy, xy=0.0, x=0.0, y=0.0, light=1.0):
    """A Gaussian of this covariance [px^2] about (x, y), sampled at pixel centres."""
    axis = np.arange(-HALF, HALF + 1)
    dx, dy = axis - x, (axis - y)[:, None]
    determinant = xx * yy - xy * xy
    form = (yy * dx * dx - 2 * xy * dx * dy + xx * dy * dy) / determinant
    return light * np.exp(-0.5 * form) / (2 * np.pi * np.sqrt(determinant))


def named(values):
    return dict(zip(NAMES, values, strict=True))


@pytest.mark.parametrize("place", [(0.0, 0.0), (0.31, -0.47)])
def test_moments_of_a_gaussian(place):
    """The product of two Gaussians is one: 1/variance = 1/4 + 1/9 along x, 1/6.25 + 1/9 along y."""
    got = moments(gaussian(4.0, 6.25, x=place[0], y=place[1], light=0.7), SIGMA).value
    xx, yy = 1 / (1 / 4.0 + 1 / 9), 1 / (1 / 6.25 + 1 / 9)
    assert got == pytest.approx([0.7, *place, (xx - yy) / (xx + yy), 0.0, xx + yy], abs=ROUNDING)


def test_diagonal_ellipticity():
    got = moments(gaussian(5.0, 5.0, 2.0), SIGMA).value
    inside = np.linalg.inv(np.linalg.inv([[5.0, 2.0], [2.0, 5.0]]) + np.eye(2) / 9)
    assert got[3:5] == pytest.approx([0.0, 2 * inside[0, 1] / np.trace(inside)], abs=ROUNDING)


def test_errors_are_differences():
    truth = gaussian(4.0, 4.0)
    values = named(errors(1.01 * gaussian(4.0, 4.0, x=0.1), truth, 50.0, 1000.0, mas_per_px=74.0)[0])
    assert values["flux"] == pytest.approx(0.01, abs=ROUNDING)
    assert values["x_mas"] == pytest.approx(7.4, abs=1e-5)
    assert [values[name] for name in ("y_mas", "e1", "e2", "size2")] == pytest.approx(np.zeros(4), abs=ROUNDING)


def test_visible_error_of_too_much_light():
    """Under a sky far above the object, a relative error d is seen at d F / sqrt(4 pi s^2 variance)."""
    truth, electrons, variance, wrong = gaussian(4.0, 4.0), 10.0, 1e4, 0.05
    values = named(errors((1 + wrong) * truth, truth, variance, electrons)[0])
    assert values["visible"] == pytest.approx(wrong * electrons / np.sqrt(4 * np.pi * 4 * variance), rel=1e-4)
    assert values["pixel"] == pytest.approx(wrong, rel=1e-9)


def test_the_edge_of_the_box_is_not_judged():
    truth = gaussian(4.0, 4.0)
    image = truth.copy()
    image[HALF + 20, HALF] += 1.0
    assert named(errors(image, truth, 50.0, 1e3, box=20.0)[0])["visible"] == 0
    assert named(errors(image, truth, 50.0, 1e3, box=25.0)[0])["visible"] > 1


@pytest.fixture(scope="module")
def drawn():
    """Errors and chances of 400 images of 20,000 random electrons each, 1% too wide."""
    rng, truth, number = np.random.default_rng(3), gaussian(4.0, 5.0, 0.5), 20_000
    image = gaussian(1.01 * 4.0, 1.01 * 5.0, 1.01 * 0.5)
    some = [errors(rng.poisson(number * image) / number, truth, 50.0, 5e5, number) for _ in range(400)]
    return np.array(some), errors(image, truth, 50.0, 5e5)[0]


def test_chance_is_the_scatter(drawn):
    """Of 400 standard deviations, each known to 3.5%: within 5 of that."""
    scatter, chance = drawn[0][:, 0].std(axis=0), drawn[0][:, 1].mean(axis=0)
    assert scatter[:6] == pytest.approx(chance[:6], rel=0.18)


def test_moments_are_not_biased_by_chance(drawn):
    values, chance = drawn[0][:, 0], drawn[0][:, 1].mean(axis=0)
    assert np.abs(values.mean(axis=0) - drawn[1])[:6] == pytest.approx(np.zeros(6), abs=4 * chance[:6].max() / 20)
    assert (np.abs(values.mean(axis=0) - drawn[1])[:6] < 4 * chance[:6] / 20).all()


def test_random_electrons_are_taken_off_the_visible_error(drawn):
    """25 times as bright as what is drawn, chance alone would show at some 30 sigma; on average it is taken off."""
    seen, chance = drawn[0][:, 0, 7], drawn[0][:, 1, 7]
    seen2 = np.sign(seen) * seen**2
    assert drawn[1][7] < 10 < np.median(chance)
    assert abs(seen2.mean() - drawn[1][7] ** 2) < 4 * (chance**2).mean() / 20
    assert seen2.std() == pytest.approx((chance**2).mean(), rel=0.25)  # and the scatter of it is as stated


@pytest.mark.parametrize("light", [1.0, 9.0, 1e4])
def test_the_spread_of_light_is_its_root(light):
    """Of so many electrons: that of their number; those of the centre and the shape fall with the root."""
    one, many = moments(gaussian(4.0, 5.0), SIGMA), moments(gaussian(4.0, 5.0, light=light), SIGMA)
    assert many.spread[0] == pytest.approx(np.sqrt(light))
    assert many.spread[1:] == pytest.approx(one.spread[1:] / np.sqrt(light))


def test_a_mean_over_objects_has_the_error_of_a_mean():
    """Sixteen objects whose biases scatter by 3e-3: the mean's error is a quarter of that; weighted by electrons."""

    class Goals:
        goals, shown = {"flux": 1e-3}, ("flux",)

    values = 0.01 + 3e-3 * np.resize([-1.0, 1.0], 16)
    row = {"method": "a", "kind": "star", "drawn": 100.0, "at_node": True, "cpu_s": 1e-3, "flux_chance": 0.0}
    rows = [
        row | {f"{name}_{which}": value for which in ("standard", "direct") for name in ("flux", "visible", "pixel")}
        | {"visible_chance": 0.1}
        for value in values
    ]  # fmt: skip
    line = summarise(rows, Goals, "r")[0]
    assert line["flux"] == pytest.approx(0.01) and line["flux_error"] == pytest.approx(3e-3 / 4)
    rows[0]["drawn"] = 1e9  # one that has nearly all electrons: the mean is its own
    assert summarise(rows, Goals, "r")[0]["flux"] == pytest.approx(values[0], rel=1e-5)
