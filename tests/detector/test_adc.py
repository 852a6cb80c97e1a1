"""The converter: rounding, limits that never wrap, and its noise of 1/12 DN^2."""

from types import SimpleNamespace

import numpy as np
import pytest

from csstsim.base.rng import stream
from csstsim.detector.adc import channel_gains, clipping_fault, digitise, full_fault
from csstsim.detector.mask import CLIPPED, HOT


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
    error = digitise(value).image - value.astype(float)
    assert abs(np.mean(error**2) - 1 / 12) < 5 * np.sqrt(1 / 180 / n)
    assert abs(error.mean()) < 5 * np.sqrt(1 / 12 / n)


def test_noise_cut_at_zero_is_told():
    """Half of a Gaussian without a pedestal is cut; one pixel in a thousand is not worth a word."""
    noise = stream(9, "pedestal").normal(0.0, 5.0, (200, 200)).astype(np.float32)
    _, _, low = digitise(noise)
    fault = clipping_fault(low, noise.size)
    assert "layer bias" in fault and f"{100 * low / noise.size:.2g}%" in fault
    _, _, low = digitise(noise + 500)
    assert (low, clipping_fault(low, noise.size), clipping_fault(40, noise.size)) == (0, "", "")


def test_clipped_pixels_of_all_rows_are_counted_and_marked():
    """Forty rows, more than are digitised at once; marks that are there stay, and only clipped pixels get one."""
    image = np.arange(40 * 3, dtype=np.float32).reshape(40, 3)
    mask = np.full(image.shape, HOT, np.uint8)
    high, low = ([2, 17, 18, 39], [0, 2, 1, 0]), ([0, 20, 39], [1, 2, 2])
    image[high], image[low] = 1e6, -1.0
    digits, above, below = digitise(image, mask=mask)
    assert (above, below) == (4, 3)
    assert (digits[high] == 65535).all() and (digits[low] == 0).all()
    rest = np.ones(image.shape, bool)
    rest[high] = rest[low] = False
    assert np.array_equal(digits[rest], image[rest]) and (mask[rest] == HOT).all()
    assert (mask[~rest] == HOT | CLIPPED).all()


@pytest.mark.parametrize("adc_max", [0, -1, 65536])
def test_limits_that_no_converter_has_are_refused(adc_max):
    with pytest.raises(ValueError, match=f"adc_max = {adc_max} does not fit"):
        digitise(np.zeros((1, 1), np.float32), adc_max)


def test_a_frame_at_the_maximum_is_told():
    """A fifth of a small window may be the centre of a bright star."""
    frame = digitise(np.full((50, 40), 1e6, np.float32))
    assert full_fault(frame.high, frame.image.size).startswith(
        "the converter clipped 100% of the pixels at its maximum"
    )
    assert full_fault(400, 2000) == "" and "20.1%" in full_fault(402, 2000)


def test_one_pixel_in_a_thousand_may_be_cut():
    assert clipping_fault(41, 40_000).startswith("the converter clipped 0.1% of the pixels at 0 DN")
    assert clipping_fault(1000, 1_000_000) == "" and "0.11%" in clipping_fault(1100, 1_000_000)


class Levels:
    """Streams whose uniform numbers from -1 to 1 are known: channel n gets n / 16 of the way, the chip -0.6."""

    def channel(self, number, name):
        assert name == "gain"
        return SimpleNamespace(uniform=lambda low, high: low + (high - low) * number / 16)

    def chip(self, name):
        assert name == "gain"
        return SimpleNamespace(uniform=lambda low, high: low + (high - low) * 0.2)


def test_gains_spread_by_a_fraction_of_the_gain():
    detector = SimpleNamespace(channels_x=8, channels_y=2, gain=1.5, gain_spread=0.02)
    wanted = [1.5 * (1 + 0.02 * (number / 8 - 1)) for number in range(1, 17)]
    assert channel_gains(detector, Levels(), per_channel=True) == pytest.approx(wanted, rel=1e-12)
    assert channel_gains(detector, Levels(), per_channel=False) == pytest.approx([1.482] * 16, rel=1e-12)
