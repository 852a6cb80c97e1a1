"""Covariances of flats: the areas put in are recovered; limits are 5 sigma."""

import bfe_fit
import numpy as np
import pytest
from scipy.signal import correlate2d

from csstsim.base.rng import stream
from csstsim.detector import bfe_kernel
from csstsim.detector.brighter_fatter import move_charge

AREAS = np.array([[-1.6e-6, 0.7e-7, 2e-8], [2.1e-7, 7e-8, 2e-8], [4e-8, 2e-8, 1.6e-8]])
LEVELS = (2000.0, 20_000.0, 60_000.0)
SIDE = 700


def flat(level, number, areas=AREAS):
    image = stream(5, "flat", level, number).poisson(level, (SIDE, SIDE)).astype(np.float32)
    if areas is not None:
        move_charge(image, *bfe_kernel.kernel(areas), 90_000.0)
    return image


@pytest.fixture(scope="module")
def measured():
    return [bfe_fit.measure(flat(level, 1), flat(level, 2), 4) for level in LEVELS]


def test_areas_make_the_kernel_and_the_kernel_the_areas():
    all_areas = bfe_fit.all_areas(AREAS)
    assert np.allclose(all_areas[:3, :3], AREAS, rtol=1e-12, atol=0)
    assert abs(bfe_kernel.unfold(all_areas).sum()) < 1e-15 * abs(AREAS[0, 0]) * 49
    potential, skew = bfe_kernel.kernel(AREAS)
    assert (potential > 0).all() and skew == pytest.approx(0.35e-7)
    assert np.allclose(potential, potential.T, rtol=0.15)  # the potential of a charge is nearly round
    assert np.array_equal(bfe_kernel.fold(bfe_kernel.unfold(AREAS)), AREAS)
    for bad in (np.ones((2, 3)), np.full((3, 3), np.nan)):
        with pytest.raises(ValueError, match=r"\(3, 3\)"):
            bfe_kernel.kernel(bad)


def test_prediction_is_the_closed_form():
    """mu (delta + mu k) correlated with itself, by scipy."""
    mean = 50_000.0
    point = np.zeros((7, 7))
    point[3, 3] = 1
    response = point + mean * bfe_kernel.unfold(bfe_fit.all_areas(AREAS)) / 2
    wanted = mean * correlate2d(response, response)[6:, 6:]
    assert np.allclose(bfe_fit.predict(AREAS, mean), wanted, rtol=0, atol=1e-9 * mean)
    assert abs(bfe_kernel.unfold(bfe_fit.predict(AREAS, mean)).sum() / mean - 1) < 1e-12  # variance only moves


def test_photon_transfer_of_flats(measured):
    """Variance and covariances at lags 0..3 as predicted; the deficit at 60,000 e- is 9% and 40 sigma."""
    for level, (mean, cov, errors) in zip(LEVELS, measured, strict=True):
        assert abs(mean - level) < 5 * np.sqrt(level / 2) / SIDE
        assert (np.abs(cov - bfe_fit.predict(AREAS, level)[:4, :4]) < 5 * errors).all()
    assert cov[0, 0] < LEVELS[-1] - 40 * errors[0, 0]
    assert abs(cov[0, 0] / LEVELS[-1] - 0.907) < 0.01  # 1 + a00 mu, and + 0.003 of second order
    assert cov[1, 0] > 8 * errors[1, 0]


def test_without_the_effect_there_is_neither():
    _, cov, errors = bfe_fit.measure(flat(20_000.0, 1, None), flat(20_000.0, 2, None))
    assert abs(cov[0, 0] - 20_000.0) < 5 * errors[0, 0]
    assert (np.abs(cov) < 5 * errors).sum() == 8


def test_fit_recovers_the_areas(measured):
    means, cov, errors = (np.array(part) for part in zip(*measured, strict=True))
    areas, sigma = bfe_fit.fit(means, cov[:, :3, :3], errors[:, :3, :3])
    assert (np.abs(areas - AREAS) < 5 * sigma).all()
    assert (sigma < 0.05 * np.abs(AREAS[0, 0])).all()
    exact = np.array([bfe_fit.predict(AREAS, mean)[:3, :3] for mean in LEVELS])
    assert np.allclose(bfe_fit.fit(LEVELS, exact, errors[:, :3, :3])[0], AREAS, rtol=1e-6, atol=0)


def test_fixed_patterns_fall_out_of_the_pair():
    ramp = np.linspace(0, 5000, SIDE, dtype=np.float32)
    plain = bfe_fit.measure(flat(2000.0, 1), flat(2000.0, 2))
    tilted = bfe_fit.measure(flat(2000.0, 1) + ramp, flat(2000.0, 2) + ramp)
    assert np.allclose(plain[1], tilted[1], atol=0.1)


def test_flats_that_do_not_fit_are_refused():
    with pytest.raises(ValueError, match="shapes"):
        bfe_fit.measure(np.ones((9, 9)), np.ones((9, 8)))
    with pytest.raises(ValueError, match="shapes"):
        bfe_fit.measure(np.ones((5, 9)), np.ones((5, 9)))
