"""Stated errors of stars: positions and PSF fluxes scatter accordingly, from S/N 5 to 500."""

import math

import numpy as np
import pytest
from scipy.spatial import cKDTree

from csstsim.base.rng import stream

BINS = [(5, 9), (9, 20), (20, 50), (50, 150), (150, 500)]


@pytest.fixture(scope="module")
def pulls(fabricate):
    """(true S/N, pulls in x, in y, of the flux) of the found ones of 3136 isolated stars."""
    n, step = 1480, 26
    rng = stream(60, "stars")
    line = np.arange(15, n - 15, step)
    x, y = (v.ravel() + rng.uniform(-0.5, 0.5, line.size**2) for v in np.meshgrid(line, line))
    n_eff = 4.0 * math.pi * (fabricate.SIGMA**2 + 1 / 12)  # of a Gaussian, pixel included; not from the code
    snr = 10.0 ** rng.uniform(math.log10(5.0), math.log10(500.0), x.size)
    flux = 0.5 * snr * (snr + np.sqrt(snr**2 + 4 * n_eff * fabricate.VARIANCE))
    image = np.zeros((n, n))
    fabricate.add_stars(image, x, y, flux)
    table = fabricate.measure(fabricate.add_noise(image, 61))
    distance, row = cKDTree(np.column_stack([table["x"], table["y"]])).query(np.column_stack([x, y]))
    found, row = distance < 2.5, row[distance < 2.5]
    error = table["pos_err"][row] / 0.074
    along_x, along_y = (table["x"][row] - x[found]) / error, (table["y"][row] - y[found]) / error
    return snr[found], along_x, along_y, (table["flux_psf"][row] - flux[found]) / table["flux_psf_err"][row]


@pytest.mark.parametrize(("low", "high"), BINS)
def test_positions_scatter_by_their_error(pulls, low, high):
    """300 to 600 stars, two axes: the width is known to 2 to 3 %, the mean to 3 %."""
    snr, along_x, along_y, _ = pulls
    use = (snr > low) & (snr < high)
    both = np.concatenate([along_x[use], along_y[use]])
    assert use.sum() > 250
    assert 0.9 < both.std() < (1.12 if low < 9 else 1.1)  # noise of a fifth is not small any more
    for pull in (along_x[use], along_y[use]):
        assert abs(pull.mean()) < 5.0 / np.sqrt(use.sum())


@pytest.mark.parametrize(("low", "high"), BINS)
def test_fluxes_scatter_by_their_error(pulls, low, high):
    """The width is known to 3 to 4 %; near the threshold the faint ones that noise made fainter are not found."""
    snr, *_, pull = pulls
    use = (snr > low) & (snr < high)
    assert 0.85 < pull[use].std() < 1.15 if low < 20 else 0.9 < pull[use].std() < 1.1
    assert abs(pull[use].mean()) < 5.0 / np.sqrt(use.sum()) + 0.1
