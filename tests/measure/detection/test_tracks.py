"""Faint tracks of cosmic rays are told from stars and from galaxies seen from their edges."""

import math

import galsim
import numpy as np
import pytest

from csstsim.base.rng import stream
from csstsim.measure.detection.tracks import _strips, tracks

NOISE, HALF, PSF = 7.5, 20, 0.9  # electron; px, half a stamp; px, sigma


def track(angle, length, light):
    """Return a stamp of a line of `length` px, a quarter of a pixel wide, in fine steps: charge without the PSF."""
    stamp, steps = np.zeros((2 * HALF + 1, 2 * HALF + 1)), 4000
    along = np.linspace(-0.5, 0.5, steps) * length
    x, y = np.rint(HALF + 0.2 + math.cos(angle) * along), np.rint(HALF - 0.3 + math.sin(angle) * along)
    np.add.at(stamp, (y.astype(int), x.astype(int)), light / steps)
    return stamp


def galaxy(angle, flux, q, size):
    galsim.errors.raise_fft_size_error = True
    profile = galsim.Exponential(half_light_radius=size, flux=flux)
    profile = profile.shear(q=q, beta=angle * galsim.radians)
    image = galsim.Convolve(profile, galsim.Gaussian(sigma=PSF)).drawImage(nx=2 * HALF + 1, ny=2 * HALF + 1, scale=1.0)
    return image.array


def fraction_called_tracks(draw, n=200):
    """Return the fraction of n noisy stamps of `draw(angle)` that are called tracks, and their mean S/N as points."""
    called, rng, ratios = 0, stream(80, "tracks"), []
    axis = np.arange(-4, 5)
    weight = np.exp(-0.5 * (axis[:, None] ** 2 + axis**2) / 1.0)
    for k in range(n):
        image = draw(math.pi * k / n)
        light = np.maximum(image, 0.0)
        image = (image + rng.normal(0.0, 1.0, image.shape) * np.sqrt(NOISE**2 + light)).astype(np.float32)
        middle = image[HALF - 4 : HALF + 5, HALF - 4 : HALF + 5]
        snr = np.array([(middle * weight).sum() / math.sqrt((weight**2).sum()) / NOISE])
        ratios.append(snr[0])
        position = np.array([float(HALF)])
        called += tracks(image, np.full(image.shape, NOISE, np.float32), position, position, snr)[0]
    return called / n, np.mean(ratios)


@pytest.mark.parametrize("length", [10, 20])
def test_tracks_are_found(length):
    """Of S/N about 7 as points; those along an axis that happen to fill two rows alike are not told from a star."""
    fraction, snr = fraction_called_tracks(lambda angle: track(angle, length, 40.0 * length))
    assert 6 < snr < 12
    assert fraction > 0.85


@pytest.mark.parametrize(
    "draw",
    [
        lambda angle: galaxy(angle, 700.0, 0.999, 0.01),
        lambda angle: galaxy(angle, 20_000.0, 0.999, 0.01),
        lambda angle: galaxy(angle, 1_500.0, 0.15, 4.0),
        lambda angle: galaxy(angle, 30_000.0, 0.15, 6.0),
    ],
    ids=["faint star", "bright star", "faint edge-on galaxy", "bright edge-on galaxy"],
)
def test_stars_and_galaxies_are_not_tracks(draw):
    fraction, snr = fraction_called_tracks(draw)
    assert snr > 5
    assert fraction < 0.03


def test_corners():
    """No sources; off the frame; at its edge; no light at all; NaN."""
    image, rms = np.zeros((9, 9), np.float32), np.ones((9, 9), np.float32)
    none = np.zeros(0)
    assert tracks(image, rms, none, none, none).shape == (0,)
    x, y = np.array([-3.0, 0.0, 8.0, 20.0]), np.array([4.0, 0.0, 8.0, 4.0])
    assert not tracks(image, rms, x, y, np.full(4, 5.0)).any()
    assert not tracks(image * np.nan, rms, x, y, np.full(4, 5.0)).any()


def test_strips_are_straight_along_their_direction_and_as_long_and_wide_as_said():
    """24 directions over half a turn, each with five shifts of a quarter of a pixel to its left; 10 px long.

    Whole pixels are cut at the ends, one of 10 along and one of 6 across, where the wide Gaussian has 5% of its width.
    """
    offsets, narrow, wide = _strips()
    assert len(offsets) == len(narrow) == len(wide) == 24 * 5
    for k in range(len(offsets)):
        angle, shift = math.pi * (k // 5) / 24, 0.25 * (k % 5 - 2)
        v, u = offsets[k].T
        along, across = math.cos(angle) * u + math.sin(angle) * v, math.cos(angle) * v - math.sin(angle) * u
        for weights, sigma in ((narrow[k], 0.5), (wide[k], 1.2)):
            total = weights.sum()
            assert (weights * across).sum() / total == pytest.approx(shift, abs=0.07)
            width = math.sqrt((weights * (across - shift) ** 2).sum() / total)
            assert width == pytest.approx(sigma, rel=0.12)
            assert (weights * along).sum() / total == pytest.approx(0.0, abs=0.5)
            assert (weights * along**2).sum() / total == pytest.approx(100 / 12, rel=0.25)
            assert total == pytest.approx(math.sqrt(2 * math.pi) * sigma * 10, rel=0.15)
            assert np.abs(along[weights > 0]).max() <= 5 + 1e-9


@pytest.mark.parametrize(("snr", "rms", "called"), [(14.3, 7.5, True), (14.7, 7.5, False), (14.3, 7.7, False)])
def test_a_row_of_light_is_a_track_at_its_position_if_it_is_longer_than_a_point(snr, rms, called):
    """Of 40 e- a pixel: strips of 11 px have 440 e- over the root of 11 (1 + 2 exp(-4)), 130.3: 1.2 of 14.48 x 7.5."""
    image, noise = np.zeros((30, 60), np.float32), np.full((15, 30), 100.0, np.float32)
    image[9, 30:55] = 40.0
    noise[4, 21] = rms  # of the bin of 9, 42
    x, y = np.array([41.8, 9.0, 20.0]), np.array([8.6, 20.0, 20.0])
    assert tracks(image, noise, x, y, np.array([snr, 0.1, 0.1])).tolist() == [called, False, False]
