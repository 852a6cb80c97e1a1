"""Moved charge against a plain numpy version of the same equations, closed forms, symmetry and its limits."""

import bfe_fit
import numpy as np
import pytest
from scipy.ndimage import convolve

from csstsim.base.rng import stream
from csstsim.detector import bfe_kernel
from csstsim.detector.brighter_fatter import move_back, move_charge

AREAS = np.array([[-1.6e-6, 0.7e-7, 2e-8], [2.1e-7, 7e-8, 2e-8], [4e-8, 2e-8, 1.6e-8]])
KERNEL, SKEW = bfe_kernel.kernel(AREAS)
FULL_WELL = 90_000.0
ULP = 0.008  # e-: float32 at full well


def moved(image, kernel=KERNEL, skew=SKEW):
    image = np.array(image, np.float32, order="C")
    move_charge(image, kernel, skew, FULL_WELL)
    return image


def scene(shape=(50, 70), seed=1):
    """Sky, a flat half, and stars of up to ten times the full well."""
    rng = stream(seed, "scene")
    image = rng.poisson(40.0, shape).astype(np.float32)
    image[:, shape[1] // 2 :] += rng.poisson(60_000.0, (shape[0], shape[1] - shape[1] // 2))
    image[rng.random(shape) < 0.02] += np.float32(10 * FULL_WELL) * rng.random()
    return image


def plain(image):
    """The module's equations in double precision on whole arrays."""
    push = np.minimum(image.astype(float), FULL_WELL)
    phi = convolve(push, bfe_kernel.unfold(KERNEL), mode="nearest")
    out = image.astype(float)
    for axis in (0, 1):
        n = image.shape[axis]
        padded = np.pad(image.astype(float), [(1, 1) if a == axis else (0, 0) for a in (0, 1)], mode="edge")
        before, p, q, after = (np.take(padded, range(i, i + n - 1), axis) for i in range(4))
        shift = -np.diff(phi + (SKEW, -SKEW)[axis] * push, axis=axis)
        density = np.where(shift > 0, 5 * p + 2 * q - before, 5 * q + 2 * p - after) / 6
        flux = np.clip(shift * np.clip(density, np.minimum(p, q), np.maximum(p, q)), -q / 8, p / 8)
        out -= np.diff(np.insert(np.insert(flux, 0, 0, axis), n, 0, axis), axis=axis)
    return out


@pytest.mark.parametrize("shape", [(50, 70), (1, 1), (1, 9), (9, 1), (2, 2), (3, 4), (5, 3)])
def test_against_plain_numpy(shape):
    image = scene(shape)
    assert np.abs(moved(image) - plain(image)).max() < 16 * ULP * max(1, image.max() / FULL_WELL)


def test_charge_is_conserved_and_never_negative():
    image = scene((200, 200))
    after = moved(image)
    assert after.min() >= 0
    assert not np.array_equal(after, image)
    rounding = 2.0 * np.spacing(image.max()) * np.sqrt(image.size)
    assert abs(after.sum(dtype=float) - image.sum(dtype=float)) < 5 * rounding


def test_mirrored_images_give_mirrored_bits():
    image = scene()
    after = moved(image)
    for flip in (np.flipud, np.fliplr):
        assert np.array_equal(flip(moved(flip(image))), after)
    assert np.array_equal(np.rot90(moved(np.rot90(image, 2)), 2), after)
    turned = moved(image.T, KERNEL.T, -SKEW).T
    assert np.abs(turned - after).max() < 16 * ULP * image.max() / FULL_WELL


def test_one_charge_gives_to_its_four_neighbours():
    """A lone charge Q gives (K00 - K01 +- skew) 5/6 Q^2 through each boundary, and nothing further out."""
    charge = 50_000.0
    image = np.zeros((9, 9))
    image[4, 4] = charge
    after = moved(image)
    up = (KERNEL[0, 0] - KERNEL[1, 0] + SKEW) * charge**2 * 5 / 6
    right = (KERNEL[0, 0] - KERNEL[0, 1] - SKEW) * charge**2 * 5 / 6
    wanted = image.copy()
    wanted[3:6:2, 4], wanted[4, 3:6:2] = up, right
    wanted[4, 4] -= 2 * (up + right)
    assert np.abs(after - wanted).max() < ULP
    assert up > 100 and right > 100


def test_a_charge_in_a_flat_changes_the_areas_around_it():
    """Linear in the charge q on a flat of mu: changes are mu q a / 2, ring included, to terms of q^2."""
    mu, q = 40_000.0, 1000.0
    image = np.full((21, 21), mu)
    image[10, 10] += q
    change = moved(image) - image
    wanted = np.zeros_like(image)
    wanted[7:14, 7:14] = mu * q * bfe_kernel.unfold(bfe_fit.all_areas(AREAS)) / 2
    assert np.abs(change - wanted).max() < q**2 * np.abs(AREAS).max() + ULP
    assert np.abs(wanted).max() > 10 * q**2 * np.abs(AREAS).max()


@pytest.mark.parametrize("low", [0.0, 40.0, 60_000.0])
@pytest.mark.parametrize("strength", [0.5, 1.0, 2.5])
@pytest.mark.parametrize("axis", [0, 1])
def test_a_step_at_full_well_neither_rings_nor_turns_negative(low, axis, strength):
    image = np.full((30, 30), low)
    image[:, 15:] = FULL_WELL
    image = image if axis else image.T
    after = moved(image, strength * KERNEL, strength * SKEW)
    across = after[7] if axis else after[:, 7]
    assert (np.diff(across) >= 0).all()
    assert after.min() >= low and after.max() <= FULL_WELL
    assert np.abs(across[:12] - low).max() < ULP and np.abs(across[-12:] - FULL_WELL).max() < ULP
    assert across[14] - low > 0.005 * strength * (FULL_WELL - low)  # the edge does soften
    again = np.array(image, np.float32, order="C")
    for _ in range(50):
        move_charge(again, strength * KERNEL, strength * SKEW, FULL_WELL)
    assert again.min() >= 0 and again.max() <= FULL_WELL
    assert (np.diff(again[7] if axis else again[:, 7]) >= 0).all()


def test_charge_far_above_full_well_pushes_as_a_full_well():
    """A core of 1e9 e-: boundaries inside it do not move, its outer ones by less than 4% of a pixel."""
    image = np.zeros((31, 31), np.float32)
    image[10:21, 10:21] = 1e9
    after = moved(image)
    assert after.min() >= 0
    assert np.abs(after[13:18, 13:18] - 1e9).max() < 256
    given = after[15, 9] / 1e9
    assert 0.001 < given < 0.04
    assert abs(after.sum(dtype=float) / image.sum(dtype=float) - 1) < 1e-7


def test_no_pixel_gives_more_than_it_has():
    """A kernel a hundred times too strong: the limiter acts, charge stays and no pixel is negative."""
    image = scene((100, 100), 3)
    after = moved(image, 100 * KERNEL, 100 * SKEW)
    assert after.min() >= 0
    assert abs(after.sum(dtype=float) / image.sum(dtype=float) - 1) < 1e-6


def test_a_flat_stays_flat_to_its_border():
    for level in (0.0, 40.0, FULL_WELL, 1e6):
        assert (moved(np.full((8, 9), level)) == np.float32(level)).all()
    assert moved(np.zeros((0, 5))).size == 0


def test_a_window_sees_the_whole_chip_three_pixels_inside():
    whole = scene((60, 60))
    part = moved(whole[10:40, 20:50])
    assert np.array_equal(part[3:-3, 3:-3], moved(whole)[13:37, 23:47])


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf, -1.0])
@pytest.mark.parametrize("position", [(0, 0), (7, 3), (11, 8)])
def test_impossible_charge_is_counted_and_refused(bad, position):
    image = np.ones((12, 9), np.float32)
    image[position] = image[5, 5] = bad
    with pytest.raises(ValueError, match=r"2 pixel\(s\) is negative or not finite"):
        move_charge(image, KERNEL, SKEW, FULL_WELL)


def test_impossible_kernels_are_refused():
    image = np.ones((4, 4), np.float32)
    nan, wrong = np.nan, (np.ones((2, 2)), np.full((3, 3), np.nan))
    for numbers in (*((kernel, 0, 1) for kernel in wrong), (KERNEL, nan, 1), (KERNEL, 0, 0), (KERNEL, 0, nan)):
        with pytest.raises(ValueError, match="limit"):
            move_charge(image, *numbers)
    assert (image == 1).all()


def test_charge_is_moved_back():
    """More rows than are moved at once, no two alike: what is left is a tenth of a per cent of what moved."""
    y, x = np.mgrid[:300, :40]
    image = (20_000 + 15_000 * np.sin(0.7 * x + 0.3 * y) * np.cos(0.11 * x * y)).astype(np.float32)
    back = moved(image)
    shifted = np.abs(back - image).max()
    move_back(back, KERNEL, SKEW, FULL_WELL)
    assert shifted > 100 and np.abs(back - image).max() < 0.02 * shifted


def test_negative_charge_stays_where_it_is_when_moved_back():
    image = np.full((9, 9), -4.0, np.float32)
    move_back(image, KERNEL, SKEW, FULL_WELL)
    assert (image == -4).all()
    image[2, 3] = np.nan
    with pytest.raises(ValueError, match=r"pixel\(s\) is negative or not finite"):
        move_back(image, KERNEL, SKEW, FULL_WELL)
    with pytest.raises(ValueError, match="need finite"):
        move_back(image, KERNEL[:2], SKEW, FULL_WELL)
