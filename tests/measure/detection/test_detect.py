"""Detection's maps and positions: noise and level without free meshes, binned passes, errors of local fluxes."""

from dataclasses import replace

import numpy as np
import pytest
import sep
from measure.slitless import below
from scipy.ndimage import convolve

from csstsim.measure.detection.bright_stars import BrightStars
from csstsim.measure.detection.combine import local_flux
from csstsim.measure.detection.detect import (
    COLD_FWHM,
    FWHM_TO_SIGMA,
    Frame,
    _cold_pass,
    _sources,
    isophotes,
    peaks,
    star_sources,
    subtract_background,
)  # fmt: skip
from csstsim.measure.detection.maps import BIN, binned

SIGMA = 5.0
NONE = np.zeros(0)
NO_STARS = BrightStars(NONE, NONE, NONE, NONE, NONE.astype(int), np.zeros((0, 0, 0)), 2, NONE, NONE, np.zeros((0, 4)))
STAR = 0.95  # px, sigma of the fabricated PSF


@pytest.fixture
def noise(fabricate):
    """Return the noise of a pixel of sky, electron."""
    return np.sqrt(fabricate.VARIANCE)


def line(half, sigma=STAR):
    """Return the light of a Gaussian in pixels -half to half."""
    return np.diff(below(np.arange(-half, half + 2) - 0.5, sigma))


@pytest.mark.parametrize("crowded", [False, True], ids=["free", "crowded"])
def test_level_and_noise_are_those_of_a_pixel(fabricate, noise, crowded):
    """Also where so much is masked that the coarse, binned background must do: 2% of the noise, 0.15 e-."""
    image = fabricate.add_noise(np.zeros((700, 640)), 61)
    of_sums = subtract_background(image, np.full(image.shape, crowded, np.uint8))
    assert of_sums.shape == (350, 320)
    assert np.median(of_sums) == pytest.approx(BIN * noise, rel=0.02)
    assert image.mean() == pytest.approx(0.0, abs=0.15)


@pytest.mark.parametrize("scale", [1, BIN])
@pytest.mark.parametrize("position", [(20, 28), (31, 20), (40, 44)])
def test_positions_are_those_of_whole_pixels_whatever_the_bin(scale, position):
    """A block of light whose middle is known; where its window has no light the position is sep's own, unbinned."""
    image = np.zeros((80, 80), np.float32)
    x, y = position
    image[y : y + 8, x : x + 12] = 100.0
    found = sep.extract(binned(image) if scale == BIN else image, 10.0)
    sources = _sources(np.zeros_like(image), found, np.zeros(image.shape, np.int32), scale, None)
    assert sources.window_failed.all() and len(sources.x) == 1
    odd = np.array([x % scale, y % scale])  # a block that begins within a bin is known to that
    assert abs(sources.x[0] - (x + 5.5)) <= 0.01 + 0.5 * odd[0] and abs(sources.y[0] - (y + 3.5)) <= 0.01 + 0.5 * odd[1]


def test_extended_and_point_sources_lie_where_they_were_put(fabricate):
    """Stars and broad blobs: hot and cold positions to their own scatter (0.3 px of a blob), both without a shift."""
    image = np.zeros((900, 900))
    x, y = (v.ravel() for v in np.meshgrid(np.arange(60.3, 860, 100), np.arange(60.7, 860, 100)))
    blob = np.outer(line(30, 6.0), line(30, 6.0))
    blobs = np.arange(len(x)) % 2 == 0
    for u, v in zip(x[blobs], y[blobs], strict=True):
        i, j = round(u), round(v)
        image[j - 30 : j + 31, i - 30 : i + 31] += 40_000 * blob
    fabricate.add_stars(image, x[~blobs], y[~blobs], np.full((~blobs).sum(), 20_000.0))
    kernel = np.outer(line(3), line(3)).astype(np.float32)
    frame = isophotes(fabricate.add_noise(image, 62), NO_STARS, np.zeros(image.shape, np.uint8))
    tops, _ = peaks(frame, kernel, np.zeros(image.shape, np.uint8))
    centre = np.where(blobs, np.rint(x), x), np.where(blobs, np.rint(y), y)
    for found, mine in ((frame.extended, blobs), (tops, ~blobs)):
        distance = np.hypot(found.x[:, None] - centre[0][mine], found.y[:, None] - centre[1][mine])
        row = distance.argmin(axis=0)
        assert distance.min(axis=0).max() < 0.5
        dx, dy = found.x[row] - centre[0][mine], found.y[row] - centre[1][mine]
        assert max(abs(dx.mean()), abs(dy.mean())) < 0.05


def test_a_pixel_without_a_value_does_not_spread_in_a_crowd(fabricate):
    image = fabricate.add_noise(np.zeros((200, 200)), 67)
    image[::20, ::20] = np.nan
    subtract_background(image, np.ones(image.shape, np.uint8))
    assert np.isnan(image).sum() == 100


def test_maps_have_a_bin_for_a_last_odd_row_and_column(fabricate, noise):
    image = fabricate.add_noise(np.zeros((131, 97)), 66)
    frame = isophotes(image, NO_STARS, np.zeros(image.shape, np.uint8))
    assert frame.rms.shape == frame.segments.shape == (66, 49)
    assert (frame.rms[-1] == frame.rms[-2]).all() and np.median(frame.rms) == pytest.approx(noise, rel=0.05)


def test_a_local_flux_has_the_error_it_states(fabricate, noise):
    """On sky alone, 2500 positions: mean 0, pulls of width 1 (SIGMA of their number)."""
    image = fabricate.add_noise(np.zeros((560, 560)), 63) - np.float32(fabricate.SKY)
    rms = np.full((280, 280), noise, np.float32)
    kernel = np.outer(line(3), line(3))
    x, y = (v.ravel().astype(float) for v in np.meshgrid(np.arange(20, 540, 10.4), np.arange(20, 540, 10.4)))
    flux, error = local_flux(np.minimum(image, 0) + np.maximum(image, 0), rms, x, y, kernel)
    pull = flux / np.median(error)
    assert abs(pull.mean()) < SIGMA / np.sqrt(len(x))
    # Noise above the sky is taken for light of its own, which makes the stated error larger by up to a fifth
    assert 0.8 < pull.std() < 1.0 + SIGMA / np.sqrt(2 * len(x))


def test_the_cold_pass_finds_what_its_threshold_promises(fabricate, noise):
    """Blobs of S/N 4.5 in a smoothed, binned pixel, by scipy's convolution: 2.5 sigma finds nine in ten or more."""
    blob = np.outer(line(20, 4.0), line(20, 4.0))
    r2 = np.arange(-4, 5) ** 2
    kernel = np.exp(-0.5 * (r2[:, None] + r2) / (COLD_FWHM / FWHM_TO_SIGMA) ** 2)
    small = blob[:40, :40].reshape(20, 2, 20, 2).sum(axis=(1, 3))
    matched = convolve(small, kernel).max() / np.sqrt((kernel**2).sum())  # in noises of a binned pixel, twice a pixel's
    image = np.zeros((640, 640))
    positions = [(x, y) for x in range(50, 620, 60) for y in range(50, 620, 60)]
    for x, y in positions:
        image[y - 20 : y + 21, x - 20 : x + 21] += 4.5 * 2 * noise / matched * blob
    frame = fabricate.add_noise(image, 64)
    found, _ = _cold_pass(binned(frame - np.float32(fabricate.SKY)), np.full((320, 320), 2 * noise, np.float32))
    extended = isophotes(frame, NO_STARS, np.zeros(frame.shape, np.uint8)).extended
    for x, y in ((2 * found["x"] + 0.5, 2 * found["y"] + 0.5), (extended.x, extended.y)):
        distance = np.array([np.hypot(x - u, y - v).min() for u, v in positions])
        assert (distance < 6.0).mean() > 0.85


@pytest.mark.parametrize("scale", [1, BIN])
def test_isophotes_have_their_size_in_pixels_whatever_the_bin(scale):
    """A block of 12 x 8 px: its area, and axes of 1 / sqrt(12) of its sides."""
    image = np.zeros((80, 80), np.float32)
    image[20:28, 28:40] = 100.0
    found = sep.extract(binned(image) if scale == BIN else image, 10.0, filter_kernel=None)
    sources = _sources(image, found, np.zeros(image.shape, np.int32), scale, None)
    assert sources.area[0] == 96
    assert (sources.a[0], sources.b[0]) == pytest.approx((12 / np.sqrt(12), 8 / np.sqrt(12)), rel=0.04)


def test_unusable_pixels_do_not_count_for_the_background(fabricate):
    """A third of the columns, 10 electrons too bright, too faint a pattern to be masked."""
    image = fabricate.add_noise(np.zeros((600, 640)), 65)
    unusable = np.zeros(image.shape, np.uint8)
    unusable[:, ::3] = 2
    image[:, ::3] += 10.0
    subtract_background(image, unusable)
    assert image[unusable == 0].mean() == pytest.approx(0.0, abs=0.15)


@pytest.mark.parametrize("saturated", [True, False])
def test_a_saturated_star_is_where_its_fit_is(fabricate, saturated):
    """The light of its other pixels has another centre; a star with all of its pixels has a windowed position."""
    image = np.zeros((100, 100))
    fabricate.add_stars(image, [50.0], [40.0], [50_000.0])
    kernel = np.outer(line(3), line(3)).astype(np.float32)
    fit = {"x": np.array([50.4]), "y": np.array([39.7]), "flux": np.array([5e4]), "saturated": np.array([saturated])}
    stars = replace(NO_STARS, **fit)
    frame = Frame(image.astype(np.float32), np.ones((100, 100), np.float32), np.zeros((50, 50), np.int32), None, stars)
    found = star_sources(frame, kernel)
    wanted = (50.4, 39.7) if saturated else (50.0, 40.0)
    assert (found.x[0], found.y[0]) == pytest.approx(wanted, abs=0.02) and found.flux[0] == 5e4
