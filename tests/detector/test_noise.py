"""Poisson and Gaussian kernels against scipy's distributions; limits are 5 sigma unless a p-value is stated."""

import tracemalloc

import numpy as np
import pytest
from scipy import stats

from csstsim.base.rng import Streams
from csstsim.detector.noise import add_gaussian, add_poisson
from csstsim.detector.random.normal import EDGE, TAIL, normal_row, normal_table
from csstsim.detector.random.poisson import TABLE_MAX, alias_tables

N = 400_000
MEANS = [0.001, 0.01, 0.0625, 0.999, 1.0, 3.03, 15.0, 40.51, 127.99, 128.0, 1000.0, 1e6]


def key(*words):
    return Streams(1, "-".join(map(str, words)), 1, "noise").exposure_key("frame")


def poisson(mean, key):
    """Poisson numbers (float64) of float32 means."""
    image = np.array(mean, np.float32)
    add_poisson(image, key)
    return image.astype(float)


@pytest.mark.parametrize("mean", MEANS)
def test_poisson_moments(mean):
    """Mean = variance, from 1e-3 to 1e6 electrons."""
    draws = poisson(np.full((40, N // 40), mean), key("moments", mean))
    mean = float(np.float32(mean))
    assert abs(draws.mean() - mean) < 5 * np.sqrt(mean / N)
    # variance of the sample variance of a Poisson: (mu4 - sigma^4) / N = (mean + 2 mean^2) / N
    assert abs(draws.var() - mean) < 5 * np.sqrt((mean + 2 * mean**2) / N)


def chi_square(draws, mean):
    """p-value over all values with probability above 1e-4, the tails pooled."""
    low, high = (int(v) for v in stats.poisson.ppf([1e-4, 1 - 1e-4], mean))
    edges = np.arange(low, high + 1)
    middle = np.bincount(draws, minlength=high + 1)[low + 1 : high]
    observed = np.array([(draws <= low).sum(), *middle, (draws >= high).sum()])
    expected = draws.size * np.diff(np.r_[0.0, stats.poisson.cdf(edges[:-1], mean), 1.0])
    return stats.chisquare(observed, expected * observed.sum() / expected.sum()).pvalue


@pytest.mark.parametrize("mean", [m for m in MEANS if 0.01 <= m <= 1000])
def test_poisson_distribution(mean):
    """p > 1e-5 (about 4.4 sigma), seeds fixed."""
    draws = poisson(np.full((40, N // 40), mean), key("shape", mean))
    assert chi_square(draws.astype(int).ravel(), float(np.float32(mean))) > 1e-5


def test_alias_tables_hold_the_distribution():
    """Probabilities read back from the cells: to 2^-40 each, what rounding leaves over in the likeliest one."""
    share, other = (table.reshape(-1, 256) for table in alias_tables())
    for row in (0, 1, 16, 640, len(share) - 1):
        held = share[row].astype(float)
        np.add.at(held, other[row], 2.0**32 - share[row])
        wrong = abs(held / 2**40 - stats.poisson.pmf(np.arange(256), row / 16))
        assert np.sort(wrong)[-2] < 1.01 * 2**-41 and wrong.max() < 2**-37


def test_a_ramp_of_means_is_poisson_in_every_pixel():
    """Different means side by side: standardised residuals, and no correlation between neighbours."""
    mean = np.linspace(0.5, 2 * TABLE_MAX, N, dtype=np.float32).reshape(1, N)
    z = ((poisson(mean, key("ramp")) - mean) / np.sqrt(mean))[0].astype(float)
    assert abs(z.mean()) < 5 / np.sqrt(N)
    assert abs(z.var() - 1) < 5 * np.sqrt(2.1 / N)  # kurtosis excess 1/mean adds at most 5% here
    assert abs(np.mean(z[1:] * z[:-1])) < 5 / np.sqrt(N)


def test_tails_reach_as_far_as_they_should():
    """The largest of 4e6 draws of mean 40: its distribution is cdf^n; between the 1e-4 and 1 - 1e-4 quantiles."""
    n = 4_000_000
    top = poisson(np.full((1000, n // 1000), 40.0), key("tail")).max()
    low, high = (stats.poisson.ppf(q ** (1 / n), 40.0) for q in (1e-4, 1 - 1e-4))
    assert low <= top <= high


def test_zero_gives_zero_and_counted_is_added_once():
    image = np.zeros((3, 5), np.float32)
    counted = np.arange(15, dtype=np.int32).reshape(3, 5)
    add_poisson(image, key("zero"), counted=counted)
    assert np.array_equal(image, counted)
    add_poisson(empty := np.zeros((0, 5), np.float32), key("zero"))
    assert empty.size == 0


@pytest.mark.parametrize("bad", [np.nan, -1e-3, np.inf, -np.inf])
def test_impossible_expectations_are_counted_and_refused(bad):
    image = np.ones((200, 5), np.float32)
    image[70, 1] = image[199, 4] = bad
    before = image.copy()
    with pytest.raises(ValueError, match=r"2 pixel\(s\)"):
        add_poisson(image, key("bad"))
    assert np.array_equal(image, before, equal_nan=True)


def test_dark_can_lift_a_small_negative_value():
    image = np.full((2, 2), -0.5, np.float32)
    add_poisson(image, key("dark"), dark=3.0)
    assert (image >= 0).all()


def test_a_pixel_keeps_its_number_in_any_frame():
    """Of the pixels of a frame, those of its lower left part are what that part gets by itself; neighbours differ."""
    for width in (7, 8):
        small, large = np.full((64, width), 9.0, np.float32), np.full((300, 9), 9.0, np.float32)
        add_poisson(small, key("rows"))
        add_poisson(large, key("rows"))
        assert np.array_equal(small, large[:64, :width])
        add_gaussian(small, 5.0, key("read"))
        add_gaussian(large, 5.0, key("read"))
        assert np.array_equal(small, large[:64, :width])


@pytest.mark.parametrize("x0", [0, 1, 6, 7])
def test_normal_numbers_of_a_part_of_a_row(x0):
    whole, part, halves = np.empty(40, np.float32), np.empty(13, np.float32), np.empty(42, np.uint32)
    normal_row(np.uint64(3), 5, 0, halves, whole, *normal_table())
    normal_row(np.uint64(3), 5, x0, halves, part, *normal_table())
    assert np.array_equal(part, whole[x0 : x0 + 13])


def test_gaussian():
    image = np.full((1000, 2000), 7.0, np.float32)
    add_gaussian(image, 5.0, key("gauss"))
    z = (image.astype(float) - 7.0) / 5.0
    moments = [(z**n).mean() for n in (1, 2, 3, 4)]
    errors = np.sqrt(np.array([1, 2, 15, 96]) / z.size)
    assert (abs(np.array(moments) - [0, 1, 0, 3]) < 5 * errors).all()
    assert stats.kstest(z.ravel(), "norm").pvalue > 1e-5
    for dy, dx in ((0, 1), (1, 0), (0, 2), (1, 1)):
        pairs = z[dy:, dx:] * z[: z.shape[0] - dy, : z.shape[1] - dx]
        assert abs(pairs.mean()) < 5 / np.sqrt(pairs.size)
    still = np.ones((2, 2), np.float32)
    add_gaussian(still, 0.0, key("gauss"))
    assert (still == 1).all()
    for bad in (-1.0, np.nan):
        with pytest.raises(ValueError, match="standard deviation"):
            add_gaussian(still, bad, key("gauss"))


def test_the_linear_parts_are_as_near_to_the_normal_distribution_as_is_said():
    """Without drawing: distribution function within 2e-6, variance within 1e-5 of those of the normal one."""
    start, step = (table.astype(float)[EDGE:-EDGE] for table in normal_table())
    cells = len(normal_table()[0])
    place = np.linspace(0, 1, 9)
    values = start[:, None] + step[:, None] * 2.0**20 * place
    share = (np.arange(EDGE, cells - EDGE)[:, None] + place) / cells
    assert abs(stats.norm.cdf(values) - share).max() < 2e-6
    width = step * 2.0**20
    inner = ((start + width / 2) ** 2 + width**2 / 12).sum() / cells
    outer = 2 * (TAIL * stats.norm.pdf(TAIL) + stats.norm.sf(TAIL))  # of z^2 beyond +-TAIL
    assert abs(inner + outer - 1) < 1e-5


def tail_counts(rows):
    """Draw rows of 10^5 numbers; return how many and {z: how many lie beyond +-z}."""
    counts, n = dict.fromkeys((TAIL, 3.0, 3.5, 4.0, 4.5, 5.0, 5.5), 0), 0
    for i in range(rows // 100):
        image = np.zeros((100, 100_000), np.float32)
        add_gaussian(image, 1.0, key("tails", i))
        np.abs(image, out=image)
        n += image.size
        for z in counts:
            counts[z] += int((image > z).sum())
    return n, counts


@pytest.mark.parametrize("rows", [100, pytest.param(1000, marks=pytest.mark.slow)])
def test_gaussian_tails(rows):
    """Beyond 3 to 5.5 sigma in 10^7 draws (slow: 10^8, 57 beyond 5 sigma): p > 1e-5 both ways of a Poisson number."""
    n, counts = tail_counts(rows)
    for z, count in counts.items():
        expected = 2 * n * stats.norm.sf(z)
        assert min(stats.poisson.cdf(count, expected), stats.poisson.sf(count - 1, expected)) > 1e-5, (
            z,
            count,
            expected,
        )
    assert counts[5.0] > 0


def test_memory_does_not_grow_with_the_frame():
    """Under 40 MB beside a frame of the real width (a whole frame may use 200 MB)."""
    image = np.full((512, 9216), 30.0, np.float32)
    tracemalloc.start()
    add_poisson(image, key("memory"), dark=3.0)
    add_gaussian(image, 5.0, key("memory"))
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 40e6


def test_means_beyond_whole_numbers_of_32_bits():
    """Cores of the brightest stars: mean and variance within 5 sigma; pixels around them as if they were not there."""
    key, image = np.uint64(5), np.full((200, 300), 40.0, np.float32)
    plain = image.copy()
    add_poisson(plain, key)
    counted = np.full(image.shape, 7, np.int32)
    image[50:150] = 2e10
    add_poisson(image, key, counted=counted)
    far = image[50:150].astype(float)
    n = far.size
    step = 2048.0  # of float32 there
    assert abs(far.mean() - 2e10) < 5 * np.sqrt(2e10 / n) + step
    assert abs(far.var() / 2e10 - 1) < 5 * np.sqrt(2 / n) + step**2 / 12 / 2e10
    assert np.array_equal(image[:50], plain[:50] + 7)
    with pytest.raises(ValueError, match="1 pixel"):
        add_poisson(np.array([[np.inf, 1.0]], np.float32), key)


@pytest.mark.parametrize("dark", [0.0, 4e8])
def test_the_brightest_pixels_have_their_dark_current_and_the_noise_of_both(dark):
    """Means above what whole numbers hold: 2e9 expected, and dark current: mean and variance to 5 sigma."""
    image = np.full((300, 300), 2e9, np.float32)
    add_poisson(image, key("bright", dark), dark=dark)
    mean, n = 2e9 + dark, image.size
    values = image.astype(float) - mean
    assert abs(values.mean()) < 5 * np.sqrt(mean / n) + 64  # float32 has steps of 128 there
    assert values.var() == pytest.approx(mean, rel=5 * np.sqrt(2 / n))


def test_counted_electrons_stay_where_the_expected_ones_are_very_bright():
    """4e9 expected and 1e8 counted ones, to 5 sigma of the former: 6.3e4 each, in 256 pixels."""
    image = np.full((16, 16), 4e9, np.float32)
    add_poisson(image, np.uint64(12345), counted=np.full((16, 16), 10**8, np.int32))
    assert abs(image.mean(dtype=float) - 4.1e9) < 5 * np.sqrt(4e9) / 16
