"""Total fluxes: profiles behind the PSF fitted to the pixels of each source as a function of radius.

The model of a source is F P(r) + s: flux times a profile of `profile_tables`, and what is left of the sky, s,
which is 0 within SKY. For a given profile F is linear least squares over the usable pixels within a radius; pixels on
other sources' isophotes are left out. Profiles are linear in r^2 between nodes, so one pass over the pixels gives a
tridiagonal matrix and a vector, and these the chi2 and F of every profile. The weight of a ring of pixels is its
inverse variance: that of the background and of the ring's own mean light.

The posterior of F is over the tables' sizes and kinds of profile, the axis ratio being the measured one. Its prior is a
broad log-normal of the size, KIND_PRIOR, and POINT_SHARE for a point source, whose F is `flux_psf`. The total flux is
the median of the posterior to a power (SHARP), its error half the posterior's interval of 68.3 % and SHAPE_ERROR. The
posterior is skew at S/N 10: many of the profiles that fit are larger and brighter than the source, so its mean is
0.1 mag brighter than the median.

Left out: the source's ellipticity within the rings (the mean over the angle counts), and the light of neighbours
without an isophote.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING

import numba
import numpy as np

from csstsim.base.types import AnyArray, ComplexArray, FloatArray, IntArray
from csstsim.measure.detection.maps import BIN
from csstsim.measure.light.profile_posterior import LATTICE, posterior, project
from csstsim.measure.light.profile_tables import AXIS_RATIOS, REACH, SIZES

if TYPE_CHECKING:
    from csstsim.measure.detection.combine import Detections
    from csstsim.measure.light.profile_tables import ProfileTables

SKY = 0.03  # electron / px
# arcsec; of its logarithm
SIZE_PRIOR = 0.25
SIZE_SPREAD = 0.85
# Of profile_tables.KINDS. At S/N 10 the kind is hardly known: more weight for bulges makes discs too bright
KIND_PRIOR = np.array([0.3, 0.5, 1.0, 1.0, 1.0, 1.0, 1.0, 1.5, 2.6, 2.6])
POINT_SHARE = 0.27
TYPICAL_RATIO = 0.7  # axis ratio of a source without a measured one
# measured half-light radii, px: how far the pixels are used
RADIUS = 4.0
RADIUS_MIN = 14.0


def total_light(
    found: Detections, table: Mapping[str, AnyArray], unusable: IntArray, counted: FloatArray, tables: ProfileTables
) -> dict[str, FloatArray]:
    """Return {column: (n,)} of `combine.Detections`: flux_total, flux_gaap and their errors, half_light, point.

    `table`: has x, y (px of the chip), flux_psf, flux_psf_err and, of measure.light.moments, e and g_err; `unusable`
    (ny, nx), 0 for good; `counted` (n,) as in photometry.fit_sources; `tables`: ProfileTables. flux_gaap: electrons in
    a Gaussian aperture of GAAP_FWHM on the source before the PSF; half_light: arcsec, radius sqrt(a b) before the PSF;
    point: the posterior probability of a point. NaN where no pixel is usable.
    """
    ring = np.searchsorted(tables.nodes, 0.25 + 0.5 * np.arange(int(2.0 * tables.nodes[-1])), side="right") - 1
    prior = np.exp(-0.5 * (np.log(SIZES * tables.pixel / SIZE_PRIOR) / SIZE_SPREAD) ** 2)[:, None] * KIND_PRIOR
    prior = np.log((1.0 - POINT_SHARE) * prior / prior.sum())
    flux, error = (np.ascontiguousarray(table[name], float) for name in ("flux_psf", "flux_psf_err"))
    columns = fit_light(  # of contiguous columns: one compiled version
        found.image, found.rms, unusable, found.segments, found.segment, found.x, found.y,
        np.clip(RADIUS * found.half_light, RADIUS_MIN, REACH), counted,
        flux, error, tables.part(table["x"], table["y"]),
        _nearest_ratio(table["e"], table["g_err"]), tables.nodes, ring.astype(np.uint8), tables.point, tables.galaxy,
        tables.gaap, prior,
    ).T  # fmt: skip
    names = "flux_total", "flux_total_err", "flux_gaap", "flux_gaap_err", "half_light", "point"
    light = dict(zip(names, columns, strict=True))
    light["half_light"] = SIZES[0] * (SIZES[1] / SIZES[0]) ** light["half_light"] * tables.pixel
    return light


@np.errstate(invalid="ignore")  # NaN: no shape
def _nearest_ratio(e: ComplexArray, error: FloatArray) -> IntArray:
    """Return the index in AXIS_RATIOS of distortions, complex; their noise, which makes sources long, is taken off."""
    square = np.abs(e) ** 2
    noise = (error * (1.0 + np.sqrt(1.0 - square))) ** 2
    distortion = np.sqrt(np.clip(square - 2.0 * noise, 0.0, 1.0))
    ratio = np.sqrt((1.0 - distortion) / (1.0 + distortion))
    ratio = np.where(np.isfinite(ratio), ratio, TYPICAL_RATIO)
    return np.abs(np.log(np.maximum(ratio, AXIS_RATIOS[-1])[:, None] / AXIS_RATIOS)).argmin(axis=1)


@numba.njit(cache=True)
def _rings(
    image: FloatArray,
    unusable: IntArray,
    segments: IntArray,
    number: int,
    x: float,
    y: float,
    squares: FloatArray,
    inverse: FloatArray,
    which: IntArray,
    out: FloatArray,
) -> None:
    """Fill `out` (K - 1, 5) with n, sum t, sum t^2, sum d, sum t d of the usable pixels between `squares` (K,).

    t: 0 to 1 from one squared radius to the next; `inverse`: of their differences; `which`: the ring of r^2 in steps of
    1/2.
    """
    out[:] = 0.0
    ny, nx = image.shape
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
        lights = image[row, first:last]
        bad = unusable[row, first:last]
        others = segments[row // BIN]
        for col in range(max(last - first, 0)):
            r2 = (first + col - x) ** 2 + dy2
            other = others[(first + col) // BIN]
            d = float(lights[col])
            if r2 >= top or bad[col] or (other > 0 and other != number) or not abs(d) < math.inf:
                continue
            i = which[np.uint32(2.0 * r2)]
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
def _normal(rings: FloatArray, variance: float, counted: float, normal: FloatArray) -> float:
    """Fill `normal` (5, K): diagonal and upper diagonal of the matrix, data and ones projected on the nodes; the sky.

    The last row begins with the inverse variance of the sky and the sum of the weighted data. Returns the number of
    pixels.
    """
    normal[:] = 0.0
    diagonal, upper, data, ones, sky = normal
    pixels = 0.0
    sky[0] = SKY**-2
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
        sky[0] += w * n
        sky[1] += w * d
        pixels += n
    return pixels


@numba.njit(cache=True)
def fit_light(
    image: FloatArray,
    rms: FloatArray,
    unusable: IntArray,
    segments: IntArray,
    number: IntArray,
    x: FloatArray,
    y: FloatArray,
    radius: FloatArray,
    counted: FloatArray,
    flux_psf: FloatArray,
    flux_psf_err: FloatArray,
    part: IntArray,
    ratio: IntArray,
    nodes: FloatArray,
    which: IntArray,
    points: FloatArray,
    galaxies: FloatArray,
    gaap: FloatArray,
    prior: FloatArray,
) -> FloatArray:
    """Return (n, 6): total flux, error, Gaussian-aperture flux, error, size (steps of the tables), point.

    `image`, `rms` float32 (ny, nx), electron; `segments` on bins of BIN px; `number` (n,): each source's own; `x`, `y`,
    `radius` px of the frame; `part`, `ratio` (n,) and `nodes`, `points`, `galaxies`, `gaap` of `ProfileTables`;
    `which`: the ring of r^2 in steps of 1/2; `prior` (sizes, kinds): ln probability; the rest as in `total_light`.
    """
    _, sizes, kinds = gaap.shape
    ny, nx = image.shape
    out = np.full((x.size, 6), np.nan)
    rings = np.empty((nodes.size - 1, 5))
    normal = np.empty((5, nodes.size))
    maps = np.empty((4, sizes, kinds))
    star_fit = np.empty((3, 1))
    star = np.empty(3)
    coarse = np.empty((6, sizes * kinds))
    fine = np.empty((6, LATTICE**2))
    room = np.empty((2, max(sizes * kinds, LATTICE**2) + 1))
    inverse = 1.0 / (nodes[1:] - nodes[:-1])
    for s in range(x.size):
        if not (math.isfinite(x[s]) and math.isfinite(y[s]) and math.isfinite(radius[s])):
            continue
        count = min(np.searchsorted(nodes, radius[s] ** 2) + 1, nodes.size)
        _rings(image, unusable, segments, number[s], x[s], y[s], nodes[:count], inverse, which, rings[: count - 1])
        noise = float(rms[min(max(round(y[s]), 0), ny - 1), min(max(round(x[s]), 0), nx - 1)])
        equations = normal[:, :count]
        if not _normal(rings[: count - 1], noise * noise, counted[s], equations) > 0.0:
            continue
        profiles = galaxies[part[s], ratio[s], :count]
        project(profiles, equations, maps.reshape(4, -1)[:3])
        maps[2] = gaap[ratio[s]]
        maps[3] = prior
        project(points[part[s], :count], equations, star_fit)
        star[1], star[2] = star_fit[1, 0] / star_fit[0, 0], 1.0 / star_fit[0, 0]
        star[0] = 0.5 * star_fit[1, 0] * abs(star[1]) + math.log(POINT_SHARE)
        if math.isfinite(flux_psf[s]) and flux_psf_err[s] > 0.0:
            star[1], star[2] = flux_psf[s], flux_psf_err[s] ** 2
        posterior(profiles, equations, maps, star, coarse, fine, room, out[s])
    return out
