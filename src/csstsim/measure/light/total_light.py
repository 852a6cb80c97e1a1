"""Total fluxes: profiles convolved with the PSF, fitted to the pixels of each source as a function of radius.

The model of a source is F P(r) + s: flux times a profile of `profile_tables`, and the residual sky s, whose prior is
0 +- SKY. For a given profile, F is linear least squares over the usable pixels within a radius; pixels on other
sources' isophotes are left out. Profiles are linear in r^2 between nodes, so one pass over the pixels gives a
tridiagonal matrix and a vector, and these give the chi2 and F of every profile. The weight of a ring of pixels is its
inverse variance: that of the background and of the mean flux in the ring.

The posterior of F is over the sizes and kinds of profile of the tables, at the measured axis ratio, each nearly as
likely as any other before the fit (profile_posterior says why), and over a point source, whose F is `flux_psf`. How
likely a point is follows from the sizes and kinds of the population: a log-normal of the size, the fractions of the
tables' family and POINT_FRACTION. The total flux is the median of the posterior. Its error is half the interval of
68.3 % of the posterior with the population, and SHAPE_ERROR. The posterior is skew at S/N 10: many of the profiles that
fit are larger and brighter than the source, so its mean is 0.1 mag brighter than the median.

Left out: the source's ellipticity within the rings (the mean over the angle is used).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, NamedTuple

import numba
import numpy as np

from csstsim.base.types import AnyArray, BoolArray, ComplexArray, FloatArray, IntArray
from csstsim.measure.detection.maps import BIN
from csstsim.measure.light.pixels import Pixels
from csstsim.measure.light.profile_posterior import (
    LATTICE,
    NormalEquations,
    Point,
    ProfileFits,
    ProfileMaps,
    Samples,
    Scratch,
    posterior,
    project,
)
from csstsim.measure.light.profile_tables import AXIS_RATIOS, REACH, SIZES

if TYPE_CHECKING:
    from csstsim.measure.detection.combine import Detections
    from csstsim.measure.light.profile_tables import ProfileTables

# electron / px; for models, whose wings would otherwise be the light of faint stars between crowded ones
SKY = 0.03
MODEL_SKY = 5.0
# Half-light radii of the population: arcsec; standard deviation of ln, a little more than that of one S/N (0.6)
POPULATION_SIZE = 0.25
POPULATION_SPREAD = 0.65
POINT_FRACTION = 0.27
TYPICAL_RATIO = 0.7  # axis ratio of a source without a measured one
# radius of the pixels that are used: measured half-light radii; px
RADIUS_FACTOR = 4.0
RADIUS_MIN = 14.0


class LightSources(NamedTuple):
    """The sources (n,) whose light is fitted.

    `number`: isophote of each source; `x`, `y`, `radius`: px of the frame; `counted` as in photometry.fit_sources;
    `flux_psf`, `flux_psf_err`: electron, of the PSF's fit; `part`, `ratio`: indices of the tables' parts and of
    AXIS_RATIOS.
    """

    number: IntArray
    x: FloatArray
    y: FloatArray
    radius: FloatArray
    counted: FloatArray
    flux_psf: FloatArray
    flux_psf_err: FloatArray
    part: IntArray
    ratio: IntArray


class ProfileArrays(NamedTuple):
    """Arrays of `ProfileTables`; `ring_of`: the ring of r^2 in steps of 1/2; `log_population` (sizes, kinds)."""

    nodes: FloatArray
    ring_of: IntArray
    point: FloatArray
    galaxy: FloatArray
    gaap: FloatArray
    log_population: FloatArray


class TotalLight(NamedTuple):
    """Columns (n,) of `total_light`; `half_light` in steps of the tables until it is in arcsec.

    `evidence`: ln of the probability of the pixels as a galaxy of the tables' family, less that of the sky alone.
    """

    flux_total: FloatArray
    flux_total_err: FloatArray
    flux_gaap: FloatArray
    flux_gaap_err: FloatArray
    half_light: FloatArray
    point: FloatArray
    evidence: FloatArray


class LightModels(NamedTuple):
    """The most probable profile of each source (n,), for its neighbours.

    `flux`: electron, 0 where no pixel is usable; `profile` (n, K): per px^2 at the nodes of the tables, for a flux of
    1, of a round source; `point`: whether it is that of a point.
    """

    flux: FloatArray
    profile: FloatArray
    point: BoolArray


def total_light(
    found: Detections, table: Mapping[str, AnyArray], unusable: IntArray, counted: FloatArray, tables: ProfileTables
) -> dict[str, FloatArray]:
    """Return {column: (n,)} of `combine.Detections`, those of TotalLight.

    `table`: has x, y (px of the chip), flux_psf, flux_psf_err and, of measure.light.moments, e and g_err; `unusable`
    (ny, nx), 0 for good; `counted` (n,) as in photometry.fit_sources; `tables`: ProfileTables. flux_gaap: electrons in
    a Gaussian aperture of GAAP_FWHM on the source before the PSF; half_light: arcsec, radius sqrt(a b) before the PSF;
    point: the posterior probability of a point. NaN where no pixel is usable.
    """
    pixels = Pixels(found.image, found.rms, unusable, found.segments)
    light = fit_light(pixels, _light_sources(found, table, counted, tables), _profile_arrays(tables))
    smallest, next_size = SIZES[:2]
    half_light = smallest * (next_size / smallest) ** light.half_light * tables.pixel
    return light._asdict() | {"half_light": half_light}


def light_models(
    found: Detections, table: Mapping[str, AnyArray], unusable: IntArray, counted: FloatArray, tables: ProfileTables
) -> LightModels:
    """Return the LightModels of `combine.Detections`; arguments as of `total_light`."""
    pixels = Pixels(found.image, found.rms, unusable, found.segments)
    return fit_models(pixels, _light_sources(found, table, counted, tables), _profile_arrays(tables))


def _light_sources(
    found: Detections, table: Mapping[str, AnyArray], counted: FloatArray, tables: ProfileTables
) -> LightSources:
    return LightSources(
        number=found.segment,
        x=found.x,
        y=found.y,
        radius=np.clip(RADIUS_FACTOR * found.half_light, RADIUS_MIN, REACH),
        counted=counted,
        flux_psf=np.ascontiguousarray(table["flux_psf"], float),  # contiguous: one compiled version
        flux_psf_err=np.ascontiguousarray(table["flux_psf_err"], float),
        part=tables.part(table["x"], table["y"]),
        ratio=_nearest_ratio(table["e"], table["g_err"]),
    )


def _profile_arrays(tables: ProfileTables) -> ProfileArrays:
    ring = np.searchsorted(tables.nodes, 0.25 + 0.5 * np.arange(int(2.0 * tables.nodes[-1])), side="right") - 1
    population = (
        np.exp(-0.5 * (np.log(SIZES * tables.pixel / POPULATION_SIZE) / POPULATION_SPREAD) ** 2)[:, None]
        * tables.family.fractions
    )
    log_population = np.log((1.0 - POINT_FRACTION) * population / population.sum())
    return ProfileArrays(tables.nodes, ring.astype(np.uint8), tables.point, tables.galaxy, tables.gaap, log_population)


@np.errstate(invalid="ignore")  # NaN: no shape
def _nearest_ratio(e: ComplexArray, error: FloatArray) -> IntArray:
    """Return the index in AXIS_RATIOS of complex distortions, corrected for noise, which makes sources elongated."""
    square = np.abs(e) ** 2
    noise = (error * (1.0 + np.sqrt(1.0 - square))) ** 2
    distortion = np.sqrt(np.clip(square - 2.0 * noise, 0.0, 1.0))
    ratio = np.sqrt((1.0 - distortion) / (1.0 + distortion))
    ratio = np.where(np.isfinite(ratio), ratio, TYPICAL_RATIO)
    return np.abs(np.log(np.maximum(ratio, AXIS_RATIOS[-1])[:, None] / AXIS_RATIOS)).argmin(axis=1)


@numba.njit(cache=True)
def _rings(
    pixels: Pixels, number: int, x: float, y: float, squares: FloatArray, ring_of: IntArray, out: FloatArray
) -> None:
    """Fill `out` (K - 1, 5) with n, sum t, sum t^2, sum d, sum t d of the usable pixels between `squares` (K,).

    t: 0 to 1 from one squared radius to the next; `ring_of`: the ring of r^2 in steps of 1/2.
    """
    out[:] = 0.0
    inverse = 1.0 / (squares[1:] - squares[:-1])
    ny, nx = pixels.image.shape
    top = squares[-1]
    reach = math.sqrt(top)
    for row in range(max(math.ceil(y - reach), 0), min(math.floor(y + reach) + 1, ny)):
        dy2 = (row - y) ** 2
        half = math.sqrt(max(top - dy2, 0.0))
        ring = 0
        n = 0.0
        st = 0.0
        stt = 0.0
        sd = 0.0
        std = 0.0
        first = max(math.ceil(x - half), 0)
        last = min(math.floor(x + half) + 1, nx)
        electrons = pixels.image[row, first:last]
        bad = pixels.unusable[row, first:last]
        row_segments = pixels.segments[row // BIN]
        for col in range(max(last - first, 0)):
            r2 = (first + col - x) ** 2 + dy2
            isophote = row_segments[(first + col) // BIN]
            d = float(electrons[col])
            if r2 >= top or bad[col] or (isophote > 0 and isophote != number) or not abs(d) < math.inf:
                continue
            i = ring_of[np.uint32(2.0 * r2)]
            if i != ring:  # sums in registers are twice as fast as in the array
                _add(out[ring], n, st, stt, sd, std)
                ring = i
                n = 0.0
                st = 0.0
                stt = 0.0
                sd = 0.0
                std = 0.0
            t = (r2 - squares[i]) * inverse[i]
            n += 1.0
            st += t
            stt += t * t
            sd += d
            std += t * d
        _add(out[ring], n, st, stt, sd, std)


@numba.njit(cache=True, inline="always")
def _add(ring: FloatArray, n: float, t: float, tt: float, d: float, td: float) -> None:
    ring[0] += n
    ring[1] += t
    ring[2] += tt
    ring[3] += d
    ring[4] += td


@numba.njit(cache=True)
def _normal(rings: FloatArray, variance: float, counted: float, arrays: FloatArray, sky: float) -> NormalEquations:
    """Return the NormalEquations of `rings` (K - 1, 5) of `_rings`; `arrays` (4, K): theirs, overwritten."""
    arrays[:] = 0.0
    diagonal, upper, data, ones = arrays
    sky_weight = sky**-2
    sky_data = 0.0
    pixels = 0.0
    for i in range(len(rings)):
        n, t, t2, d, td = rings[i]
        if n == 0.0:
            continue
        w = 1.0 / (variance + max(d / n, 0.0) / counted)
        diagonal[i] += w * (n - 2.0 * t + t2)
        diagonal[i + 1] += w * t2
        upper[i] += w * (t - t2)
        data[i] += w * (d - td)
        data[i + 1] += w * td
        ones[i] += w * (n - t)
        ones[i + 1] += w * t
        sky_weight += w * n
        sky_data += w * d
        pixels += n
    return NormalEquations(diagonal, upper, data, ones, sky_weight, sky_data, pixels)


@numba.njit(cache=True)
def _samples(count: int) -> Samples:
    """Return Samples with arrays of length `count`."""
    return Samples(
        np.empty(count),
        np.empty(count),
        np.empty(count),
        np.empty(count),
        np.empty(count),
        np.empty(count),
        np.empty(count),
    )


@numba.njit(cache=True)
def _nothing(count: int) -> TotalLight:
    """Return the columns of `count` sources, all NaN."""
    return TotalLight(
        np.full(count, np.nan),
        np.full(count, np.nan),
        np.full(count, np.nan),
        np.full(count, np.nan),
        np.full(count, np.nan),
        np.full(count, np.nan),
        np.full(count, np.nan),
    )


@numba.njit(cache=True)
def fit_light(pixels: Pixels, sources: LightSources, tables: ProfileArrays) -> TotalLight:
    """Return the columns of `total_light`, half_light in steps of the tables."""
    nodes = tables.nodes
    _, sizes, kinds = tables.gaap.shape
    profile_count = sizes * kinds
    out = _nothing(sources.x.size)
    rings = np.empty((nodes.size - 1, 5))
    normal_arrays = np.empty((4, nodes.size))
    fits = ProfileFits(np.empty(profile_count), np.empty(profile_count), np.empty(profile_count))
    point_fit = ProfileFits(np.empty(1), np.empty(1), np.empty(1))
    sample_count = max(profile_count, LATTICE**2) + 1
    scratch = Scratch(_samples(profile_count), _samples(LATTICE**2), np.empty(sample_count), np.empty(sample_count))
    for s in range(sources.x.size):
        normal = _normal_equations(pixels, sources, s, tables, rings, normal_arrays, SKY)
        if not normal.pixels > 0.0:
            continue
        count = normal.data.size
        ratio = sources.ratio[s]
        profiles = tables.galaxy[sources.part[s], ratio, :count]
        project(profiles, normal, fits)
        maps = ProfileMaps(
            fits.weight.reshape(sizes, kinds),
            fits.product.reshape(sizes, kinds),
            tables.gaap[ratio],
            tables.log_population,
        )
        project(tables.point[sources.part[s], :count], normal, point_fit)
        log_probability, flux = _as_point(point_fit)
        variance = 1.0 / point_fit.weight[0]
        if math.isfinite(sources.flux_psf[s]) and sources.flux_psf_err[s] > 0.0:
            flux = sources.flux_psf[s]
            variance = sources.flux_psf_err[s] ** 2
        result = posterior(profiles, normal, maps, Point(log_probability, flux, variance), scratch)
        out.flux_total[s] = result.total
        out.flux_total_err[s] = result.total_error
        out.flux_gaap[s] = result.gaap
        out.flux_gaap_err[s] = result.gaap_error
        out.half_light[s] = result.size
        out.point[s] = result.point
        out.evidence[s] = result.evidence
    return out


@numba.njit(cache=True)
def fit_models(pixels: Pixels, sources: LightSources, tables: ProfileArrays) -> LightModels:
    """Return the LightModels of sources."""
    n = sources.x.size
    nodes = tables.nodes
    profile_count = tables.galaxy.shape[3]
    out = LightModels(np.zeros(n), np.zeros((n, nodes.size)), np.zeros(n, np.bool_))
    rings = np.empty((nodes.size - 1, 5))
    normal_arrays = np.empty((4, nodes.size))
    fits = ProfileFits(np.empty(profile_count), np.empty(profile_count), np.empty(profile_count))
    point_fit = ProfileFits(np.empty(1), np.empty(1), np.empty(1))
    prior = tables.log_population.ravel()
    for s in range(n):
        normal = _normal_equations(pixels, sources, s, tables, rings, normal_arrays, MODEL_SKY)
        if not normal.pixels > 0.0:
            continue
        count = normal.data.size
        part = sources.part[s]
        galaxy = tables.galaxy[part, sources.ratio[s]]
        round_ones = tables.galaxy[part, 0]
        project(galaxy[:count], normal, fits)
        project(tables.point[part, :count], normal, point_fit)
        best, flux = _as_point(point_fit)
        out.point[s] = True
        out.profile[s] = tables.point[part, :, 0]
        for k in range(profile_count):
            fitted = fits.product[k] / fits.weight[k]
            log_probability = 0.5 * fits.product[k] * abs(fitted) + prior[k]
            if log_probability > best:
                best = log_probability
                flux = fitted
                out.point[s] = False
                out.profile[s] = round_ones[:, k]
        out.flux[s] = max(flux, 0.0)
    return out


@numba.njit(cache=True)
def _normal_equations(
    pixels: Pixels,
    sources: LightSources,
    s: int,
    tables: ProfileArrays,
    rings: FloatArray,
    arrays: FloatArray,
    sky: float,
) -> NormalEquations:
    """Return the NormalEquations of source s, with 0 pixels if its position is not known; scratch is overwritten.

    sky: the residual sky's prior sigma, electron / px.
    """
    nodes = tables.nodes
    x = sources.x[s]
    y = sources.y[s]
    radius = sources.radius[s]
    if not (math.isfinite(x) and math.isfinite(y) and math.isfinite(radius)):
        return _normal(rings[:0], float(np.float32(1.0)), 1.0, arrays[:, :1], sky)  # one compiled version
    ny, nx = pixels.image.shape
    count = min(np.searchsorted(nodes, radius**2) + 1, nodes.size)
    inner = rings[: count - 1]
    _rings(pixels, sources.number[s], x, y, nodes[:count], tables.ring_of, inner)
    noise = float(pixels.rms[min(max(round(y), 0), ny - 1) // BIN, min(max(round(x), 0), nx - 1) // BIN])
    return _normal(inner, noise * noise, sources.counted[s], arrays[:, :count], sky)


@numba.njit(cache=True)
def _as_point(fit: ProfileFits) -> tuple[float, float]:
    """Return (ln probability, flux) of a source as a point."""
    flux = fit.product[0] / fit.weight[0]
    return 0.5 * fit.product[0] * abs(flux) + math.log(POINT_FRACTION), flux
