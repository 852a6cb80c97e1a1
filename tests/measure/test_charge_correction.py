"""Correction of charge transfer: stars and their trails are restored up to a stated share of the loss."""

import math

import numpy as np
import pytest

from csstsim.base.shipped import SHIPPED
from csstsim.detector.bfe_kernel import detector_kernel
from csstsim.detector.brighter_fatter import move_charge
from csstsim.detector.charge_transfer.cti import transfer
from csstsim.instrument.camera import load_camera
from csstsim.measure.charge_correction import corrected

DENSITY, TIMES, WELL = np.array([0.025, 0.105, 0.655]), np.array([1.22, 14.02, 84.74]), (0.492, 85200.0, 0.0)
ROWS = 2000  # px from the amplifier
SKY = 40.0


def forward(key=7):
    """Return the transfer of rows ROWS and further of a half of 4616."""

    def move(image):
        transfer(image, DENSITY, TIMES, WELL, (np.uint64(key), np.uint64(key + 1)), lead=ROWS, n_rows=4616)

    return move


def stars(electrons, columns=200):
    """Return (image of blobs of 3 x 3 px, one a column and 60 rows, sum of one)."""
    image = np.full((240, columns), SKY, np.float32)
    for row in range(30, 240, 60):
        image[row - 1 : row + 2] += np.float32(electrons / 3)
    return np.random.default_rng(5).poisson(image).astype(np.float32)


def light(image):
    """Return the light of the blobs above the sky, all columns' mean."""
    above = image - np.median(image)
    return np.mean([above[row - 2 : row + 3].sum(axis=0).mean() for row in range(30, 240, 60)])


@pytest.mark.parametrize("electrons", [100.0, 1000.0, 20000.0])
def test_light_lost_on_the_way_comes_back(electrons):
    """At most 3% of the loss is left after three passes; chance (5 sigma of 800 blobs) is 5 sqrt(N / 800)."""
    true = stars(electrons)
    moved = true.copy()
    forward()(moved)
    lost = light(true) - light(moved)
    assert lost > 0.01 * electrons
    back = corrected(moved, forward(), 3)
    chance = 5 * np.sqrt(lost / 800) + 0.05  # electrons that a trap takes or leaves, and rounding of a median
    assert abs(light(back) - light(true)) < 0.03 * lost + chance


def test_other_traps_of_the_same_density_do_nearly_as_well():
    true = stars(1000.0)
    moved = true.copy()
    forward()(moved)
    lost, back = light(true) - light(moved), corrected(moved, forward(key=99), 3)
    assert abs(light(back) - light(true)) < 0.1 * lost


def test_each_pass_is_nearer():
    true = stars(1000.0)
    moved = true.copy()
    forward()(moved)
    off = [np.abs(corrected(moved, forward(), passes) - true).mean() for passes in (0, 1, 2, 4)]
    assert off[0] > 2 * off[1] > 2 * off[3] and off[2] <= off[1]


def test_no_pass_changes_nothing_and_the_input_stays():
    image = stars(500.0)
    given = image.copy()
    assert np.array_equal(corrected(image, forward(), 0), given)
    corrected(image, forward(), 2)
    assert np.array_equal(image, given)


def test_charge_below_zero_and_an_empty_image_are_taken():
    noisy = np.random.default_rng(1).normal(0, 5, (50, 20)).astype(np.float32)
    assert np.isfinite(corrected(noisy, forward(), 3)).all()
    assert corrected(np.zeros((0, 20), np.float32), forward(), 3).shape == (0, 20)


def test_charge_that_charge_pushed_comes_back():
    """A star's brightest pixels, 26,000 e-, lose 1% and more; after two passes what is missing is below 1% of that."""
    detector = load_camera(SHIPPED / "instrument").detector
    y, x = np.mgrid[:60, :60] - 30.2
    true = (1e5 / math.tau / 0.6 * np.exp(-0.5 * (x**2 + y**2) / 0.6) + SKY).astype(np.float32)
    moved = true.copy()
    how = *detector_kernel(detector), detector.full_well
    move_charge(moved, *how)
    lost = (true - moved).max()
    assert lost > 0.01 * true.max()
    back = corrected(moved, lambda image: move_charge(image, *how), 2)
    assert np.abs(back - true).max() < 0.01 * lost
    assert back.sum(dtype=float) == pytest.approx(true.sum(dtype=float), rel=1e-6)
