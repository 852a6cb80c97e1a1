"""Poisson and Gaussian kernels against scipy's distributions; limits are 5 sigma unless a p-value is stated."""

import tracemalloc

import numpy as np
import pytest
from scipy import stats

from csstsim.detector.noise import TABLE_MAX, add_gaussian, add_poisson, poisson, thin
from csstsim.rng import stream

N = 400_000
MEANS = [0.01, 0.0625, 0.999, 1.0, 3.03, 15.0, 40.51, 127.99, 128.0, 1000.0, 1e7]


@pytest.mark.parametrize("mean", MEANS)
def test_poisson_moments(mean):
    draws = poisson(np.full((1, N), mean), stream(1, "moments", mean))[0].astype(float)
    assert abs(draws.mean() - mean) < 5 * np.sqrt(mean / N)
    # variance of the sample variance of a Poisson: (mu4 - sigma^4) / N = (mean + 2 mean^2) / N
    assert abs(draws.var() - mean) < 5 * np.sqrt((mean + 2 * mean**2) / N)


@pytest.mark.parametrize("mean", [m for m in MEANS if m <= 1000])
def test_poisson_distribution(mean):
    """Chi-square over all values with at least 10 expected; p > 1e-5 (about 4.4 sigma), seeds fixed."""
    draws = poisson(np.full((1, N), mean), stream(2, "shape", mean))[0]
    low, high = (int(v) for v in stats.poisson.ppf([1e-4, 1 - 1e-4], mean))
    edges = np.arange(low, high + 1)
    observed = np.array(
        [(draws <= low).sum(), *np.bincount(draws, minlength=high + 1)[low + 1 : high], (draws >= high).sum()]
    )
    cdf = stats.poisson.cdf(edges[:-1], mean)
    expected = N * np.diff(np.r_[0.0, cdf, 1.0])
    assert stats.chisquare(observed, expected * observed.sum() / expected.sum()).pvalue > 1e-5


def test_a_ramp_of_means_is_poisson_in_every_pixel():
    """Different means side by side: standardised residuals, and no correlation between neighbours."""
    mean = np.linspace(0.5, 2 * TABLE_MAX, N).reshape(1, N)
    z = ((poisson(mean, stream(3, "ramp")) - mean) / np.sqrt(mean))[0]
    assert abs(z.mean()) < 5 / np.sqrt(N)
    assert abs(z.var() - 1) < 5 * np.sqrt(2.1 / N)  # kurtosis excess 1/mean adds at most 5% here
    assert abs(np.mean(z[1:] * z[:-1])) < 5 / np.sqrt(N)


def test_tails_reach_as_far_as_they_should():
    """The largest of 4e6 draws of mean 40: its distribution is cdf^n; between the 1e-4 and 1 - 1e-4 quantiles."""
    n = 4_000_000
    top = poisson(np.full((1, n), 40.0), stream(4, "tail")).max()
    low, high = (stats.poisson.ppf(q ** (1 / n), 40.0) for q in (1e-4, 1 - 1e-4))
    assert low <= top <= high


def test_zero_gives_zero_and_counted_is_added_once():
    image = np.zeros((3, 5), np.float32)
    counted = np.arange(15, dtype=np.int32).reshape(3, 5)
    add_poisson(image, stream(5, "zero"), counted=counted)
    assert np.array_equal(image, counted)
    add_poisson(empty := np.zeros((0, 5), np.float32), stream(5, "zero"))
    assert empty.size == 0


@pytest.mark.parametrize("bad", [np.nan, -1e-3, np.inf, -np.inf])
def test_impossible_expectations_are_counted_and_refused(bad):
    image = np.ones((200, 5), np.float32)
    image[70, 1] = image[199, 4] = bad
    before = image.copy()
    with pytest.raises(ValueError, match=r"2 pixel\(s\)"):
        add_poisson(image, stream(6, "bad"))
    assert np.array_equal(image, before, equal_nan=True)


def test_dark_can_lift_a_small_negative_value():
    image = np.full((2, 2), -0.5, np.float32)
    add_poisson(image, stream(7, "dark"), dark=3.0)
    assert (image >= 0).all()


def test_rows_do_not_depend_on_those_below():
    short, tall = np.full((64, 7), 9.0, np.float32), np.full((300, 7), 9.0, np.float32)
    add_poisson(short, stream(8, "rows"))
    add_poisson(tall, stream(8, "rows"))
    assert np.array_equal(short, tall[:64])
    add_gaussian(short, 5.0, stream(8, "read"))
    add_gaussian(tall, 5.0, stream(8, "read"))
    assert np.array_equal(short, tall[:64])


def test_gaussian():
    image = np.full((1000, 400), 7.0, np.float32)
    add_gaussian(image, 5.0, stream(9, "gauss"))
    z = (image.ravel().astype(float) - 7.0) / 5.0
    assert abs(z.mean()) < 5 / np.sqrt(z.size)
    assert abs(z.var() - 1) < 5 * np.sqrt(2 / z.size)
    assert stats.kstest(z, "norm").pvalue > 1e-5
    still = np.ones((2, 2), np.float32)
    add_gaussian(still, 0.0, stream(9, "gauss"))
    assert (still == 1).all()
    for bad in (-1.0, np.nan):
        with pytest.raises(ValueError, match="standard deviation"):
            add_gaussian(still, bad, stream(9, "gauss"))


def test_memory_does_not_grow_with_the_frame():
    """Under 40 MB beside a frame of the real width (a whole frame may use 200 MB)."""
    image = np.full((512, 9216), 30.0, np.float32)
    tracemalloc.start()
    add_poisson(image, stream(10, "memory"), dark=3.0)
    add_gaussian(image, 5.0, stream(10, "memory"))
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 40e6


@pytest.mark.parametrize(("mean", "low", "high", "maximum"), [
    (0.3, 0.93, 1.04, 1.05), (40.0, 0.93, 1.04, 1.05), (9.0, 0.0, 1.0, 1.0), (300.0, 0.98, 1.0, 1.0), (5, 0.5, 0.5, 0.5)
])  # fmt: skip
def test_thinned_poisson_numbers_are_poisson_of_the_light_that_is_left(mean, low, high, maximum):
    """Mean and variance of the pixels' standardised residuals, 5 sigma; drawn with `maximum` times the light."""
    weight = np.linspace(low, high, N, dtype=np.float32).reshape(400, -1)
    rng = stream(8, "thin", mean, low)
    counted = rng.poisson(mean * maximum, weight.shape).astype(np.int32)
    thin(counted, weight, maximum, rng)
    left = mean * weight.astype(float)
    assert (counted >= 0).all() and not counted[left == 0].any()
    kept = left > 0
    z = (counted - left)[kept] / np.sqrt(left[kept])
    assert abs(z.mean()) < 5 / np.sqrt(N)
    assert abs((z**2).mean() - 1) < 5 * np.sqrt((2 + 1 / left[kept]).mean() / N)
    assert abs(np.mean(z[1:] * z[:-1])) < 5 / np.sqrt(N)  # neighbours stay independent


def test_thinning_is_binomial():
    """Chi-square of 60,000 pixels of 12 electrons against scipy's binomial; p > 1e-5."""
    counted = np.full((200, 300), 12, np.int32)
    thin(counted, np.full(counted.shape, 0.7, np.float32), 1.0, stream(9, "binomial"))
    observed = np.bincount(counted.ravel(), minlength=13)
    expected = stats.binom.pmf(np.arange(13), 12, float(np.float32(0.7))) * counted.size
    rare = expected < 10
    pooled = [np.r_[v[~rare], v[rare].sum()] for v in (observed, expected)]
    assert stats.chisquare(*pooled).pvalue > 1e-5


def test_thinning_at_its_limits():
    """Weight 0 leaves none, the maximum leaves all, empty pixels stay empty; the same seed gives the same bits."""
    counted = np.array([[0, 1, 300_000, 7]], np.int32)
    for value, left in ((0.0, 0), (2.0, counted)):
        found = counted.copy()
        thin(found, np.full(counted.shape, value, np.float32), 2.0, stream(1, "limits"))
        assert (found == left).all()
    a, b = (np.full((50, 50), 30, np.int32) for _ in range(2))
    for found in (a, b):
        thin(found, np.full(found.shape, 0.9, np.float32), 1.0, stream(2, "bits"))
    assert np.array_equal(a, b) and a.sum() < 75_000


@pytest.mark.parametrize("bad", [-0.1, 1.1, np.nan, np.inf])
def test_weights_out_of_range_are_refused_before_any_draw(bad):
    counted, weight = np.full((4, 4), 9, np.int32), np.full((4, 4), 0.5, np.float32)
    weight[2, 1] = bad
    with pytest.raises(ValueError, match="maximum"):
        thin(counted, weight, 1.0, stream(3, "bad"))
    assert (counted == 9).all()
