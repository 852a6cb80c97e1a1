"""Correction of charge transfer: stars and their trails are restored up to a stated fraction of the loss."""

import math

import numpy as np
import pytest
from support.readout_state import small_camera

from csstsim.base.rng import Streams
from csstsim.base.shipped import SHIPPED
from csstsim.detector.bfe_kernel import detector_kernel
from csstsim.detector.brighter_fatter import move_back, move_charge
from csstsim.detector.charge_transfer.cti import transfer
from csstsim.detector.charge_transfer.parameters import Columns, TrapKeys, trap_model
from csstsim.detector.charge_transfer.restored import restore, restore_columns
from csstsim.detector.charge_transfer.transfer import transfer as move
from csstsim.instrument.camera import load_camera
from csstsim.instrument.chip import Window

DENSITY, TIMES, WELL = np.array([0.025, 0.105, 0.655]), np.array([1.22, 14.02, 84.74]), (0.492, 85200.0, 0.0)
ROWS = 2000  # px from the amplifier
SKY = 40.0


PLACE = {"lead": ROWS, "n_rows": 4616}


def keys(key=7):
    return TrapKeys(np.uint64(key), np.uint64(key + 1))


def forward(image, own=None, **position):
    """Return what the transfer of rows ROWS and further of a half of 4616 makes of an image."""
    moved = image.copy()
    transfer(moved, trap_model(DENSITY, TIMES, WELL), own or keys(), Columns(**(position or PLACE)))
    return moved


def restored(image, passes, own=None, **position):
    back = image.copy()
    restore_columns(back, trap_model(DENSITY, TIMES, WELL), own or keys(), passes, Columns(**(position or PLACE)))
    return back


def iterated(read, forward, passes):
    """The iteration of the module's docstring, on copies of the whole image."""
    guess = read.copy()
    for _ in range(passes):
        guess += read - forward(guess)
    return guess


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
    moved = forward(true)
    lost = light(true) - light(moved)
    assert lost > 0.01 * electrons
    back = restored(moved, 3)
    chance = 5 * np.sqrt(lost / 800) + 0.05  # electrons that a trap takes or leaves, and rounding of a median
    assert abs(light(back) - light(true)) < 0.03 * lost + chance


def test_other_traps_of_the_same_density_do_nearly_as_well():
    true = stars(1000.0)
    moved = forward(true)
    lost, back = light(true) - light(moved), restored(moved, 3, keys(99))
    assert abs(light(back) - light(true)) < 0.1 * lost


def test_each_pass_is_nearer():
    true = stars(1000.0)
    moved = forward(true)
    off = [np.abs(restored(moved, passes) - true).mean() for passes in (0, 1, 2, 4)]
    assert off[0] > 2 * off[1] > 2 * off[3] and off[2] <= off[1]


@pytest.mark.parametrize("passes", [0, 1, 3])
@pytest.mark.parametrize("position", [{"overscan": 20}, {"flip": True, "x0": 100}, {"lead": 500, "n_rows": 740}])
def test_columns_in_the_cache_are_those_of_whole_images(position, passes):
    """Every bit, over three blocks of columns; rows next to the image have the charge of its median, as it was read."""
    read = forward(stars(3000.0, columns=150), **position)
    passes = min(passes, 1) if "lead" in position else passes
    peer = iterated(read, lambda guess: forward(guess, **position), passes)
    assert np.array_equal(restored(read, passes, **position), peer)


@pytest.mark.parametrize("serial", [False, True])
@pytest.mark.parametrize("window", [Window(0, 256, 0, 64), Window(13, 99, 20, 60), Window(50, 51, 3, 4)])
def test_a_window_of_two_halves_is_restored(tmp_path, serial, window):
    """As the iteration over the simulator's whole transfer, columns and registers together; a few electrons apart."""
    detector, rng = small_camera(tmp_path).detector, Streams(3, "1", 9, "measure")
    ask = {"density": 60.0, "serial": serial}

    def moved(image):
        out = image.copy()
        move(out, detector, window, rng, **ask)
        return out

    true = np.random.default_rng(2).poisson(SKY, window.shape).astype(np.float32)
    true[::7, ::5] += 2000.0
    read = moved(true)
    back = read.copy()
    restore(back, detector, window, rng, passes=4, **ask)
    peer = iterated(read, moved, 4)
    if window.ny == detector.ny and not serial:  # else the median next to the window is that of each guess
        assert np.array_equal(back, peer)
    assert np.abs(back - true).sum() <= 0.3 * np.abs(read - true).sum()
    assert abs((back - peer).mean()) <= 0.02 * np.abs(read - true).mean()


def test_charge_below_zero_full_wells_and_empty_images_are_taken():
    noisy = np.random.default_rng(1).normal(0, 5, (50, 20)).astype(np.float32)
    assert np.isfinite(restored(noisy, 3)).all()
    for full in (np.full((50, 3), 90_000.0, np.float32), np.full((1, 3), 90_000.0, np.float32)):
        assert abs(restored(full, 3) - full).max() < 0.02 * full.max()
    assert restored(np.zeros((0, 20), np.float32), 3).shape == (0, 20)
    noisy[3, 3] = np.nan
    with pytest.raises(ValueError, match="1 pixel"):
        restored(noisy, 3)


@pytest.fixture(scope="module")
def how():
    detector = load_camera(SHIPPED / "instrument").detector
    return *detector_kernel(detector), detector.full_well


def pushed(image, how):
    """The charge of an image moved forward; what read noise made negative is no charge."""
    out = np.maximum(image, np.float32(0))
    move_charge(out, *how)
    return out + np.minimum(image, np.float32(0))


def test_charge_that_charge_pushed_comes_back(how):
    """A star's brightest pixels, 26,000 e-, lose 1% and more; after two passes what is missing is below 1% of that."""
    y, x = np.mgrid[:60, :60] - 30.2
    true = (1e5 / math.tau / 0.6 * np.exp(-0.5 * (x**2 + y**2) / 0.6) + SKY).astype(np.float32)
    back = pushed(true, how)
    lost = (true - back).max()
    assert lost > 0.01 * true.max()
    move_back(back, *how)
    assert np.abs(back - true).max() < 0.01 * lost
    assert back.sum(dtype=float) == pytest.approx(true.sum(dtype=float), rel=1e-6)


@pytest.mark.parametrize("shape", [(0, 5), (1, 9), (9, 1), (63, 20), (64, 20), (67, 20), (200, 30)])
@pytest.mark.parametrize("level", [SKY, 90_000.0])
def test_bands_of_rows_are_moved_back_as_whole_images(how, shape, level):
    """To the rounding of float32, with negative pixels, across the bands' borders, and where all are full."""
    read = np.random.default_rng(4).normal(level, 30.0, shape).astype(np.float32)
    read[::5, ::4] += 30_000.0
    back = read.copy()
    move_back(back, *how)
    peer = iterated(read, lambda image: pushed(image, how), 2)
    assert np.abs(back - peer).max(initial=0) <= 2 * np.spacing(np.float32(2e5))


def test_what_is_no_number_is_not_moved_back(how):
    image = np.full((70, 9), SKY, np.float32)
    image[68, 2] = np.nan
    with pytest.raises(ValueError, match="not finite"):
        move_back(image, *how)
