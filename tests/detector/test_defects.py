"""Defects: numbers, positions and values against the paper's distributions."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from csstsim.base.rng import stream
from csstsim.detector import defects
from csstsim.instrument.chip import Window

CHIP = (9232, 9216)


@pytest.fixture(scope="module")
def numbers(camera):
    return camera.detector.defects


def test_positions_of_defective_pixels(numbers):
    """5e-5 of a chip, half hot, none twice, none both; uniform in both directions (KS, p > 1e-4)."""
    hot, dead = defects.defective_pixels(CHIP, numbers, stream(1, "places"))
    every = np.concatenate([hot, dead])
    assert len(every) == len(set(every)) == round(5e-5 * CHIP[0] * CHIP[1])
    assert abs(len(hot) - len(dead)) <= 1
    for index in (hot, dead):
        assert stats.kstest(index // CHIP[1], "uniform", (0, CHIP[0])).pvalue > 1e-4
        assert stats.kstest(index % CHIP[1], "uniform", (0, CHIP[1])).pvalue > 1e-4


def test_hot_pixels_are_gamma_and_go_with_time(numbers):
    """Gamma(2, 3750 e-) in 150 s (KS, p > 1e-4), the same pixels' rates in other times; Poisson about them, 5 sigma."""
    n = 20_000
    charge, longer = (
        defects.hot_charge(n, seconds, numbers, stream(2, "rates"), stream(2, "shot", seconds))
        for seconds in (150.0, 1500.0)
    )
    assert stats.kstest(charge, "gamma", (2, 0, 3750)).pvalue > 1e-4
    z = (charge - longer / 10) / np.sqrt(longer / 10 * 1.1)
    assert abs(z.mean()) < 5 / np.sqrt(n) and abs(z.var() - 1) < 5 * np.sqrt(2.2 / n)
    assert not defects.hot_charge(n, 0.0, numbers, stream(2, "rates"), stream(2, "bias")).any()
    cool = replace(numbers, hot_scale=1e-3)
    charge = defects.hot_charge(n, 150.0, cool, stream(2, "rates"), stream(2, "cool"))
    assert abs(charge.mean() - 15) < 5 * np.sqrt(15 / n)  # 0.1 e-/s


def test_dead_pixels(numbers):
    """Uniform in 0 to 70% of the background plus N(0, 5 e-): KS against the sum of the two, p > 1e-4; never below 0."""
    n, level, sigma = 20_000, 1000.0, 5.0
    charge = defects.dead_charge(n, level, numbers, stream(3, "u"), stream(3, "noise"))
    sure = charge[charge > 0]

    def share(x):
        part = [z * stats.norm.cdf(z / sigma) + sigma * stats.norm.pdf(z / sigma) for z in (x, x - 0.7 * level)]
        return (part[0] - part[1]) / (0.7 * level)

    below = share(np.zeros(1))
    assert abs((charge == 0).mean() - below) < 5 * np.sqrt(below / n)
    assert stats.kstest(sure, lambda x: (share(x) - below) / (1 - below)).pvalue > 1e-4
    again = defects.dead_charge(n, level, numbers, stream(3, "u"), stream(3, "other noise"))
    middle = (charge > 20) & (again > 20)
    assert np.std(again[middle] - charge[middle]) == pytest.approx(5 * np.sqrt(2), rel=0.03)  # the share stays


def test_columns(numbers):
    """500 chips: 1 to 5 per half, each as often (chi-square); 5-95% of columns, 10-70% of rows, from the seam."""
    counts, places, lengths, levels = [], [], [], []
    for seed in range(500):
        found = defects.bad_columns(4616, 9216, numbers, stream(4, "columns", seed))
        for half in range(2):
            mine = [entry for entry in found if (entry[1] >= 4616) == (half == 1)]
            counts.append(len(mine))
            assert len({entry[0] for entry in mine}) == len(mine)
            assert {entry[2 - half] for entry in mine} == {4616}  # lower half: the end, upper half: the first row
        places += [entry[0] for entry in found]
        lengths += [entry[2] - entry[1] for entry in found]
        levels += [entry[3] for entry in found]
    assert stats.chisquare(np.bincount(counts, minlength=6)[1:]).pvalue > 1e-4 and max(counts) == 5
    assert stats.kstest(places, "uniform", (460, 8755 - 460)).pvalue > 1e-4
    assert stats.kstest(lengths, "uniform", (0.1 * 4616, 0.6 * 4616)).pvalue > 1e-4
    assert stats.kstest(levels, "uniform").pvalue > 1e-4


@pytest.mark.parametrize("level", [0.0, 40.0, 2e4])
def test_column_charge(numbers, level):
    """From 1.3 mean + 50 to 2 mean + 150 e-; with the read noise to come, twice the background's noise; 5 sigma."""
    n, noise = 200_000, 2 * np.sqrt(level + 25)
    for u, mean in ((0.0, 1.3 * level + 50), (1.0, 2 * level + 150), (0.5, 1.65 * level + 100)):
        charge = defects.column_charge(n, u, level, 5.0, numbers, stream(5, "column", u))
        assert abs(charge.mean() - mean) < 5 * noise / np.sqrt(n)
        assert abs((charge.var() + 25) / noise**2 - 1) < 5 * np.sqrt(2 / n)


def test_background():
    """A flat's mean to 5 sigma, unmoved by 1% of bright pixels; 0 for what is below it; NaN refused with a count."""
    image = stream(6, "sky").poisson(40.0, (1000, 1500)).astype(np.float32)
    plain = defects.background(image)
    assert abs(plain - 40) < 5 * np.sqrt(40 / 1e6)
    image.reshape(-1)[stream(6, "stars").integers(0, image.size, image.size // 100)] = 5e4
    assert abs(defects.background(image) - plain) < 0.1 * np.sqrt(40) * 0.1
    assert defects.background(np.full((1, 1), 7.0, np.float32)) == 7.0
    assert defects.background(np.full((9, 9), -7.0, np.float32)) == 0.0
    assert defects.background(np.full((9, 9), 9e4, np.float32)) == 9e4
    image[3, 4:7] = np.nan, np.inf, -np.inf
    with pytest.raises(ValueError, match=r"3 pixel\(s\)"):
        defects.background(image)


@pytest.mark.parametrize(("sigmas", "counts"), [(4.5, True), (5.6, False), (-4.5, True), (-5.6, False)])
def test_the_background_is_clipped_at_five_robust_sigma(sigmas, counts):
    """Normal charges, and 1% of pixels at so many sigma: they are in the mean, or not."""
    image = 1000.0 + 20.0 * stream(7, "clip").standard_normal((500, 500))
    image.reshape(-1)[::100] = 1000.0 + 20.0 * sigmas
    added = 0.01 * 20.0 * sigmas if counts else 0.0
    assert defects.background(image) == pytest.approx(1000.0 + added, abs=5 * 20.0 / 500)


def test_inside_a_window():
    which, y, x = defects.in_window(np.array([0, 12, 25, 99]), 10, Window(2, 6, 1, 3))
    assert which.tolist() == [False, True, True, False] and y.tolist() == [0, 1] and x.tolist() == [0, 3]


@pytest.mark.parametrize("mean", [0.3, 0.7, 2.6, 40.0])
def test_the_background_is_a_mean_not_a_digit(mean):
    """Few whole electrons a pixel, objects and rays in 1%: 5 sigma of a million pixels, and what they add."""
    rng = stream(9, "background", mean)
    image = rng.poisson(mean, (1000, 1000)).astype(np.float32)
    image[rng.random(image.shape) < 0.01] += 5000.0
    assert defects.background(image) == pytest.approx(mean, abs=5 * np.sqrt(mean / 1e6) + 0.002)


def test_a_quarter_of_defective_pixels_may_be_hot(numbers):
    few = replace(numbers, defective=0.02, hot_share=0.25)
    hot, dead = defects.defective_pixels((50, 80), few, stream(8, "quarter"))
    assert (len(hot), len(dead)) == (20, 60) and max(hot.max(), dead.max()) < 4000


def test_the_background_of_stripes_is_that_of_both():
    """Two million pixels, of which one in some is looked at, in columns of 18 and 22 e- by turns."""
    image = np.tile(np.float32([18.0, 22.0]), (1000, 1000))
    assert defects.background(image) == pytest.approx(20.0, abs=0.01)
    assert defects.background(image.T.copy()) == pytest.approx(20.0, abs=0.01)


def test_a_sum_that_is_known_is_not_made_again():
    image = np.full((4, 5), 3.0, np.float32)
    assert defects.background(image, 60.0) == 3.0
    with pytest.raises(ValueError, match="not finite"):
        defects.background(image, np.inf)


def test_columns_of_a_chip_that_is_narrow(numbers):
    """Where the range of columns is empty there is one, once in each half; of more columns than there are, all."""
    one = replace(numbers, columns_from=0.5, columns_to=0.5, columns_min=3, columns_max=3)
    found = defects.bad_columns(32, 10, one, stream(4, "narrow"))
    assert [entry[0] for entry in found] == [5, 5]
    some = replace(one, columns_to=0.75, length_min=0.5, length_max=0.5)
    found = defects.bad_columns(32, 16, some, stream(4, "some"))
    assert all(8 <= entry[0] < 12 for entry in found) and len(found) == 6
    assert [entry[1:3] for entry in found] == [(16, 32)] * 3 + [(32, 48)] * 3


def test_the_noise_of_a_dark_column_is_cut_at_zero(numbers):
    dark = replace(numbers, low_factor=0.0, low_offset=0.0)
    charge = defects.column_charge(4000, 0.0, 100.0, 5.0, dark, stream(5, "dark"))
    assert charge.min() == 0 and abs((charge == 0).mean() - 0.5) < 5 * np.sqrt(0.25 / 4000)
