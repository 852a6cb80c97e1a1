"""The converter: rounding, limits that never wrap, and its noise of 1/12 DN^2."""

import numpy as np
import pytest

from csstsim.base.rng import stream
from csstsim.detector.adc import cut_noise, digitise


def test_rounding_and_limits():
    value = np.array([[-0.4, -0.6, 0.49, 0.51, 65534.6, 65535.4, 65535.6, 7e9, -7e9]], np.float32)
    digits, high, low = digitise(value)
    assert digits.dtype == np.uint16
    assert digits.tolist() == [[0, 0, 0, 1, 65535, 65535, 65535, 65535, 0]]
    assert (high, low) == (2, 2)  # 65535.6 and 7e9; -0.6 and -7e9


def test_smaller_converter():
    digits, high, low = digitise(np.array([[1000.0, 1023.4, 1024.0]], np.float32), adc_max=1023)
    assert digits.tolist() == [[1000, 1023, 1023]]
    assert (high, low) == (1, 0)
    with pytest.raises(ValueError, match="16 bits"):
        digitise(np.zeros((1, 1), np.float32), adc_max=70000)


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_not_finite(bad):
    image = np.zeros((130, 3), np.float32)
    image[0, 0] = image[129, 2] = bad
    with pytest.raises(ValueError, match=r"2 pixel\(s\)"):
        digitise(image)


def test_noise_of_rounding():
    """Uniform phases: variance 1/12 within 5 sigma; var of the squared error of a uniform is 1/180."""
    n = 1_000_000
    value = stream(1, "adc").uniform(100, 1100, (1, n)).astype(np.float32)
    error = digitise(value)[0] - value.astype(float)
    assert abs(np.mean(error**2) - 1 / 12) < 5 * np.sqrt(1 / 180 / n)
    assert abs(error.mean()) < 5 * np.sqrt(1 / 12 / n)


def test_noise_cut_at_zero_is_told():
    """Half of a Gaussian without a pedestal is cut; one pixel in a thousand is not worth a word."""
    noise = stream(9, "pedestal").normal(0.0, 5.0, (200, 200)).astype(np.float32)
    _, _, low = digitise(noise)
    assert "layer bias" in cut_noise(low, noise.size) and f"{100 * low / noise.size:.2g}%" in cut_noise(low, noise.size)
    _, _, low = digitise(noise + 500)
    assert (low, cut_noise(low, noise.size), cut_noise(40, noise.size)) == (0, "", "")
