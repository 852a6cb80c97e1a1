"""Spilled charge against pixel-by-pixel toppling, closed forms, symmetry and its limits.

The ends of runs are rounded to float32, 0.004 e- below 90,000 e-; TOLERANCE is ten times that.
"""

import numpy as np
import pytest

from csstsim.base.rng import stream
from csstsim.detector.blooming import bloom
from csstsim.detector.mask import BLED, COSMIC_RAY, SATURATED

FULL_WELL = 90_000.0
TOLERANCE = 0.04  # e-


def spilled(image, row_fraction=0.0, mask=None):
    """Return (image after, saturated, lost)."""
    image = np.array(image, np.float32, order="C")
    return image, *bloom(image, FULL_WELL, row_fraction, mask)


def toppled(line):
    """Return (line after, lost): every pixel above the full well gives half of the rest to each side, to the end."""
    line, lost = line.astype(float), 0.0
    while (excess := np.maximum(line - FULL_WELL, 0.0)).max() > 1e-4:
        line -= excess
        line[:-1] += excess[1:] / 2
        line[1:] += excess[:-1] / 2
        lost += (excess[0] + excess[-1]) / 2
    return line, lost


def lines(seed, length=40, number=12):
    """Columns of sky, half-filled pixels and cores; some end at the border."""
    rng = stream(seed, "lines")
    image = rng.uniform(0, FULL_WELL, (length, number)) * (rng.random((length, number)) < 0.7)
    cores = rng.random((length, number)) < np.linspace(0.02, 0.3, number)
    return np.where(cores, rng.uniform(1, 4, (length, number)) * FULL_WELL, image).astype(np.float32)


@pytest.mark.parametrize("seed", range(4))
def test_columns_and_rows_are_toppled_to_the_end(seed):
    image = lines(seed)
    after, number, lost = spilled(image)
    assert number == (image > FULL_WELL).sum()
    wanted = [toppled(column) for column in image.T]
    assert np.abs(after.T - [line for line, _ in wanted]).max() < TOLERANCE
    assert abs(lost - sum(left for _, left in wanted)) < TOLERANCE
    sideways, _, lost_sideways = spilled(image.T, row_fraction=1.0)
    assert np.abs(sideways.T - after).max() < TOLERANCE and abs(lost_sideways - lost) < TOLERANCE


@pytest.mark.parametrize("row_fraction", [0.0, 0.01, 0.6])
def test_mirrored_images_give_mirrored_trails(row_fraction):
    image = lines(7, 60, 50)
    mask, flipped_mask = (np.zeros(image.shape, np.uint8) for _ in range(2))
    after, number, lost = spilled(image, row_fraction, mask)
    for flip in (np.flipud, np.fliplr):
        flipped_mask[...] = 0
        flipped, same_number, same_lost = spilled(flip(image), row_fraction, flipped_mask)
        assert np.abs(flip(flipped) - after).max() < TOLERANCE
        assert same_number == number and abs(same_lost - lost) < TOLERANCE
        assert np.array_equal(flip(flipped_mask), mask)


@pytest.mark.parametrize("row_fraction", [0.0, 0.01, 1.0])
def test_charge_is_kept_or_counted_as_lost(row_fraction):
    rng = stream(3, "field")
    image = rng.poisson(40.0, (300, 200)).astype(np.float32)
    image[rng.random(image.shape) < 0.01] = 1e6
    image[120:130, 80:90] = 4e6
    after, _, lost = spilled(image, row_fraction)
    assert after.max() <= FULL_WELL
    assert abs(after.sum(dtype=float) + lost - image.sum(dtype=float)) < TOLERANCE * np.sqrt(image.size)
    assert lost > 0


def test_a_lone_core_fills_the_same_both_ways():
    """Excess E in wells with room r: whole pixels filled = E / 2 / r on either side, the rest in the next."""
    image = np.full((101, 3), 40.0)
    room = FULL_WELL - 40.0
    image[50, 1] = FULL_WELL + 2 * 7.25 * room
    mask = np.full(image.shape, COSMIC_RAY, np.uint8)
    after, number, lost = spilled(image, mask=mask)
    assert (number, lost) == (1, 0.0)
    wanted = image.copy()
    wanted[43:58, 1] = FULL_WELL
    wanted[42, 1] = wanted[58, 1] = 40.0 + 0.25 * room
    assert np.abs(after - wanted).max() < TOLERANCE
    bits = np.full(image.shape, COSMIC_RAY)
    bits[42:59, 1] |= BLED
    bits[50, 1] = COSMIC_RAY | SATURATED
    assert np.array_equal(mask, bits)


def test_a_fraction_goes_along_the_row():
    """Half of the share to either side, where there is room; the rest along the column."""
    image = np.zeros((41, 9))
    image[20, 4] = FULL_WELL + 100_000.0
    after, _, lost = spilled(image, row_fraction=0.1)
    assert lost == 0
    assert np.abs(after[20, 3:6] - [5000.0, FULL_WELL, 5000.0]).max() < TOLERANCE
    assert np.abs(after[[19, 21], 4] - 45_000.0).max() < TOLERANCE
    wide = np.zeros((41, 9))
    wide[20, 3:6] = FULL_WELL + 1e6
    after, _, _ = spilled(wide, row_fraction=0.01)
    assert np.abs(after[20, [2, 6]] - 15_000.0).max() < TOLERANCE  # the core's columns are full: past them


def test_charge_leaves_at_the_borders_and_crosses_the_middle():
    image = np.zeros((20, 2))
    image[0, 0] = image[19, 1] = FULL_WELL + 30_000.0
    after, _, lost = spilled(image)
    assert lost == 30_000.0  # half of each
    assert after[1, 0] == after[18, 1] == 15_000.0
    image = np.zeros((20, 1))
    image[8] = 7 * FULL_WELL  # rows 5 to 11 and none beyond: across the boundary of two halves of ten
    assert (spilled(image)[0][5:12] == FULL_WELL).all()


def test_ten_thousand_saturated_pixels_in_one_column():
    """All, and every other one, of 10,000 in a column of 40,000: the closed form of one core holds around them."""
    for step in (1, 2):
        image = np.zeros((40_001, 1))
        core = slice(20_000 - 5000 * step, 20_000 + 5000 * step + 1, step)
        image[core] = 2 * FULL_WELL if step == 1 else 3 * FULL_WELL
        total = image.sum()
        after, number, lost = spilled(image)
        assert number == 10_001 and lost == 0
        filled = np.flatnonzero(after[:, 0] == FULL_WELL)
        assert np.abs(after - after[::-1]).max() < TOLERANCE
        assert len(filled) == filled[-1] - filled[0] + 1 == total // FULL_WELL - (total // FULL_WELL % 2 == 0)
        assert abs(after.sum(dtype=float) - total) < TOLERANCE


@pytest.mark.parametrize("shape", [(1, 1), (1, 7), (7, 1), (30, 40)])
@pytest.mark.parametrize("row_fraction", [0.0, 0.3])
def test_an_all_saturated_image_keeps_a_full_well_each(shape, row_fraction):
    mask = np.zeros(shape, np.uint8)
    after, number, lost = spilled(np.full(shape, 3 * FULL_WELL), row_fraction, mask)
    assert (after == FULL_WELL).all() and (mask == SATURATED).all()
    assert number == after.size
    assert abs(lost / (2 * FULL_WELL * after.size) - 1) < 1e-12


def test_nothing_above_the_full_well_changes_nothing():
    for image in (np.zeros((5, 6)), np.full((5, 6), FULL_WELL), np.full((5, 6), -7.0), np.zeros((0, 4))):
        mask = np.zeros(image.shape, np.uint8)
        after, number, lost = spilled(image, 0.1, mask)
        assert np.array_equal(after, image.astype(np.float32)) and not mask.any()
        assert (number, lost) == (0, 0.0)


def test_a_negative_pixel_has_more_room():
    image = np.array([[0.0], [-1000.0], [FULL_WELL + 4000.0], [0.0]])
    assert spilled(image)[0][:, 0].tolist() == [0.0, 1000.0, FULL_WELL, 2000.0]


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_impossible_charge_is_counted_and_refused(bad):
    image = np.full((9, 9), 1e5, np.float32)
    image[3, 4] = image[8, 8] = bad
    before = image.copy()
    with pytest.raises(ValueError, match=r"2 pixel\(s\) is not finite"):
        bloom(image, FULL_WELL)
    assert np.array_equal(image, before, equal_nan=True)


def test_impossible_numbers_are_refused():
    for full_well, share in ((0.0, 0.0), (np.nan, 0.0), (1.0, -0.1), (1.0, 1.1), (1.0, np.nan)):
        with pytest.raises(ValueError, match="full well"):
            bloom(np.ones((2, 2), np.float32), full_well, share)


def test_what_spills_along_a_row_is_marked_there():
    """Two saturated pixels of unequal excess at the left edge: half of each share leaves, or goes to the right."""
    image, mask = np.zeros((7, 6)), np.zeros((7, 6), np.uint8)
    image[3, 0], image[3, 4] = FULL_WELL + 8000.0, FULL_WELL + 4000.0
    after, number, lost = spilled(image, 0.25, mask)
    assert (number, lost) == (2, 1000.0)
    assert after[3].tolist() == [FULL_WELL, 1000.0, 0.0, 500.0, FULL_WELL, 500.0]
    assert after[2].tolist() == after[4].tolist() == [3000.0, 0.0, 0.0, 0.0, 1500.0, 0.0]
    wanted = np.zeros((7, 6), np.uint8)
    wanted[3] = [SATURATED, BLED, 0, BLED, SATURATED, BLED]
    wanted[2:5:2, [0, 4]] = BLED
    assert np.array_equal(mask, wanted)


def test_an_image_is_scanned_to_its_last_pixel():
    for place in ((0, 0), (0, 8), (6, 0), (6, 8)):
        image = np.zeros((7, 9))
        image[place] = FULL_WELL + 2.0
        after, number, lost = spilled(image)
        assert (number, lost) == (1, 1.0) and after.sum() == FULL_WELL + 1.0


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("saturated", [False, True])
@pytest.mark.parametrize("place", [(0, 0), (4, 2), (6, 8)])
def test_impossible_charge_is_refused_wherever_it_is(bad, saturated, place):
    """In an image without saturated pixels, too, and in another row than theirs."""
    image = np.full((7, 9), 40.0, np.float32)
    if saturated:
        image[3] = 2 * FULL_WELL
    image[place] = bad
    before = image.copy()
    with pytest.raises(ValueError, match=r"of 1 pixel\(s\) is not finite"):
        bloom(image, FULL_WELL)
    assert np.array_equal(image, before, equal_nan=True)
