"""The posterior of a source's flux over the sizes and kinds of `profile_tables`, for `measure.light.total_light`.

At low S/N the tables' own points sample it. Where it is narrower than their steps, a lattice between them does, which
is narrowed until it resolves the posterior.
"""

import math

import numba
import numpy as np

from csstsim.base.types import FloatArray

SHAPE_ERROR = 0.025  # of the flux: galaxies are not the profiles of the tables
# points on a side; how often it is narrowed
LATTICE = 13
LEVELS = 4
# Power of the probabilities of which the flux is the median. At S/N 10 bulges are 0.09 mag too faint by the median of
# the posterior itself, which lies between those of the profiles that fit; of the power it is at the likely ones
SHARP = 3.0
STAR = 7.0  # ln of the odds above which a source is a point, and the galaxy's part of the posterior needs no care
_BINS = 96  # of the posterior
_NEGLIGIBLE = 20.0  # ln of a probability over the largest


@numba.njit(cache=True)
def project(profiles: FloatArray, normal: FloatArray, fits: FloatArray) -> None:
    """Fill `fits` (3, n) with the inverse variance of F of each of `profiles` (K, n), F times it, and room.

    `normal` (5, K): of total_light._normal, the sky's inverse variance and weighted data in its last row.
    """
    square, product, level = fits
    fits[:] = 0.0
    last = normal.shape[1] - 1
    for k in range(last + 1):
        diagonal = normal[0, k]
        upper = normal[1, k]
        data = normal[2, k]
        ones = normal[3, k]
        here = profiles[k]
        beyond = profiles[min(k + 1, last)]
        for g in range(here.size):
            p = here[g]
            square[g] += p * (diagonal * p + 2.0 * upper * beyond[g])
            product[g] += p * data
            level[g] += p * ones
    sky = 1.0 / normal[4, 0]
    light = normal[4, 1]
    for g in range(square.size):
        square[g] = max(square[g] - level[g] * level[g] * sky, 1e-300)
        product[g] -= level[g] * light * sky


@numba.njit(cache=True)
def _cubic(place: float, count: int, weight: FloatArray) -> int:
    """Fill `weight` (4,) with those of a cubic through four neighbours of `place`; return the first one's index."""
    first = min(max(math.floor(place) - 1, 0), count - 4)
    t = place - first - 1.0
    weight[0] = -t * (t - 1.0) * (t - 2.0) / 6.0
    weight[1] = (t + 1.0) * (t - 1.0) * (t - 2.0) / 2.0
    weight[2] = -(t + 1.0) * t * (t - 2.0) / 2.0
    weight[3] = (t + 1.0) * t * (t - 1.0) / 6.0
    return first


@numba.njit(cache=True)
def _coarse(maps: FloatArray, points: FloatArray) -> None:
    """Fill `points` (6, n): ln probability, F, its variance, Gaussian share, size, kind; steps of the tables.

    `maps` (4, sizes, kinds): inverse variance, F times it, Gaussian share, ln prior.
    """
    _, sizes, kinds = maps.shape
    g = 0
    for i in range(sizes):
        for j in range(kinds):
            variance = 1.0 / maps[0, i, j]
            flux = maps[1, i, j] * variance
            points[0, g] = 0.5 * maps[1, i, j] * abs(flux) + maps[3, i, j]
            points[1, g], points[2, g], points[3, g] = flux, variance, maps[2, i, j]
            points[4, g] = i
            points[5, g] = j
            g += 1


@numba.njit(cache=True)
def _refine(profiles: FloatArray, normal: FloatArray, maps: FloatArray, window: FloatArray, points: FloatArray) -> None:
    """As `_coarse` for a square lattice in `window`: first and last size and kind.

    `profiles` (K, sizes x kinds) are cubic in the size and mixed between neighbouring kinds; `normal`: as in `project`.
    """
    count = round(math.sqrt(points.shape[1]))
    _, sizes, kinds = maps.shape
    along = np.empty(4)
    line = np.empty((len(profiles), kinds))
    values = np.empty((2, kinds))
    profile = np.empty((len(profiles), 1))
    fit = np.empty((3, 1))
    for i in range(count):
        u = window[0] + (window[1] - window[0]) * i / (count - 1)
        first = _cubic(u, sizes, along)
        line[:] = 0.0
        values[:] = 0.0
        for m in range(4):
            start = (first + m) * kinds
            for j in range(kinds):
                values[0, j] += along[m] * maps[2, first + m, j]
                values[1, j] += along[m] * maps[3, first + m, j]
            for k in range(len(profiles)):
                for j in range(kinds):
                    line[k, j] += along[m] * profiles[k, start + j]
        for j in range(count):
            v = window[2] + (window[3] - window[2]) * j / (count - 1)
            low = min(max(math.floor(v), 0), kinds - 2)
            t = v - low
            for k in range(len(profiles)):
                profile[k, 0] = (1.0 - t) * line[k, low] + t * line[k, low + 1]
            project(profile, normal, fit)
            g = i * count + j
            points[2, g] = 1.0 / fit[0, 0]
            points[1, g] = fit[1, 0] * points[2, g]
            points[0, g] = 0.5 * fit[1, 0] * abs(points[1, g]) + (1.0 - t) * values[1, low] + t * values[1, low + 1]
            points[3, g] = (1.0 - t) * values[0, low] + t * values[0, low + 1]
            points[4, g] = u
            points[5, g] = v


@numba.njit(cache=True)
def _moments(points: FloatArray) -> tuple[float, float, float, float, float, float]:
    """Return (largest ln probability, sum of probabilities over it, mean and scatter of size, of kind)."""
    best = -math.inf
    for g in range(points.shape[1]):
        best = max(best, points[0, g])
    total = 0.0
    u = 0.0
    uu = 0.0
    v = 0.0
    vv = 0.0
    for g in range(points.shape[1]):
        if points[0, g] < best - _NEGLIGIBLE:
            continue
        w = math.exp(points[0, g] - best)
        size = points[4, g]
        kind = points[5, g]
        total += w
        u += w * size
        uu += w * size * size
        v += w * kind
        vv += w * kind * kind
    u = u / total
    v = v / total
    return best, total, u, math.sqrt(max(uu / total - u * u, 0.0)), v, math.sqrt(max(vv / total - v * v, 0.0))


@numba.njit(cache=True)
def _median(value: FloatArray, weight: FloatArray) -> tuple[float, float]:
    """Return (median, half of the interval of 68.3 %) of weighted values, to a few hundredths of their scatter."""
    total = 0.0
    mean = 0.0
    square = 0.0
    for k in range(value.size):
        total += weight[k]
        mean += weight[k] * value[k]
        square += weight[k] * value[k] ** 2
    mean /= total
    scatter = math.sqrt(max(square / total - mean * mean, 0.0))
    if not scatter > 1e-9 * abs(mean):
        return mean, 0.0
    bins = np.zeros(_BINS)
    sums = np.zeros(_BINS)
    for k in range(value.size):
        i = min(max(int((value[k] - mean) / scatter * _BINS / 8.0 + 0.5 * _BINS), 0), _BINS - 1)
        bins[i] += weight[k]
        sums[i] += weight[k] * value[k]
    below = 0.0
    low = mean
    middle = mean
    high = mean
    for i in range(_BINS):
        above = below + bins[i]
        if bins[i] > 0.0:
            if below < 0.1587 * total <= above:
                low = sums[i] / bins[i]
            if below < 0.5 * total <= above:
                middle = sums[i] / bins[i]
            if below < 0.8413 * total <= above:
                high = sums[i] / bins[i]
        below = above
    return middle, 0.5 * (high - low)


@numba.njit(cache=True)
def _narrowed(
    profiles: FloatArray, normal: FloatArray, maps: FloatArray, star: FloatArray, coarse: FloatArray, fine: FloatArray
) -> tuple[FloatArray, float, tuple[float, float, float, float, float, float]]:
    """Return (points, area of one, moments) of the part of the tables that holds the posterior, finely enough."""
    _, sizes, kinds = maps.shape
    points = coarse
    du = 1.0
    dv = 1.0
    _coarse(maps, points)
    window = np.empty(4)
    moments = _moments(points)
    for _ in range(LEVELS):
        best, total, u, su, v, sv = moments
        if (su > du and sv > dv) or star[0] - best - math.log(total) > STAR:
            break
        wide = max(3.0 * su, 1.5 * du)
        tall = max(3.0 * sv, 1.5 * dv)
        window[0], window[1] = max(u - wide, 0.0), min(u + wide, sizes - 1.0)
        window[2], window[3] = max(v - tall, 0.0), min(v + tall, kinds - 1.0)
        du = (window[1] - window[0]) / (LATTICE - 1)
        dv = (window[3] - window[2]) / (LATTICE - 1)
        points = fine
        _refine(profiles, normal, maps, window, points)
        moments = _moments(points)
    return points, du * dv, moments


@numba.njit(cache=True)
def posterior(
    profiles: FloatArray,
    normal: FloatArray,
    maps: FloatArray,
    star: FloatArray,
    coarse: FloatArray,
    fine: FloatArray,
    room: FloatArray,
    out: FloatArray,
) -> None:
    """Fill `out` (6,) with the columns of a source; `star` (3,): ln probability, flux and variance of a point.

    `coarse`, `fine`: room for points; `room` (2, n): for one more than either.
    """
    points, area, moments = _narrowed(profiles, normal, maps, star, coarse, fine)
    top = max(moments[0], star[0])
    n: int = points.shape[1]
    value = room[0, : n + 1]
    weight = room[1, : n + 1]
    noise = 0.0
    gaap_noise = 0.0
    every = 0.0
    for g in range(n):
        w = area * math.exp(max(points[0, g] - top, -2.0 * _NEGLIGIBLE))
        weight[g], value[g] = w, points[1, g]
        noise += w * points[2, g]
        gaap_noise += w * points[2, g] * points[3, g] ** 2
        every += w
    value[n], weight[n] = star[1], math.exp(max(star[0] - top, -2.0 * _NEGLIGIBLE))
    every += weight[n]
    point = weight[n] / every
    _, spread = _median(value, weight)
    out[0], _ = _median(value, weight**SHARP)
    shape = (1.0 - point) * SHAPE_ERROR * out[0]
    out[1] = math.sqrt(spread**2 + noise / every + point * star[2] + shape**2)
    for g in range(n):
        value[g] *= points[3, g]
    out[2], spread = _median(value, weight)
    out[3] = math.sqrt(spread**2 + gaap_noise / every + point * star[2])
    out[4] = moments[2]
    out[5] = point
