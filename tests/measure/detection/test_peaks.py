"""Peaks of the matched-filter S/N against scipy's filters; half-light radii against closed form and sep."""

import numpy as np
import pytest
import sep
from scipy.ndimage import convolve1d, maximum_filter

from csstsim.base.rng import stream
from csstsim.measure.detection.maps import BIN
from csstsim.measure.detection.peaks import WIDTH_FACTOR, find_peaks, smoothed_snr, smoothing
from csstsim.measure.light.half_light import RADIUS_MIN, half_light_radius

WEIGHT = np.array([0.1, 0.6, 1.0, 0.6, 0.1], np.float32)


@pytest.fixture
def noise():
    """Return (image, rms on bins and of pixels, hidden) of noise that varies over the frame."""
    rng = stream(71, "noise")
    rms = rng.uniform(1.0, 3.0, (45, 65)).astype(np.float32)
    of_pixels = np.repeat(np.repeat(rms, BIN, 0), BIN, 1)
    image = rng.normal(0.0, of_pixels).astype(np.float32)
    return image, rms, of_pixels, (rng.uniform(size=image.shape) < 0.02).astype(np.uint8)


def snr_by_scipy(image, rms):
    for axis in (0, 1):
        image = convolve1d(image, WEIGHT, axis=axis, mode="constant")
    return image / rms / (WEIGHT**2).sum()


def test_snr_is_that_of_scipys_convolution(noise):
    image, _, rms, _ = noise
    assert smoothed_snr(image, rms, WEIGHT) == pytest.approx(snr_by_scipy(image, rms), abs=2e-5)


def test_peaks_are_all_pixels_above_their_neighbours(noise):
    """Also at the frame's edges; a hidden pixel has no light, and is none."""
    image, rms, of_pixels, hidden = noise
    snr = snr_by_scipy(np.where(hidden, 0, image), of_pixels)
    highest = (snr == maximum_filter(snr, 3)) & (snr > 1.0) & (hidden == 0)
    x, y, value = find_peaks(image, rms, hidden, WEIGHT, 1.0)
    row, column = np.nonzero(highest)
    assert len(x) > 100 and {0, 89} <= set(y) and {0, 129} <= set(x)
    assert (y == row).all() and (x == column).all()
    assert value == pytest.approx(snr[row, column], abs=2e-5)


@pytest.mark.parametrize("shape", [(1, 1), (1, 40), (40, 1), (3, 3)])
def test_a_small_frame_has_its_peak(shape):
    image, none = np.zeros(shape, np.float32), np.zeros(shape, np.uint8)
    assert find_peaks(image, np.ones(shape, np.float32), none, WEIGHT, 3.0).x.shape == (0,)
    image[shape[0] // 2, shape[1] // 2] = 100.0
    x, y, _ = find_peaks(image, np.ones(shape, np.float32), none, WEIGHT, 3.0)
    assert (x, y) == (shape[1] // 2, shape[0] // 2)


def test_a_plateau_is_one_peak():
    image = np.zeros((30, 30), np.float32)
    image[10:14, 12:15] = 100.0
    weight = np.ones(1, np.float32)
    x, y, _ = find_peaks(image, np.ones_like(image), np.zeros(image.shape, np.uint8), weight, 3.0)
    assert (x, y) == (14, 13)


def test_pixels_without_a_value_are_no_peaks():
    image = np.full((20, 20), np.nan, np.float32)
    assert find_peaks(image, np.ones_like(image), np.zeros(image.shape, np.uint8), WEIGHT, 3.0).x.size == 0


@pytest.mark.parametrize("sigma", [0.8, 1.3, 2.0])
def test_the_smoothing_is_a_little_wider_than_the_psf(sigma):
    r2 = np.arange(-10, 11) ** 2
    weight = smoothing(np.exp(-0.5 * (r2[:, None] + r2) / sigma**2))
    assert weight.max() == 1.0
    assert np.sqrt(-0.5 / np.log(weight[weight.size // 2 + 1])) == pytest.approx(WIDTH_FACTOR * sigma, rel=0.02)


@pytest.mark.parametrize("sigma", [1.5, 4.0, 12.0])
def test_half_light_of_a_gaussian_is_the_closed_form(sigma):
    """R = sigma sqrt(2 ln 2), pixels included (sigma^2 + 1/12)."""
    y, x = np.mgrid[:161, :161]
    image = np.exp(-0.5 * ((x - 80.3) ** 2 + (y - 79.6) ** 2) / sigma**2)
    radius = half_light_radius(image, np.array([80.3]), np.array([79.6]), np.array([6 * sigma]))[0]
    assert radius == pytest.approx(np.sqrt(2 * np.log(2) * (sigma**2 + 1 / 12)), rel=0.005, abs=0.03)


def test_half_light_radii_are_seps():
    """Blobs with noise, cut by the frame's edge or not; without light it is the minimum."""
    image = stream(71, "noise").normal(0.0, 0.01, (120, 120))
    x, y = np.array([60.2, 3.0, 118.0, 30.0]), np.array([60.7, 50.0, 119.0, 90.0])
    v, u = np.mgrid[:120, :120]
    for k in range(3):
        image += np.exp(-0.5 * ((u - x[k]) ** 2 + (v - y[k]) ** 2) / 9.0)
    reach = np.full(4, 12.0)
    theirs, _ = sep.flux_radius(image, x[:3], y[:3], reach[:3], 0.5, subpix=5)
    assert half_light_radius(image, x[:3], y[:3], reach[:3]) == pytest.approx(theirs, abs=0.05)
    image[:] = 0.0
    assert (half_light_radius(image, x, y, reach) == RADIUS_MIN).all()
    assert half_light_radius(image, x[:0], y[:0], reach[:0]).shape == (0,)
