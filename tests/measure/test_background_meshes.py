"""Levels and noise of backgrounds: gradients, scatter reduced by clipping, the mean of skewed noise."""

import numpy as np
import pytest
from scipy.stats import truncnorm

from csstsim.base.rng import stream
from csstsim.measure.detection.background import (
    CLIP,
    CLIP_LOSS,
    SECOND_BOX,
    _clipped,
    crude_background,
    masked_background,
)
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
    """What clipping takes off a Gaussian's scatter is put back: its own, by scipy; outliers move neither."""
    assert pytest.approx(truncnorm(-CLIP, CLIP).std(), abs=1e-4) == CLIP_LOSS
    values = stream(65, "clipped").normal(100.0, 8.0, 400_000).astype(np.float32)
    centre, sigma = _clipped(values)
    assert sigma == pytest.approx(8.0, rel=SIGMA / np.sqrt(2 * values.size))
    assert centre == pytest.approx(100.0, abs=SIGMA * 8.0 / np.sqrt(values.size))
    values[::100] = 5000.0
    assert _clipped(values) == pytest.approx((100.0, 8.0), rel=0.005)


def test_the_mode_of_skewed_noise_is_made_a_mean(fabricate):
    """Sums of four pixels of sky: 0.12 e- (SIGMA of a million), where the mode lies 0.24 below the mean."""
    small = binned(fabricate.add_noise(np.zeros((2048, 2048)), 66))
    level, rms = crude_background(small)
    assert float(level.mean()) == pytest.approx(4 * fabricate.SKY, abs=0.12)
    assert float(rms.mean()) == pytest.approx(2 * np.sqrt(fabricate.VARIANCE), rel=0.02)
