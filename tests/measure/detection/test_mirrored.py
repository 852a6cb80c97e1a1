"""Flux of a place less that of the mirrored one: discs and rings cancel, neighbours stay; its error is its scatter."""

import numpy as np
import pytest

from csstsim.measure.detection.mirrored import Smoothed, mirrored_excess

SIGMA = 5.0
AXIS = np.arange(61)
Y, X = np.meshgrid(AXIS, AXIS, indexing="ij")
KERNEL = np.exp(-0.5 * ((np.arange(7)[:, None] - 3) ** 2 + (np.arange(7) - 3) ** 2))


def point(x, y, flux):
    """A Gaussian of sigma 1 px, sampled in the middle of pixels."""
    return flux / (2 * np.pi) * np.exp(-0.5 * ((X - x) ** 2 + (Y - y) ** 2))


def disc(x, y, electrons, ratio=0.5, angle=0.7):
    """An elongated exponential with a ring, the same on both sides of x, y."""
    c, s = np.cos(angle), np.sin(angle)
    r = np.hypot(c * (X - x) + s * (Y - y), (c * (Y - y) - s * (X - x)) / ratio)
    return electrons * (np.exp(-r / 4) + 0.3 * np.exp(-0.5 * (r - 9) ** 2))


def smoothed_of(image, rms=1.0):
    return Smoothed.of(image.astype(np.float32), np.full(image.shape, rms, np.float32), KERNEL)


@pytest.mark.parametrize("centre", [(30.0, 30.0), (30.5, 29.5)])
@pytest.mark.parametrize("place", [(33.0, 30.0), (39.4, 36.2), (22.0, 33.0), (30.3, 29.8)])
def test_what_is_on_both_sides_cancels(place, centre):
    smoothed = smoothed_of(disc(*centre, 500.0))
    excess, error = mirrored_excess(smoothed, *place, *centre, 1e9)
    assert abs(excess) < 1e-3 * error


@pytest.mark.parametrize("place", [(36.0, 30.0), (27.4, 25.6)])
def test_a_neighbour_stays_with_its_flux(place):
    smoothed = smoothed_of(disc(30.0, 30.0, 500.0) + point(*place, 2000.0))
    excess, _ = mirrored_excess(smoothed, *place, 30.0, 30.0, 1e9)
    assert excess == pytest.approx(2000.0, rel=2e-3)
    opposite, _ = mirrored_excess(smoothed, 60.0 - place[0], 60.0 - place[1], 30.0, 30.0, 1e9)
    assert opposite == pytest.approx(-2000.0, rel=2e-3)


def test_the_error_is_the_scatter_of_background_and_light():
    rng = np.random.default_rng(8)
    expected, pulls = disc(30.0, 30.0, 300.0), []
    for _ in range(400):
        image = rng.poisson(expected) + rng.normal(0.0, 6.0, expected.shape)
        excess, error = mirrored_excess(smoothed_of(image, 6.0), 34.3, 31.1, 30.0, 30.0, 1e9)
        pulls.append(excess / error)
    assert np.std(pulls) == pytest.approx(1.0, abs=SIGMA / np.sqrt(800) + 0.02)
    assert abs(np.mean(pulls)) < SIGMA / np.sqrt(400)


def test_a_doubtful_centre_adds_the_gradient():
    """A centre known to sigma / 10: the other side changes by twice that times the gradient."""
    smoothed = smoothed_of(disc(30.0, 30.0, 300.0, ratio=1.0), 0.0)
    _, sure = mirrored_excess(smoothed, 34.0, 30.0, 30.0, 30.0, 1e9)
    _, doubtful = mirrored_excess(smoothed, 34.0, 30.0, 30.0, 30.0, 10.0)
    shifted, _ = mirrored_excess(smoothed, 34.0, 30.0, 30.0 + 0.1 * smoothed.sigma, 30.0, 1e9)
    assert np.sqrt(doubtful**2 - sure**2) == pytest.approx(abs(shifted), rel=0.05)


def test_the_centre_itself_and_places_beyond_the_image():
    smoothed = smoothed_of(point(30.0, 30.0, 900.0))
    assert mirrored_excess(smoothed, 30.0, 30.0, 30.0, 30.0, 0.0)[0] == 0.0
    excess, error = mirrored_excess(smoothed, 30.0, 30.0, 10.0, 10.0, 50.0)  # the other side is off the image
    assert excess == pytest.approx(900.0, rel=2e-3) and np.isfinite(error)
    assert mirrored_excess(smoothed, 500.0, 500.0, 400.0, 400.0, 50.0) == (0.0, 0.0)
