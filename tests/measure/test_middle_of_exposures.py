"""Means of calibration exposures: rays are left out for few exposures as for many; the level is kept."""

import numpy as np
import pytest

from csstsim.base.rng import stream
from csstsim.measure.calibration.masters import _average

READ_NOISE = np.float32(5.0)


@pytest.mark.parametrize("count", [2, 3, 4, 5, 8])
@pytest.mark.parametrize("struck", [0, -1])
def test_a_ray_in_one_exposure_is_left_out(count, struck):
    """Of two exposures, too: rays only add, so the lower one is believed."""
    images = [np.full((6, 7), 100.0 + k, np.float32) for k in range(count)]
    images[struck][2, 3] += 4000.0
    mean = _average(tuple(images), READ_NOISE)
    others = [image[2, 3] for k, image in enumerate(images) if k != struck % count]
    assert mean[2, 3] == pytest.approx(np.mean(others), abs=1e-3)
    mean[2, 3] = mean[0, 0]
    assert mean == pytest.approx(np.full(mean.shape, 100.0 + (count - 1) / 2), abs=1e-3)


def test_noise_is_not_taken_for_rays():
    """The mean of four exposures of noise has no bias: 5 sigma of 1e6 values."""
    rng = stream(67, "masters")
    images = tuple(
        (rng.poisson(50.0, (500, 500)) + rng.normal(0, 5.0, (500, 500))).astype(np.float32) for _ in range(4)
    )
    mean = _average(images, READ_NOISE)
    assert mean.mean(dtype=float) == pytest.approx(50.0, abs=5 * np.sqrt(75.0 / 1e6) + 2e-3)
