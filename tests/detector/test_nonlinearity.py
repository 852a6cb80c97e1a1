"""The polynomial against its closed form, its inverse and numpy's roots; signal in e-."""

import numpy as np
import pytest

from csstsim.base.rng import stream
from csstsim.detector.cubic import linearise, smallest_slope
from csstsim.detector.nonlinearity import apply_nonlinearity

LIMIT = 90_000.0
CURVES = [(-5e-7, 0.0), (-3e-6, 1.5e-11), (4e-6, -1e-11), (0.0, 0.0), (0.0, 2e-10), (-1e-5, 4e-11)]
RISING = [*CURVES, (-5.5e-6, 0.0)]


def bent(charge, quadratic, cubic):
    """The definition, in double precision."""
    charge = np.asarray(charge, float)
    inside = np.clip(charge, 0, LIMIT)
    steep = 1 + 2 * quadratic * LIMIT + 3 * cubic * LIMIT**2
    return inside + quadratic * inside**2 + cubic * inside**3 + (charge - inside) * np.where(charge > LIMIT, steep, 1)


@pytest.mark.parametrize(("quadratic", "cubic"), RISING)
def test_closed_form_within_float32(quadratic, cubic):
    charge = np.linspace(-500, 3 * LIMIT, 30_000, dtype=np.float32).reshape(100, 300)
    image = charge.copy()
    apply_nonlinearity(image, quadratic, cubic, LIMIT)
    wanted = bent(charge, quadratic, cubic)
    assert np.abs(image - wanted).max() <= 0.5 * np.spacing(np.float32(np.abs(wanted).max())) * 1.01
    assert (np.diff(wanted.ravel()) > 0).all()


def test_the_shipped_curve_loses_two_and_a_half_per_cent_at_fifty_thousand():
    image = np.full((1, 1), 50_000.0, np.float32)
    apply_nonlinearity(image, -5e-7, 0.0, LIMIT)
    assert abs(image[0, 0] - 48_750.0) < 0.004


@pytest.mark.parametrize(("quadratic", "cubic"), RISING)
def test_inverse_to_a_thousandth_of_an_electron(quadratic, cubic):
    charge = np.concatenate([stream(1, "charge").uniform(-100, 1.5 * LIMIT, 20_000), [0.0, LIMIT, 1e7, -1e7, 1e-6]])
    assert np.abs(linearise(bent(charge, quadratic, cubic), quadratic, cubic, LIMIT) - charge).max() < 1e-3
    assert linearise(5.0, quadratic, cubic, LIMIT).shape == ()
    assert np.isnan(linearise([np.nan], quadratic, cubic, LIMIT)).all()
    assert linearise(np.zeros((0, 3)), quadratic, cubic, LIMIT).shape == (0, 3)


@pytest.mark.parametrize(("quadratic", "cubic"), [*CURVES, (-5.6e-6, 0.0), (1e-6, -5e-11)])
def test_smallest_slope(quadratic, cubic):
    x = np.linspace(0, LIMIT, 200_001)
    assert abs(smallest_slope(quadratic, cubic, LIMIT) - np.min(1 + 2 * quadratic * x + 3 * cubic * x**2)) < 1e-9


@pytest.mark.parametrize(("quadratic", "cubic"), [(-2e-5, 1.2e-10), (-5.6e-6, 0.0), (np.nan, 0.0)])
def test_a_signal_that_falls_is_refused(quadratic, cubic):
    image = np.ones((2, 2), np.float32)
    for call in (apply_nonlinearity, linearise):
        with pytest.raises(ValueError, match=r"does not increase over 0\.\.90000 e-"):
            call(image, quadratic, cubic, LIMIT)
    assert (image == 1).all()


def test_a_part_of_an_image():
    image = np.full((6, 8), 50_000.0, np.float32)
    apply_nonlinearity(image[2:4, 1:5], -5e-7, 0.0, LIMIT)
    assert (image == 50_000).sum() == 40 and (image[2:4, 1:5] == 48_750).all()


def test_limits():
    for value, wanted in ((0.0, 0.0), (-3.0, -3.0), (LIMIT, 85_950.0), (1.1 * LIMIT, 85_950.0 + 0.91 * 9000.0)):
        image = np.full((1, 1), value, np.float32)
        apply_nonlinearity(image, -5e-7, 0.0, LIMIT)
        assert abs(image[0, 0] - wanted) < 0.01
    apply_nonlinearity(empty := np.zeros((0, 3), np.float32), -5e-7, 0.0, LIMIT)
    assert empty.size == 0
    for bad in (np.nan, np.inf, -np.inf):
        image = np.zeros((3, 3), np.float32)
        image[1, 1] = bad
        with pytest.raises(ValueError, match=r"1 pixel\(s\) is not finite"):
            apply_nonlinearity(image, -5e-7, 0.0, LIMIT)
