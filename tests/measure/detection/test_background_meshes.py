"""Levels and noise of backgrounds: gradients, scatter reduced by clipping, the mean of skewed noise."""

import numpy as np
import pytest

from csstsim.base.rng import stream
from csstsim.measure.detection.background import (
    SECOND_BOX,
    Mesh,
    _clipped,
    _filled,
    crude_background,
    masked_background,
)
from csstsim.measure.detection.detect import subtract_background
from csstsim.measure.detection.maps import binned

SIGMA = 5.0


def test_a_slope_stands_where_it_is():
    """A plane of 0.02 e- a pixel along y, half of that along x: 0.02 e- within the outer meshes, half a mesh is 0.6."""
    ny, nx = 8 * SECOND_BOX, 9 * SECOND_BOX
    y, x = np.mgrid[:ny, :nx]
    plane = (40.0 + 0.01 * x - 0.02 * y).astype(np.float32)
    mesh = masked_background(plane, np.zeros(binned(plane).shape, bool), np.zeros(plane.shape, np.uint8))
    rest = plane.copy()
    mesh.subtract_from(rest)
    inner = np.s_[SECOND_BOX * 3 // 2 : -SECOND_BOX * 3 // 2, SECOND_BOX * 3 // 2 : -SECOND_BOX * 3 // 2]
    assert np.abs(rest)[inner].max() < 0.02


def test_clipped_noise_is_that_of_all_pixels():
    """Outliers move neither the level nor the noise of a Gaussian."""
    values = stream(65, "clipped").normal(100.0, 8.0, 400_000).astype(np.float32)
    centre, sigma = _clipped(values)
    assert sigma == pytest.approx(8.0, rel=SIGMA / np.sqrt(2 * values.size))
    assert centre == pytest.approx(100.0, abs=SIGMA * 8.0 / np.sqrt(values.size))
    values[::100] = 5000.0
    assert _clipped(values) == pytest.approx((100.0, 8.0), rel=0.005)


def test_what_is_not_flagged_is_in_the_level():
    """A pixel in a thousand has a ray of 4 sigma: sources have such rays, too."""
    noise = stream(67, "rays").normal(100.0, 8.0, 1_000_000).astype(np.float32)
    with_rays = noise.copy()
    with_rays[500::1000] = 132.0
    added = _clipped(with_rays)[0] - _clipped(noise)[0]
    assert added == pytest.approx(0.032, abs=0.001)


def test_an_empty_frame_keeps_no_light(fabricate):
    """Noise above the background is masked as if it were sources, and noise below it as well: else 0.02 e-."""
    frame = fabricate.add_noise(np.zeros((2048, 2048)), 68)
    subtract_background(frame, np.zeros(frame.shape, np.uint8))
    assert abs(float(frame.mean(dtype=float))) < 0.006


def test_the_mode_of_skewed_noise_is_made_a_mean(fabricate):
    """Sums of four pixels of sky: 0.12 e- (SIGMA of a million), where the mode lies 0.24 below the mean."""
    small = binned(fabricate.add_noise(np.zeros((2048, 2048)), 66))
    level, rms = crude_background(small)
    assert float(level.mean()) == pytest.approx(4 * fabricate.SKY, abs=0.12)
    assert float(rms.mean()) == pytest.approx(2 * np.sqrt(fabricate.VARIANCE), rel=0.02)


def test_masked_and_unusable_pixels_do_not_count():
    """A frame of one mesh: half of it masked at another level, a row unusable at a third."""
    image = np.full((60, 80), 30.0, np.float32)
    image[:, ::2] = 34.0
    mask = np.zeros((30, 40), bool)
    mask[:, 20:], image[:, 40:] = True, 900.0
    unusable = np.zeros(image.shape, np.uint8)
    unusable[10], image[10] = 4, -500.0
    mesh = masked_background(image, mask, unusable)
    assert mesh.level.tolist() == [[pytest.approx(32.0)]] and mesh.rms[0, 0] == pytest.approx(2.0)
    assert [axis.tolist() for axis in mesh.middle] == [[29.5], [39.5]]
    assert masked_background(image, np.ones_like(mask), unusable) is None


@pytest.mark.parametrize(("good", "used"), [(1024, True), (1023, False)])
def test_a_mesh_needs_a_quarter_of_its_pixels(good, used):
    """Of 64 px; with less it has the level of its neighbour, in front of the median of nine."""
    image = np.full((64, 192), 20.0, np.float32)
    image[:, 64:] = 50.0
    unusable = np.zeros(image.shape, np.uint8)
    unusable[:, :64] = (np.arange(64 * 64) >= good).reshape(64, 64)
    level = masked_background(image, np.zeros((32, 96), bool), unusable, box=64).level
    assert level.shape == (1, 3) and level[0, 0] == (20.0 if used else 50.0)


def test_noise_of_binned_pixels_is_that_of_sums_at_their_middles():
    """Two meshes, 3 and 7 e-: twice that on 2 x 2 pixels, whose middles lie at (m - 0.5) / 2; never nothing."""
    mesh = Mesh(np.zeros((1, 2)), np.array([[3.0, 7.0]]), (np.array([9.5]), np.array([10.5, 30.5])))
    assert mesh.noise((10, 20))[4, [0, 5, 10, 15, 19]] == pytest.approx([6.0, 6.0, 10.0, 14.0, 14.0])
    dark = Mesh(np.zeros((1, 1)), np.zeros((1, 1)), (np.zeros(1), np.zeros(1)))
    assert (dark.noise((3, 4)) == np.float32(2e-3)).all()


def test_missing_meshes_are_those_next_to_them_and_outliers_their_median():
    mesh = np.array([[1.0, 2.0, np.nan], [1.0, 90.0, 3.0], [2.0, 2.0, 3.0]])
    filled = _filled(mesh)
    assert filled[1, 1] == 2.0 and np.isfinite(filled).all() and filled.max() == 3.0
