"""Convergence and shear by haloes, summed pair by pair, with the exact distances of halo and source (halo_profile).

    kappa = 3/2 Om (H0 / c)^2 (1 + z_h) chi_h (1 - chi_h / chi_s) V Sigma / M,   V = M mu / rho    (comoving)

Radii are chords on the unit sphere times chi_h. In these radii areas on the sphere are flat. So the masses of a halo
and of its disc cancel exactly, and gamma_t = mean (1 - g) / (1 - g / 2) - kappa with g = chord^2 / 2 has no B mode.
Born approximation.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numba import njit

from csstsim.base.sphere import frames
from csstsim.base.types import AnyArray, FloatArray, IntArray
from csstsim.universe.structure.halo_profile import disc_radius, nfw_mass, nfw_projected, whole_mass

if TYPE_CHECKING:
    from csstsim.universe.structure.mass_function import HaloMassFunction

_BUCKET = np.radians(1.4 / 60)  # side of the squares into which sources are sorted


class HaloLenses(NamedTuple):
    """Haloes for `halo_shear`, one row each.

    direction (n, 3): unit vectors; chi (n,) [Mpc]; strength (n,): kappa x chord^2; disc, scale (n,): radius of the
    disc and scale radius [rad]; cuts (n, cuts): radii at which the density ends, over the scale radius.
    """

    direction: FloatArray
    chi: FloatArray
    strength: FloatArray
    disc: FloatArray
    scale: FloatArray
    cuts: FloatArray


class _Sources(NamedTuple):
    """Sums and frames of sources (n,): kappa, gamma1, gamma2; unit vectors to their east and north; 1 / distance."""

    kappa: FloatArray
    gamma1: FloatArray
    gamma2: FloatArray
    e0: FloatArray
    e1: FloatArray
    e2: FloatArray
    n0: FloatArray
    n1: FloatArray
    n2: FloatArray
    inverse: FloatArray


class _Buckets(NamedTuple):
    """Square buckets of `side` [rad] with the sources, `columns` in a row.

    start (buckets + 1,): first source of each, and the end; x, y (lenses,): position of a lens [buckets]; toward
    (lenses,): component of its direction along the middle of the sources.
    """

    start: IntArray
    columns: int
    side: float
    x: FloatArray
    y: FloatArray
    toward: FloatArray


class _Lens(NamedTuple):
    """One row of HaloLenses: its direction p, and the squares of the radii of the disc and the widest sphere [rad]."""

    p0: float
    p1: float
    p2: float
    chi: float
    strength: float
    scale: float
    disc2: float
    sphere2: float


def halo_lenses(
    haloes: Mapping[str, AnyArray], mass_function: HaloMassFunction, numbers: Mapping[str, Any]
) -> HaloLenses:
    """Return HaloLenses of the columns of haloes.Haloes; numbers: section haloes of structure.yaml."""
    ra = np.radians(haloes["ra"])
    dec = np.radians(haloes["dec"])
    mass = 10 ** haloes["log_mass"]
    concentration = np.asarray(haloes["concentration"])
    cosmology = mass_function.cosmology
    chi = cosmology.comoving_distance(haloes["z"])
    strength = 1.5 * cosmology.omega_m / cosmology.hubble_distance**2 * (1 + haloes["z"])
    strength = strength * mass * whole_mass(concentration, numbers["cuts"]) / mass_function.density / (np.pi * chi)
    disc = disc_radius(mass_function, mass, numbers) / chi
    scale = mass_function.virial_radius(mass) / chi / concentration
    direction = np.ascontiguousarray(frames(ra, dec)[0])
    return HaloLenses(direction, chi, strength, disc, scale, np.outer(concentration, numbers["cuts"]))


def halo_shear(lenses: HaloLenses, ra: FloatArray, dec: FloatArray, chi: FloatArray) -> FloatArray:
    """Return kappa, gamma1, gamma2 (n,) by `lenses` (halo_lenses) of sources at ra, dec [deg] and distance chi [Mpc].

    Sources at chi <= 0 or NaN are not lensed. Axes: east, north. Sources lie within a few degrees of each other.
    """
    n, east, north = frames(np.radians(ra), np.radians(dec))
    out = np.zeros((3, len(chi)))
    if len(chi) == 0 or len(lenses.chi) == 0:
        return out
    middle = n.mean(axis=0) / np.linalg.norm(n.mean(axis=0))
    x_axis = np.cross(middle, np.eye(3)[np.argmin(np.abs(middle))])
    x_axis /= np.linalg.norm(x_axis)
    plane = np.stack([x_axis, np.cross(middle, x_axis)])  # x, y of a unit vector: projected along the middle
    position = np.einsum("nk,ak->na", n, plane)
    corner = position.min(axis=0)
    columns, rows = ((np.ptp(position, axis=0) / _BUCKET).astype(int) + 1).tolist()
    bucket = ((position - corner) / _BUCKET).astype(int) @ [1, columns]
    inverse = np.divide(1.0, chi, out=np.full(len(chi), np.inf), where=np.asarray(chi) > 0)
    ranked = np.lexsort([inverse, bucket])
    sums = np.zeros((3, len(chi)))
    kappa, gamma1, gamma2 = sums
    e0, e1, e2 = np.take(east.T, ranked, axis=1)
    n0, n1, n2 = np.take(north.T, ranked, axis=1)
    sources = _Sources(kappa, gamma1, gamma2, e0, e1, e2, n0, n1, n2, inverse[ranked])
    along, across, toward = np.einsum("nk,ak->an", lenses.direction, np.stack([*plane, middle]))
    buckets = _Buckets(
        start=np.searchsorted(bucket[ranked], np.arange(rows * columns + 1)),
        columns=columns,
        side=_BUCKET,
        x=(along - corner[0]) / _BUCKET,
        y=(across - corner[1]) / _BUCKET,
        toward=toward,
    )
    _add(sources, buckets, lenses)
    out[:, ranked] = sums
    return out


@njit(cache=True)
def _add(sources: _Sources, buckets: _Buckets, lenses: HaloLenses) -> None:
    """Add every lens to the sums of `sources`, which are sorted by bucket and, in it, from the farthest on."""
    count = len(lenses.chi)
    masses = nfw_mass(lenses.cuts)
    sphere = np.empty(count)
    for h in range(count):
        sphere[h] = lenses.scale[h] * lenses.cuts[h].max()
    for cell in range(len(buckets.start) - 1):  # the sources of a bucket stay in the cache for all lenses
        members = _bucket_sources(sources, buckets.start[cell], buckets.start[cell + 1])
        for h in range(count):
            aside_x = abs(cell % buckets.columns + 0.5 - buckets.x[h]) - 0.5
            aside_y = abs(cell // buckets.columns + 0.5 - buckets.y[h]) - 0.5
            # a projected radius is at most the chord
            gap = np.hypot(max(aside_x, 0.0), max(aside_y, 0.0)) * buckets.side
            if gap >= lenses.disc[h] or buckets.toward[h] < 0:
                continue
            behind = np.searchsorted(members.inverse, 1 / lenses.chi[h])
            p0, p1, p2 = lenses.direction[h]
            lens = _Lens(
                p0,
                p1,
                p2,
                lenses.chi[h],
                lenses.strength[h],
                lenses.scale[h],
                lenses.disc[h] ** 2,
                sphere[h] ** 2,
            )
            _disc(members, behind, lens)
            if gap < sphere[h]:
                _sphere(members, behind, lens, lenses.cuts[h], masses[h])


@njit(inline="always")
def _bucket_sources(sources: _Sources, first: int, end: int) -> _Sources:
    """Return the sources of one bucket, as views."""
    return _Sources(
        sources.kappa[first:end],
        sources.gamma1[first:end],
        sources.gamma2[first:end],
        sources.e0[first:end],
        sources.e1[first:end],
        sources.e2[first:end],
        sources.n0[first:end],
        sources.n1[first:end],
        sources.n2[first:end],
        sources.inverse[first:end],
    )


@njit(cache=True, error_model="numpy")
def _disc(sources: _Sources, behind: int, lens: _Lens) -> None:
    """Add the disc, and outside the widest sphere also the mass of all spheres."""
    per_disc2 = 1 / lens.disc2
    for i in range(behind):
        a, b = _components(sources, i, lens)
        square, chord2 = _separation(a, b)
        q = max(1 - chord2 * per_disc2, 0.0)
        q2 = q * q
        inverse_square = 1 / square
        weight = lens.strength * (1 - lens.chi * sources.inverse[i])
        half = 1 - 0.25 * chord2
        kappa = -4 * per_disc2 * q * q2
        mean = -per_disc2 * (1 + q) * (1 + q2) if chord2 < lens.sphere2 else q2 * q2 * inverse_square * half
        tangential = weight * inverse_square * (mean * (2 * half - 1) * inverse_square * chord2 - kappa)
        _add_shear(sources, i, weight * kappa, tangential, a, b)


@njit(cache=True, error_model="numpy")
def _sphere(sources: _Sources, behind: int, lens: _Lens, cuts: FloatArray, masses: FloatArray) -> None:
    """Add the spheres to the sources within them."""
    inner = 1 / (2 * lens.scale * lens.scale * masses.sum())
    for i in range(behind):
        a, b = _components(sources, i, lens)
        square, chord2 = _separation(a, b)
        if chord2 >= lens.sphere2:
            continue
        f, g = nfw_projected(np.sqrt(chord2) / lens.scale, cuts, masses)
        weight = lens.strength * (1 - lens.chi * sources.inverse[i]) * inner
        inverse_square = 1 / square
        tangential = weight * inverse_square * ((f + g) * (1 - 0.5 * chord2) * inverse_square * chord2 - f)
        _add_shear(sources, i, weight * f, tangential, a, b)


@njit(inline="always")
def _components(sources: _Sources, i: int, lens: _Lens) -> tuple[float, float]:
    """Return the components of a lens along the east and north of source i."""
    a = lens.p0 * sources.e0[i] + lens.p1 * sources.e1[i] + lens.p2 * sources.e2[i]
    b = lens.p0 * sources.n0[i] + lens.p1 * sources.n1[i] + lens.p2 * sources.n2[i]
    return a, b


@njit(inline="always")
def _add_shear(sources: _Sources, i: int, kappa: float, tangential: float, a: float, b: float) -> None:
    """Add kappa and the shear of a lens with components a, b to source i; tangential: over a^2 + b^2."""
    sources.kappa[i] += kappa
    sources.gamma1[i] -= tangential * (a * a - b * b)
    sources.gamma2[i] -= tangential * 2 * a * b


@njit(inline="always")
def _separation(a: float, b: float) -> tuple[float, float]:
    """Return s = a^2 + b^2 and the square of the chord c between lens and source: s = c^2 (1 - c^2 / 4).

    a, b: components of the lens along the source's east and north.
    """
    square = max(a * a + b * b, 1e-30)
    return square, 2 * square / (1 + np.sqrt(1 - min(square, 1.0)))
