"""Means of calibration exposures: rays are left out for few exposures as for many; the level is kept."""

from types import SimpleNamespace

import numpy as np
import pytest

from csstsim.base.errors import InputError
from csstsim.base.rng import stream
from csstsim.measure.calibration.masters import (
    BOX,
    FLAT_DEVIATION_MAX,
    FLAT_LEVEL_MIN,
    HOT_SIGMA,
    RAY_SIGMA,
    _average,
    _hot,
    make_masters,
)

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


def exposure(electrons):
    """Stands for calibrate.Calibrated of two channels, left and right."""
    middle = electrons.shape[1] // 2
    blocks = [
        SimpleNamespace(channel=n, image=np.s_[:, part]) for n, part in ((3, np.s_[:middle]), (4, np.s_[middle:]))
    ]
    return SimpleNamespace(
        electrons=electrons.astype(np.float32), read_noise={3: 4.0, 4: 6.0}, readout=SimpleNamespace(blocks=blocks)
    )


def exposures(lamp=20_000.0):
    """Three exposures of each kind, 4 x 2 boxes: a lamp that rises along y, an odd pixel, a hot one, two offsets."""
    shape = 4 * BOX, 2 * BOX
    bias, dark = np.full(shape, 0.5), np.full(shape, 30.0)
    bias[:, BOX:] = -0.25
    dark[9, 5] = 500.0
    light = lamp * (1 + 0.002 * np.arange(shape[0])[:, None]) * np.ones(shape)
    light[100, 20] *= 1.05
    light[101, 30] *= 1 - 1.5 * FLAT_DEVIATION_MAX
    return {kind: [exposure(image)] * 3 for kind, image in (("BIAS", bias), ("DARK", dark), ("FLAT", light))}


def test_masters_of_a_chip_by_hand():
    masters = make_masters(exposures(), 150.0)
    assert masters.offset == {3: 0.5, 4: -0.25} and masters.dark == pytest.approx(30.0 / 150.0, rel=1e-6)
    assert np.argwhere(masters.bad).tolist() == [[9, 5], [101, 30]]
    assert masters.flat[9, 5] == masters.flat[101, 30] == 1.0
    assert masters.flat[100, 20] == pytest.approx(1.05, abs=1e-3)
    inner = masters.flat[BOX // 2 : -BOX // 2]  # between the boxes' middles a slope is subtracted
    assert np.median(inner) == pytest.approx(1.0, abs=1e-3) and np.ptp(np.median(inner, axis=1)) < 2e-3
    with pytest.raises(InputError, match="too faint"):
        make_masters(exposures(0.9 * FLAT_LEVEL_MIN), 150.0)


@pytest.mark.parametrize(("sigmas", "hot"), [(HOT_SIGMA - 0.01, 0), (HOT_SIGMA + 0.01, 1)])
def test_hot_pixels_lie_beyond_the_noise_of_charge_and_readout(sigmas, hot):
    charge = np.full((9, 9), 11.0, np.float32)
    charge[2, 6], charge[3, 3] = 11.0 + sigmas * 6.0, -900.0  # noise of 11 e- and a read noise of 5
    bad, mean = _hot(charge, 5.0)
    assert bad.sum() == hot and bad[2, 6] == hot and not bad[3, 3]
    assert mean == pytest.approx(charge[~bad].mean())


@pytest.mark.parametrize(("sigmas", "kept"), [(RAY_SIGMA - 0.01, True), (RAY_SIGMA + 0.01, False)])
def test_a_value_is_a_ray_beyond_five_sigma_of_the_median(sigmas, kept):
    """Of 75 e- and a read noise of 5: sigma 10; a low value stays."""
    images = [np.full((2, 2), 75.0, np.float32) for _ in range(4)]
    images[1][0, 1] += 10 * sigmas
    images[2][1, 0] = -400.0
    mean = _average(tuple(images), READ_NOISE)
    assert mean[0, 1] == pytest.approx(75 + 10 * sigmas / 4 if kept else 75.0)
    assert mean[1, 0] == pytest.approx((3 * 75 - 400) / 4) and mean[0, 0] == 75.0
