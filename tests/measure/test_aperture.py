"""Depth in an aperture, against the Gaussian's closed form."""

import numpy as np
import pytest
from scipy.special import erf

from csstsim.measure.aperture import aperture_depth


def gaussian(sigma, half=30):
    edges = np.arange(-half - 0.5, half + 1)
    line = 0.5 * np.diff(erf(edges / (np.sqrt(2) * sigma)))
    return np.outer(line, line)


@pytest.mark.parametrize("share", [0.5, 0.8])
def test_a_gaussian(share):
    """r^2 = -2 sigma^2 ln(1 - share), the pixel's 1/6 added to 2 sigma^2; within 1%."""
    flux, radius = aperture_depth(gaussian(4.0), 50.0, share=share)
    true = np.sqrt(-2 * (16 + 1 / 12) * np.log(1 - share))
    assert radius == pytest.approx(true, rel=0.01)
    light = share * flux
    assert light / np.sqrt(light + np.pi * radius**2 * 50.0) == pytest.approx(5.0)


def test_without_noise_of_the_sky_it_takes_25_electrons():
    assert aperture_depth(gaussian(1.0), 0.0)[0] == pytest.approx(25 / 0.8)


def test_a_stamp_too_small_is_refused():
    with pytest.raises(ValueError, match="less than"):
        aperture_depth(gaussian(10.0, half=3), 1.0)
