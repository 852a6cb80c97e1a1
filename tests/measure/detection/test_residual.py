"""What is left of a frame: units, what is hidden, the models of all sources."""

import numpy as np
import pytest

from csstsim.base.rng import stream
from csstsim.measure.detection.residual import BLANK, HIDDEN, MESH, STEP, ZERO, residual, values


def test_units_and_what_is_not_known():
    image = np.zeros((40, 50), np.float32)
    left = np.full((40, 50), 3.0, np.float32)
    image[:] = left + 1.0
    rms = np.full((20, 25), 2.0, np.float32)  # on bins
    unusable = np.zeros((40, 50), np.uint8)
    unusable[1, 2] = 4
    left[3, 4], image[3, 4] = 2.0 * STEP * 127, 2.0 * STEP * 127
    image[5, 6] = left[5, 6] + 2.0 * HIDDEN
    rms[3, 4] = 0.0
    rms[5, 6] = 2.0 * 1.3  # of a bright star's model
    left[9, 9] = image[9, 9] = np.nan
    steps, noise = residual(image, left, rms, unusable)
    blank = np.argwhere(steps == BLANK).tolist()
    noisy = [[6, 8], [6, 9], [7, 8], [7, 9], [10, 12], [10, 13], [11, 12], [11, 13]]
    assert blank == sorted([[1, 2], [3, 4], [5, 6], [9, 9], *noisy])
    assert (steps[0] == ZERO + round(1.5 / STEP)).all() and noise.shape == (2, 2) and (noise == 2.0).all()
    assert values(steps)[0, 0] == 1.5 and values(steps)[1, 2] == 0.0
    assert MESH * (len(noise) - 1) < 40


def test_noise_and_faint_stars_are_left_of_a_field(fabricate):
    """Stars of S/N 40 are hidden or gone, those of S/N 3 stay. 5 sigma."""
    rng = stream(5, "field")
    n = 420
    line = np.arange(35, n - 30, 70)
    x, y = (one.ravel() + rng.uniform(-0.5, 0.5, 36) for one in np.meshgrid(line, line))
    bright = np.arange(36) % 2 == 0
    error = np.sqrt(fabricate.VARIANCE * 4.0 * np.pi * (fabricate.SIGMA**2 + 1 / 12))  # of a star's flux
    image = np.zeros((n, n))
    fabricate.add_stars(image, x, y, np.where(bright, 40.0, 3.0) * error)
    kept = []
    fabricate.measure(fabricate.add_noise(image, 8), keep=kept.append)
    (left,) = kept
    known = left.steps != BLANK
    pixels = values(left.steps)
    assert known.mean() > 0.99 and pixels[known].std() == pytest.approx(1.0, abs=0.02)
    assert left.noise == pytest.approx(np.sqrt(fabricate.VARIANCE), rel=0.03)
    at = np.rint(y).astype(int), np.rint(x).astype(int)
    assert not known[at][bright].any() and known[at][~bright].all()
    offsets = np.arange(-3, 4)
    stamps = pixels[at[0][:, None, None] + offsets[:, None], at[1][:, None, None] + offsets]
    sums = stamps.sum(axis=(1, 2))
    scatter = 7.0 / np.sqrt(18)  # of means of 49 pixels each
    assert sums[~bright].mean() == pytest.approx(3.0 * error / np.sqrt(fabricate.VARIANCE), abs=5 * scatter)
    assert abs(sums[bright].mean()) < 5 * scatter
