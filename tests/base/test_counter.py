"""Random words and Poisson numbers against their distributions. Seeds are fixed; limits in sigma."""

import numba
import numpy as np
import pytest
from scipy import stats

from csstsim.base.counter import high, low, object_keys, poisson, unit, word

SIGMA = 5.0
WORDS = 2**16


@numba.njit
def sequence(key, n):
    words = np.empty(n, np.uint64)
    for i in range(n):
        words[i] = word(key, np.uint64(i))
    return words


@numba.njit
def first_words(keys):
    words = np.empty(len(keys), np.uint64)
    for i in range(len(keys)):
        words[i] = word(keys[i], np.uint64(0))
    return words


@numba.njit
def floats(words):
    values = np.empty((len(words), 3))
    for i in range(len(words)):
        values[i] = high(words[i]), low(words[i]), unit(words[i])
    return values


@numba.njit
def poissons(mean, key, n):
    counter, numbers = np.uint64(0), np.empty(n, np.int64)
    for i in range(n):
        numbers[i], counter = poisson(mean, key, counter)
    return numbers, counter


def bits(words):
    """(n, 64) of 0 and 1."""
    return np.unpackbits(words.view(np.uint8)).reshape(len(words), 64)


STREAMS = {
    "one key": lambda n: sequence(np.uint64(2**63 + 11), n),
    "key zero": lambda n: sequence(np.uint64(0), n),
    "ids in a row": lambda n: first_words(object_keys(np.uint64(5), np.arange(n))),
    "keys in a row": lambda n: first_words(np.arange(n, dtype=np.uint64)),
    # The sequences of two keys that differ by the counter's step overlap in SplitMix64 itself
    "keys a step apart": lambda n: first_words(np.arange(n, dtype=np.uint64) * np.uint64(0x9E3779B97F4A7C15)),
}


def check_words(words):
    n = len(words)
    s = bits(words).astype(np.float32) * 2 - 1  # sums of fewer than 2^24 are exact
    assert np.abs(s.sum(axis=0)).max() < SIGMA * np.sqrt(n)
    # Every bit against every bit of the word itself, of the next and of the one after: variance 1 a pair
    for lag in (0, 1, 2):
        product = s[: n - lag].T @ s[lag:]
        if lag == 0:
            np.fill_diagonal(product, 0)
        assert np.abs(product).max() < (SIGMA + 1) * np.sqrt(n - lag)  # 12,288 pairs
    for byte in range(8):
        counts = np.bincount(words.view(np.uint8)[byte::8], minlength=256)
        assert stats.chisquare(counts).pvalue > 1e-5
    assert len(np.unique(words)) == n


@pytest.mark.parametrize("stream", STREAMS)
def test_words_are_uniform_and_independent(stream):
    check_words(STREAMS[stream](WORDS))


@pytest.mark.slow
@pytest.mark.parametrize("stream", STREAMS)
def test_many_words_are_uniform_and_independent(stream):
    check_words(STREAMS[stream](2**22))


def test_two_keys_share_nothing():
    """Sequences of neighbouring keys, and of keys one step apart, at equal and shifted counters."""
    a = sequence(np.uint64(77), WORDS)
    for key in (78, 77 + 0x9E3779B97F4A7C15):
        b = sequence(np.uint64(key % 2**64), WORDS)
        assert np.intersect1d(a, b).size == 0  # 2^32 pairs of 2^64 words
        for lag in (0, 1):
            same = bits(a[lag:] ^ b[: WORDS - lag]).sum()
            n = 64 * (WORDS - lag)
            assert abs(same - n / 2) < SIGMA * np.sqrt(n) / 2


def test_keys_of_different_ids_differ_and_equal_ids_do_not():
    keys = object_keys(np.uint64(3), np.arange(-100_000, 100_000))
    assert len(np.unique(keys)) == 200_000
    assert np.array_equal(object_keys(np.uint64(3), np.array([7, 7])), keys[[100_007, 100_007]])
    assert not np.isin(object_keys(np.uint64(4), np.arange(1000)), keys).any()


def test_words_never_change():
    """A campaign's bits hang on these."""
    assert sequence(np.uint64(1), 3).tolist() == [16961224532354696312, 2727624091890873940, 3034093426151678710]


def test_uniform_numbers_stay_inside():
    edges = np.array([0, 2**64 - 1, 2**32 - 1, 2**63], np.uint64)
    values = floats(edges)
    assert (values > 0).all() and (values < 1).all()
    values = floats(sequence(np.uint64(9), WORDS))
    for column in values.T:
        assert stats.kstest(column, "uniform").pvalue > 1e-5


@pytest.mark.parametrize("mean", [1e-3, 0.5, 3.0, 9.99, 10.0, 30.0, 1e3, 1e6, 1e9])
def test_poisson_numbers(mean):
    n = 200_000
    numbers, _ = poissons(mean, np.uint64(41), n)
    assert abs(numbers.mean() - mean) < SIGMA * np.sqrt(mean / n)
    # variance of the sample variance of a Poisson number
    assert abs(numbers.var() - mean) < SIGMA * np.sqrt((mean + 2 * mean**2) / n)
    if mean <= 1e3:
        low_end, high_end = stats.poisson.ppf([1e-4, 1 - 1e-4], mean).astype(int)
        edges = np.unique(np.linspace(low_end, high_end, 60).astype(int))
        cumulative = np.concatenate([[0.0], stats.poisson.cdf(edges, mean), [1.0]])
        counts = np.bincount(np.searchsorted(edges, numbers), minlength=len(edges) + 1)
        used = np.diff(cumulative) * n > 10
        chi2 = ((counts - n * np.diff(cumulative)) ** 2 / (n * np.diff(cumulative)))[used].sum()
        assert stats.chi2.sf(chi2, used.sum()) > 1e-5


def test_poisson_of_nothing_is_nothing():
    numbers, counter = poissons(0.0, np.uint64(1), 100)
    assert not numbers.any() and counter == 100
