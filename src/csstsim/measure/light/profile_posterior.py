"""The posterior of a source's flux over the sizes and kinds of `profile_tables`, for `measure.light.total_light`.

The flux of a galaxy has a prior that is nearly flat: each kind and each step of the logarithm of the size is nearly as
likely as any other. Likely sizes would make the small galaxies of S/N 10 too bright and the large ones too faint, by up
to 0.15 mag; a flat prior makes the large ones 0.05 mag too bright at S/N 8 to 20. With POPULATION_POWER of the
population's prior, all thirds by size have the same bias there, 0.02 mag. The sizes and kinds of the population are
used for the rest: the choice between a point and a galaxy, errors, the Gaussian aperture, and the size that is
reported.

At low S/N, the points of the tables sample it. Where it is narrower than the steps of the tables, a lattice between the
points samples it, which is narrowed until it resolves the posterior.
"""

import math
from typing import NamedTuple

import numba
import numpy as np

from csstsim.base.arrays.polynomial_weights import cubic_weights
from csstsim.base.types import FloatArray

POPULATION_POWER = 0.15  # of the population's prior in that of the flux
SHAPE_ERROR = 0.025  # of the flux: galaxies are not the profiles of the tables
LATTICE = 13  # points on a side
LEVELS = 4  # maximum number of times that the lattice is narrowed
STAR = 7.0  # ln of the odds above which a source is a point: the posterior of a galaxy need not be resolved
_BINS = 96  # of the posterior
_CERTAIN = 500.0  # ln of the odds above which they are not counted on
_NEGLIGIBLE = 20.0  # ln of the ratio of the largest probability to one that is neglected


class NormalEquations(NamedTuple):
    """Weighted sums over a source's pixels, from which the fit of every profile with the sky follows.

    `diagonal`, `upper` (K,): of the matrix on the nodes; `data`, `ones` (K,): the pixels' electrons and 1, projected on
    the nodes; `sky_weight`: inverse variance of the sky; `sky_data`: sum of the weighted electrons; `pixels`: number.
    """

    diagonal: FloatArray
    upper: FloatArray
    data: FloatArray
    ones: FloatArray
    sky_weight: float
    sky_data: float
    pixels: float


class ProfileFits(NamedTuple):
    """Fits of n profiles: `weight` (n,), inverse variance of the flux F [electron]; `product` (n,): weight times F.

    `level` (n,): array for a sum, overwritten.
    """

    weight: FloatArray
    product: FloatArray
    level: FloatArray


class ProfileMaps(NamedTuple):
    """Of the tables' profiles (sizes, kinds): `weight`, `product` as of ProfileFits, `gaap`, `log_population`.

    `gaap` is the fraction of the flux in the Gaussian aperture, `log_population` ln of the fraction of all sources.
    """

    weight: FloatArray
    product: FloatArray
    gaap: FloatArray
    log_population: FloatArray


class Samples(NamedTuple):
    """Samples (n,) of the posterior: ln probability, flux [electron] and its variance; others as of ProfileMaps.

    `size` and `kind` are in steps of the tables.
    """

    log_probability: FloatArray
    log_population: FloatArray
    flux: FloatArray
    variance: FloatArray
    gaap: FloatArray
    size: FloatArray
    kind: FloatArray


class Point(NamedTuple):
    """A source as a point: ln probability, flux [electron] and its variance."""

    log_probability: float
    flux: float
    variance: float


class Region(NamedTuple):
    """A part of the tables: first and last size and kind, in steps of the tables."""

    first_size: float
    last_size: float
    first_kind: float
    last_kind: float


class Moments(NamedTuple):
    """Of samples: `best` ln probability, `population`, mean and scatter.

    `population`: sum of the probabilities relative to the best, each times its fraction of all sources.
    """

    best: float
    population: float
    size: float
    size_scatter: float
    kind: float
    kind_scatter: float


class Narrowed(NamedTuple):
    """Samples that resolve the posterior, the area of one of them in steps of the tables, and their moments."""

    samples: Samples
    area: float
    moments: Moments


class Scratch(NamedTuple):
    """Arrays, overwritten: samples of all profiles and of a lattice; `value`, `weight` are longer than both by one."""

    coarse: Samples
    fine: Samples
    value: FloatArray
    weight: FloatArray


class SourceFlux(NamedTuple):
    """Fluxes of a source [electron] and their errors, its size in steps of the tables, probability of a point.

    `evidence`: as of total_light.TotalLight.
    """

    total: float
    total_error: float
    gaap: float
    gaap_error: float
    size: float
    point: float
    evidence: float


@numba.njit(cache=True)
def project(profiles: FloatArray, normal: NormalEquations, fits: ProfileFits) -> None:
    """Fill `fits` with those of `profiles` (K, n)."""
    weight = fits.weight
    product = fits.product
    level = fits.level
    weight[:] = 0.0
    product[:] = 0.0
    level[:] = 0.0
    last = normal.diagonal.size - 1
    for k in range(last + 1):
        diagonal = normal.diagonal[k]
        upper = normal.upper[k]
        data = normal.data[k]
        ones = normal.ones[k]
        profile_k = profiles[k]
        profile_next = profiles[min(k + 1, last)]
        for g in range(profile_k.size):
            value = profile_k[g]
            weight[g] += value * (diagonal * value + 2.0 * upper * profile_next[g])
            product[g] += value * data
            level[g] += value * ones
    sky = 1.0 / normal.sky_weight
    sky_data = normal.sky_data
    for g in range(weight.size):
        weight[g] = max(weight[g] - level[g] * level[g] * sky, 1e-300)
        product[g] -= level[g] * sky_data * sky


_cubic_weights = numba.njit()(cubic_weights)


@numba.njit(cache=True)
def _cubic(position: float, count: int, weight: FloatArray) -> int:
    """Fill `weight` (4,) with those of a cubic through four neighbours of `position`; return the first one's index."""
    first = min(max(math.floor(position) - 1, 0), count - 4)
    t = position - first - 1.0
    weight[0], weight[1], weight[2], weight[3] = _cubic_weights(t)
    return first


@numba.njit(cache=True)
def _coarse(maps: ProfileMaps, samples: Samples) -> None:
    """Fill `samples` with one of each profile."""
    sizes, kinds = maps.gaap.shape
    g = 0
    for i in range(sizes):
        for j in range(kinds):
            variance = 1.0 / maps.weight[i, j]
            flux = maps.product[i, j] * variance
            samples.log_probability[g] = 0.5 * maps.product[i, j] * abs(flux)
            samples.log_population[g] = maps.log_population[i, j]
            samples.flux[g] = flux
            samples.variance[g] = variance
            samples.gaap[g] = maps.gaap[i, j]
            samples.size[g] = i
            samples.kind[g] = j
            g += 1


@numba.njit(cache=True)
def _refine(profiles: FloatArray, normal: NormalEquations, maps: ProfileMaps, region: Region, samples: Samples) -> None:
    """Fill `samples` with a square lattice in a region.

    `profiles` (K, sizes x kinds) are cubic in the size and mixed between neighbouring kinds.
    """
    count = round(math.sqrt(samples.flux.size))
    sizes, kinds = maps.gaap.shape
    along = np.empty(4)
    line = np.empty((len(profiles), kinds))
    gaap = np.empty(kinds)
    log_population = np.empty(kinds)
    profile = np.empty((len(profiles), 1))
    fit = ProfileFits(np.empty(1), np.empty(1), np.empty(1))
    for i in range(count):
        u = region.first_size + (region.last_size - region.first_size) * i / (count - 1)
        first = _cubic(u, sizes, along)
        line[:] = 0.0
        gaap[:] = 0.0
        log_population[:] = 0.0
        for m in range(4):
            start = (first + m) * kinds
            for j in range(kinds):
                gaap[j] += along[m] * maps.gaap[first + m, j]
                log_population[j] += along[m] * maps.log_population[first + m, j]
            for k in range(len(profiles)):
                for j in range(kinds):
                    line[k, j] += along[m] * profiles[k, start + j]
        for j in range(count):
            v = region.first_kind + (region.last_kind - region.first_kind) * j / (count - 1)
            low = min(max(math.floor(v), 0), kinds - 2)
            t = v - low
            for k in range(len(profiles)):
                profile[k, 0] = (1.0 - t) * line[k, low] + t * line[k, low + 1]
            project(profile, normal, fit)
            product = fit.product[0]
            g = i * count + j
            variance = 1.0 / fit.weight[0]
            flux = product * variance
            samples.variance[g] = variance
            samples.flux[g] = flux
            samples.log_probability[g] = 0.5 * product * abs(flux)
            samples.log_population[g] = (1.0 - t) * log_population[low] + t * log_population[low + 1]
            samples.gaap[g] = (1.0 - t) * gaap[low] + t * gaap[low + 1]
            samples.size[g] = u
            samples.kind[g] = v


@numba.njit(cache=True)
def _moments(samples: Samples) -> Moments:
    best = -math.inf
    for g in range(samples.flux.size):
        best = max(best, samples.log_probability[g])
    total = 0.0
    population = 0.0
    u = 0.0
    uu = 0.0
    v = 0.0
    vv = 0.0
    for g in range(samples.flux.size):
        if samples.log_probability[g] < best - _NEGLIGIBLE:
            continue
        w = math.exp(samples.log_probability[g] - best)
        size = samples.size[g]
        kind = samples.kind[g]
        total += w
        population += w * math.exp(samples.log_population[g])
        u += w * size
        uu += w * size * size
        v += w * kind
        vv += w * kind * kind
    u = u / total
    v = v / total
    size_scatter = math.sqrt(max(uu / total - u * u, 0.0))
    return Moments(best, population, u, size_scatter, v, math.sqrt(max(vv / total - v * v, 0.0)))


@numba.njit(cache=True)
def _median(value: FloatArray, weight: FloatArray) -> tuple[float, float]:
    """Return (median, half of the interval of 68.3 %) of weighted values, to some hundredths of that."""
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
    bins = np.empty(_BINS)
    sums = np.empty(_BINS)
    low = mean
    middle = mean
    high = mean
    for _ in range(3):  # again about the middle: few values that are far away make the scatter large
        bins[:] = 0.0
        sums[:] = 0.0
        per_bin = _BINS / (8.0 * scatter)
        for k in range(value.size):
            i = min(max(int((value[k] - mean) * per_bin + 0.5 * _BINS), 0), _BINS - 1)
            bins[i] += weight[k]
            sums[i] += weight[k] * value[k]
        below = 0.0
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
        mean = middle
        scatter = max(0.5 * (high - low), 1.0 / per_bin)
    return middle, 0.5 * (high - low)


@numba.njit(cache=True)
def _narrowed(
    profiles: FloatArray, normal: NormalEquations, maps: ProfileMaps, star: Point, coarse: Samples, fine: Samples
) -> Narrowed:
    """Return the samples of the part of the tables that contains the posterior; `coarse`, `fine`: of Scratch."""
    sizes, kinds = maps.gaap.shape
    samples = coarse
    du = 1.0
    dv = 1.0
    _coarse(maps, samples)
    moments = _moments(samples)
    for _ in range(LEVELS):
        u = moments.size
        v = moments.kind
        su = moments.size_scatter
        sv = moments.kind_scatter
        if (su > du and sv > dv) or star.log_probability - moments.best - math.log(moments.population) > STAR:
            break
        half_size = max(3.0 * su, 1.5 * du)
        half_kind = max(3.0 * sv, 1.5 * dv)
        region = Region(
            max(u - half_size, 0.0),
            min(u + half_size, sizes - 1.0),
            max(v - half_kind, 0.0),
            min(v + half_kind, kinds - 1.0),
        )
        du = (region.last_size - region.first_size) / (LATTICE - 1)
        dv = (region.last_kind - region.first_kind) / (LATTICE - 1)
        samples = fine
        _refine(profiles, normal, maps, region, samples)
        moments = _moments(samples)
    return Narrowed(samples, du * dv, moments)


@numba.njit(cache=True)
def posterior(
    profiles: FloatArray, normal: NormalEquations, maps: ProfileMaps, star: Point, scratch: Scratch
) -> SourceFlux:
    """Return the fluxes of a source; `profiles` (K, sizes x kinds); `scratch` is overwritten."""
    samples, area, moments = _narrowed(profiles, normal, maps, star, scratch.coarse, scratch.fine)
    n: int = samples.flux.size
    value = scratch.value[: n + 1]
    weight = scratch.weight[: n + 1]
    size = 0.0
    population = 0.0
    noise = 0.0
    gaap_noise = 0.0
    for g in range(n):
        log_relative = max(samples.log_probability[g] - moments.best, -2.0 * _NEGLIGIBLE)
        weight[g] = math.exp(log_relative + samples.log_population[g])
        value[g] = samples.flux[g]
        population += weight[g]
        size += weight[g] * samples.size[g]
        noise += weight[g] * samples.variance[g]
        gaap_noise += weight[g] * samples.variance[g] * samples.gaap[g] ** 2
    evidence = moments.best + math.log(area * population)
    odds = math.exp(min(star.log_probability - evidence, _CERTAIN))
    point = odds / (1.0 + odds)
    value[n] = star.flux
    weight[n] = odds * population
    noise = (1.0 - point) * noise / population + point * star.variance
    gaap_noise = (1.0 - point) * gaap_noise / population + point * star.variance
    _, spread = _median(value, weight)
    for g in range(n):
        value[g] *= samples.gaap[g]
    gaap, gaap_spread = _median(value, weight)
    total = 0.0
    for g in range(n):
        log_relative = samples.log_probability[g] - moments.best + POPULATION_POWER * samples.log_population[g]
        weight[g] = math.exp(max(log_relative, -2.0 * _NEGLIGIBLE))
        value[g] = samples.flux[g]
        total += weight[g]
    weight[n] = odds * total
    flux, _ = _median(value, weight)
    shape = (1.0 - point) * SHAPE_ERROR * flux
    error = math.sqrt(spread**2 + noise + shape**2)
    return SourceFlux(flux, error, gaap, math.sqrt(gaap_spread**2 + gaap_noise), size / population, point, evidence)
