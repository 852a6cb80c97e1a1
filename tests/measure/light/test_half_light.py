"""Half-light radii in closed form: Gaussians within circles, off the pixels' middles, at an edge, without light."""

import numpy as np
import pytest

from csstsim.measure.light.half_light import BIN, RADIUS_MIN, half_light_radius


def gaussian(sigma, x, y, shape=(61, 71)):
    rows, columns = np.mgrid[: shape[0], : shape[1]]
    return np.exp(-0.5 * ((columns - x) ** 2 + (rows - y) ** 2) / sigma**2).astype(np.float32)


def radius(image, x, y, reach):
    return half_light_radius(image, np.array([x]), np.array([y]), np.array([reach]))[0]


@pytest.mark.parametrize("reach", [3.0, 6.0, 20.0])
@pytest.mark.parametrize(("sigma", "x", "y"), [(3.0, 30.3, 27.6), (4.0, 33.0, 31.5)])
def test_half_of_a_gaussian_within_the_reach(reach, sigma, x, y):
    """1 - exp(-r2 / 2 sigma2) is half of what it is at the reach."""
    half = 0.5 * (1 - np.exp(-0.5 * (reach / sigma) ** 2))
    expected = sigma * np.sqrt(-2 * np.log(1 - half))
    assert radius(gaussian(sigma, x, y), x, y, reach) == pytest.approx(expected, abs=0.5 * BIN)


def test_a_single_pixel_is_a_square_of_light():
    """Parts of a quarter pixel: half of the light lies within 0.4 px of the middle, which is less than RADIUS_MIN."""
    image = np.zeros((9, 9), np.float32)
    image[4, 6] = 100.0
    assert radius(image, 6.0, 4.0, 3.0) == RADIUS_MIN
    assert radius(image, 4.0, 4.0, 3.0) == pytest.approx(2.0, abs=0.15)
    assert radius(image, 6.0, 2.0, 3.0) == pytest.approx(2.0, abs=0.15)


def test_each_source_has_its_own_position_and_reach():
    """A disk of even light of radius R has half of it within R / sqrt(2); beyond the frame there is none."""
    image = np.ones((80, 120), np.float32)
    found = half_light_radius(
        image, np.array([40.0, 70.0, -0.5]), np.array([40.0, 39.0, 40.0]), np.array([10.0, 20, 12])
    )
    assert found == pytest.approx(np.array([10.0, 20.0, 12.0]) / np.sqrt(2), abs=BIN)


def test_without_light_it_is_the_minimum():
    image = gaussian(2.0, 30, 30)
    assert radius(-image, 30.0, 30.0, 9.0) == RADIUS_MIN and radius(0 * image, 30.0, 30.0, 9.0) == RADIUS_MIN
    assert radius(image, -50.0, 30.0, 9.0) == RADIUS_MIN and len(half_light_radius(image, *np.zeros((3, 0)))) == 0
