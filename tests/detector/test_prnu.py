"""The pixels' response: its distribution and bound; a window has the chip's values."""

import numpy as np
import pytest
from scipy import stats

from csstsim.base.rng import Streams
from csstsim.detector.prnu import CLIP, highest, multiply, multiply_at

KEY = Streams(1, "1", 9, "x").chip_key("prnu")


def response(shape, x0=0, y0=0, rms=0.01, key=KEY):
    image = np.ones(shape, np.float32)
    multiply(image, x0, y0, rms, key)
    return image


def test_a_normal_distribution_held_at_its_bounds():
    """3e6 pixels: mean, rms (5 sigma), shape (KS, p > 1e-5); some 20 held at +-4.5 sigma; neighbours apart."""
    z = (response((1500, 2000)).astype(float) - 1) / 0.01
    assert abs(z.mean()) < 5 / np.sqrt(z.size)
    assert abs(z.std() - 1) < 5 / np.sqrt(2 * z.size)
    assert stats.kstest(z.ravel(), "norm").pvalue > 1e-5
    held = np.count_nonzero(abs(z) > CLIP - 1e-4)
    assert 5 < held < 45 and abs(z).max() < CLIP + 1e-4
    assert abs((z[:, 1:] * z[:, :-1]).mean()) < 5 / np.sqrt(z.size)


@pytest.mark.parametrize(("x0", "y0"), [(0, 0), (3, 5), (8, 1), (51, 0)])
def test_a_window_sees_the_pixels_of_the_chip(x0, y0):
    assert np.array_equal(response((20, 9), x0, y0), response((60, 60))[y0 : y0 + 20, x0 : x0 + 9])


def test_it_is_a_factor_with_a_bound():
    image = np.array([[0.0, -3.0, np.nan, 9e4]], np.float32)
    factor = response((1, 4), rms=0.1)
    multiply(image, 0, 0, 0.1, KEY)
    np.testing.assert_array_equal(image, np.float32([[0.0, -3.0, np.nan, 9e4]]) * factor)
    assert response((2000, 2000), rms=0.2).max() <= highest(0.2) * (1 + 1e-6)
    assert (response((3, 3), rms=0.0) == 1).all()
    assert not np.array_equal(response((3, 3)), response((3, 3), key=KEY + np.uint64(1)))


@pytest.mark.parametrize("rms", [-0.01, 0.23, np.nan])
def test_what_makes_a_response_negative_is_refused(rms):
    with pytest.raises(ValueError, match="relative rms"):
        response((2, 2), rms=rms)


def test_single_pixels_have_the_response_of_the_frame():
    """Every bit, in any order and one of them twice, the least and the largest response, held at the bounds, too."""
    frame = response((1500, 1501), 7, 4, 0.2)
    ends = [divmod(int(at), 1501) for at in (frame.argmin(), frame.argmax())]
    row, column = np.transpose([(3, 5), (1499, 0), (0, 1500), (3, 5), (8, 8), *ends])
    values = np.arange(1, 8, dtype=np.float32)
    multiply_at(values, column + 7, row + 4, 0.2, KEY)
    np.testing.assert_array_equal(values, np.arange(1, 8, dtype=np.float32) * frame[row, column])
    assert frame[ends[0]] == pytest.approx(1 - 0.2 * CLIP) and frame[ends[1]] == pytest.approx(highest(0.2))
    still = np.ones(2, np.float32)
    multiply_at(still, np.arange(2), np.arange(2), 0.0, KEY)
    assert (still == 1).all()
    with pytest.raises(ValueError, match="relative rms"):
        multiply_at(still, np.arange(2), np.arange(2), 0.23, KEY)


def test_the_bound_of_a_response_is_four_and_a_half_rms():
    assert CLIP == 4.5 and highest(0.01) == pytest.approx(1.045) and highest(0.0) == 1.0
