"""Shot noise, readout noise and losses of counted electrons in pixels (paper, Appendix B, items 1 to 3, 5 and 13).

Poisson numbers below TABLE_MAX are drawn exactly by splitting the mean: Poisson(m) = Poisson(a) + Poisson(m - a)
with a = floor(16 m) / 16, the first from a table of its distribution function (40 random bits), the second, of
mean below 1/16, by inversion (24 bits); three to six times faster than the rejection method that numpy uses, which
draws the larger means. The finite bits move no probability by more than 1e-7.

Work goes through the image in blocks of BLOCK_ROWS rows, in order, from one generator, so that little memory is
used and threads cannot matter; the block height is part of what a seed means.
"""

from functools import cache

import numba
import numpy as np

BLOCK_ROWS = 64
TABLE_MAX = 128  # electrons; the sky of a 250 s exposure and the wings of objects lie below
_STEPS = 16  # tabulated means per electron
_BITS = 40  # of a 64-bit random word: for the table; the remaining 24 for the rest of the mean
_GUIDE_BITS = 8


def add_poisson(image, rng, *, dark=0.0, counted=None):
    """Replace expected electrons by counted ones, in place: image = counted + Poisson(image + dark).

    `image` float32 (ny, nx), `dark` in electrons (scalar), `counted` integers of the same shape that are Poisson
    already, or None. Raises ValueError, before any draw, if an expected value is negative or not finite.
    """
    check_expected(image, dark)
    for rows in _blocks(image):
        mean = image[rows].astype(np.float64)
        mean += dark
        image[rows] = poisson(mean, rng)
        if counted is not None:
            image[rows] += counted[rows]


def check_expected(image, dark=0.0):
    """Raise ValueError if image + dark holds negative, infinite or NaN values; the message counts the pixels."""
    bad = 0
    for rows in _blocks(image):
        mean = image[rows] + np.float32(dark)
        bad += mean.size - int(np.count_nonzero((mean >= 0) & (mean < np.inf)))
    if bad:
        raise ValueError(f"the expected electrons of {bad} pixel(s) are negative or not finite")


def poisson(mean, rng):
    """Return Poisson numbers (int64) for `mean` (float64 array, finite, >= 0)."""
    words = rng.integers(0, 2**64, size=mean.shape, dtype=np.uint64)
    counts = np.empty(mean.shape, np.int64)
    _draw_small(mean.ravel(), words.ravel(), counts.ravel(), *_tables())
    large = mean >= TABLE_MAX
    counts[large] = rng.poisson(mean[large])
    return counts


def add_gaussian(image, sigma, rng):
    """Add Gaussian noise of standard deviation `sigma` (scalar, image's unit) to `image` (float32), in place."""
    if not sigma >= 0:
        raise ValueError(f"noise of standard deviation {sigma}")
    if sigma == 0:
        return
    buffer = np.empty((min(BLOCK_ROWS, image.shape[0]), image.shape[1]), np.float32)
    for rows in _blocks(image):
        noise = buffer[: rows.stop - rows.start]
        rng.standard_normal(dtype=np.float32, out=noise)
        noise *= np.float32(sigma)
        image[rows] += noise


def thin(counted, weight, maximum, rng):
    """Keep each counted electron with probability weight / maximum, in place: what a loss does to Poisson numbers.

    `counted` int32 (ny, nx), drawn from `maximum` times the light there would be without the loss; `weight` float32
    (ny, nx), 0 to `maximum`. Poisson numbers stay Poisson: mean = variance. Cost goes with the electrons lost.
    Raises ValueError, before any draw, for weights outside their range.
    """
    low, high = float(np.min(weight)), float(np.max(weight))
    if not 0 <= low <= high <= maximum < np.inf:
        raise ValueError(f"weights from {low} to {high} are not within 0 to their maximum, {maximum}")
    if low < maximum:
        _thin(counted, weight, 1.0 / maximum, 1.0 - low / maximum, rng)


@numba.njit(cache=True)
def _thin(counted, weight, scale, most, rng):
    """A share `most` of the electrons are candidates, geometric gaps apart; (1 - weight scale) / most of them go."""
    per_gap = 1.0 / np.log1p(-most)  # -0 if every electron is a candidate
    gap = int(np.log(1.0 - rng.random()) * per_gap)
    for row in range(counted.shape[0]):
        for column in range(counted.shape[1]):
            left = counted[row, column]
            while gap < left:
                left -= gap + 1
                if rng.random() * most < 1.0 - weight[row, column] * scale:
                    counted[row, column] -= 1
                gap = int(np.log(1.0 - rng.random()) * per_gap)
            gap -= left


def _blocks(image):
    for start in range(0, image.shape[0], BLOCK_ROWS):
        yield slice(start, min(start + BLOCK_ROWS, image.shape[0]))


@cache
def _tables():
    """Return (thresholds, guide): thresholds[i, n] = 2^40 P(N <= n) for mean i / 16, and where to start looking."""
    mean = np.arange(TABLE_MAX * _STEPS) / _STEPS
    probability = np.exp(-mean)
    total = np.zeros_like(mean)
    columns = []
    top = 2**_BITS
    while not columns or columns[-1].min() < top - 1:
        total += probability
        columns.append(np.minimum(np.rint(total * top), top).astype(np.uint64))
        probability *= mean / len(columns)
    thresholds = np.stack(columns, axis=1)
    thresholds[:, -1] = top  # the search always ends
    starts = np.arange(2**_GUIDE_BITS, dtype=np.uint64) << np.uint64(_BITS - _GUIDE_BITS)
    guide = np.stack([np.searchsorted(row, starts, side="right") for row in thresholds]).astype(np.int16)
    return thresholds, guide


@numba.njit(cache=True)
def _draw_small(mean, words, counts, thresholds, guide):
    guide_shift = np.uint64(_BITS - _GUIDE_BITS)
    rest_bits = np.uint64(64 - _BITS)
    rest_mask = (np.uint64(1) << rest_bits) - np.uint64(1)
    unit = 1.0 / (1 << (64 - _BITS))
    for i in range(mean.size):
        m = mean[i]
        if m >= TABLE_MAX:
            continue
        table = int(m * _STEPS)
        word = words[i] >> rest_bits
        n = guide[table, word >> guide_shift]
        while word >= thresholds[table, n]:
            n += 1
        rest = m - table / _STEPS
        u = (words[i] & rest_mask) * unit
        if u > 1.0 - rest:  # exp(-rest) >= 1 - rest: the common case, no event, needs no exponential
            p = np.exp(-rest)
            k = 1
            while u >= p and k < 20:
                u -= p
                p *= rest / k
                n += 1
                k += 1
        counts[i] = n
