"""Convergence and shear by haloes, summed pair by pair, with the exact distances of halo and source (halo_profile).

    kappa = 3/2 Om (H0 / c)^2 (1 + z_h) chi_h (1 - chi_h / chi_s) V Sigma / M,   V = M mu / rho    (comoving)

Radii are chords on the unit sphere times chi_h. In them areas on the sphere are flat, so the halo's mass and that of
its disc cancel exactly, and gamma_t = mean (1 - g) / (1 - g / 2) - kappa with g = chord^2 / 2 has no B mode. Born.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from numba import njit

from csstsim.base.sphere import frames
from csstsim.base.types import AnyArray, FloatArray, IntArray
from csstsim.universe.structure.halo_profile import disc_radius, nfw_mass, nfw_projected, whole_mass

if TYPE_CHECKING:
    from csstsim.universe.structure.mass_function import HaloMassFunction

_BUCKET = np.radians(1.4 / 60)  # side of the squares into which sources are sorted


def halo_lenses(
    haloes: Mapping[str, AnyArray], mass_function: HaloMassFunction, numbers: Mapping[str, Any]
) -> FloatArray:
    """Return what `halo_shear` needs of haloes (n, 7 + cuts); numbers: section haloes of structure.yaml.

    haloes: the columns of haloes.Haloes. Columns: direction (3), chi [Mpc], strength (kappa x chord^2), radius of the
    disc and scale radius [rad], and the radii at which the density ends, over the scale radius.
    """
    a = np.radians(haloes["ra"])
    d = np.radians(haloes["dec"])
    mass = 10 ** haloes["log_mass"]
    c = np.asarray(haloes["concentration"])
    cosmology = mass_function.cosmology
    chi = cosmology.comoving_distance(haloes["z"])
    strength = 1.5 * cosmology.omega_m / cosmology.hubble_distance**2 * (1 + haloes["z"])
    strength = strength * mass * whole_mass(c, numbers["cuts"]) / mass_function.density / (np.pi * chi)
    disc = disc_radius(mass_function, mass, numbers) / chi
    scale = mass_function.virial_radius(mass) / chi / c
    return np.column_stack([frames(a, d)[0], chi, strength, disc, scale, np.outer(c, numbers["cuts"])])


def halo_shear(lenses: FloatArray, ra: FloatArray, dec: FloatArray, chi: FloatArray) -> FloatArray:
    """Return kappa, gamma1, gamma2 (n,) by `lenses` (halo_lenses) of sources at ra, dec [deg] and distance chi [Mpc].

    Sources at chi <= 0 or NaN are not lensed. Axes: east, north. Sources lie within a few degrees of each other.
    """
    n, east, north = frames(np.radians(ra), np.radians(dec))
    out = np.zeros((3, len(chi)))
    if len(chi) == 0 or len(lenses) == 0:
        return out
    middle = n.mean(axis=0) / np.linalg.norm(n.mean(axis=0))
    first = np.cross(middle, np.eye(3)[np.argmin(np.abs(middle))])
    first /= np.linalg.norm(first)
    plane = np.stack([first, np.cross(middle, first)])  # x, y of a unit vector: projected along the middle
    place = np.einsum("nk,ak->na", n, plane)
    corner = place.min(axis=0)
    columns, rows = ((np.ptp(place, axis=0) / _BUCKET).astype(int) + 1).tolist()
    bucket = ((place - corner) / _BUCKET).astype(int) @ [1, columns]
    inverse = np.divide(1.0, chi, out=np.full(len(chi), np.inf), where=np.asarray(chi) > 0)
    ranked = np.lexsort([inverse, bucket])
    starts = np.searchsorted(bucket[ranked], np.arange(rows * columns + 1))
    at = np.take(np.concatenate([east.T, north.T]), ranked, axis=1)
    inverse = inverse[ranked]
    sums = np.zeros((3, len(chi)))
    along, across, toward = np.einsum("nk,ak->an", lenses[:, :3], np.stack([*plane, middle]))
    centres = np.column_stack([(along - corner[0]) / _BUCKET, (across - corner[1]) / _BUCKET, toward])
    _add(sums, at, inverse, starts, columns, lenses, centres, _BUCKET)
    out[:, ranked] = sums
    return out


@njit(cache=True)
def _add(
    sums: FloatArray,
    at: FloatArray,
    inverse: FloatArray,
    starts: IntArray,
    columns: int,
    lenses: FloatArray,
    centres: FloatArray,
    bucket: float,
) -> None:
    """Add every lens to sums (3, sources); sources are sorted by bucket, the farthest first, `starts` of each."""
    disc = lenses[:, 5]
    cuts = lenses[:, 7:]
    masses = nfw_mass(cuts)
    sphere = np.empty(len(lenses))
    for h in range(len(lenses)):
        sphere[h] = lenses[h, 6] * cuts[h].max()
    for cell in range(len(starts) - 1):  # a bucket's sources stay close to the processor for all lenses
        here = slice(starts[cell], starts[cell + 1])
        added = (sums[0, here], sums[1, here], sums[2, here])
        far = inverse[here]
        east = (at[0, here], at[1, here], at[2, here])
        north = (at[3, here], at[4, here], at[5, here])
        for h in range(len(lenses)):
            aside = abs(cell % columns + 0.5 - centres[h, 0]) - 0.5, abs(cell // columns + 0.5 - centres[h, 1]) - 0.5
            gap = np.hypot(max(aside[0], 0.0), max(aside[1], 0.0)) * bucket  # a projected radius is at most the chord
            if gap >= disc[h] or centres[h, 2] < 0:
                continue
            behind = np.searchsorted(far, 1 / lenses[h, 3])
            _disc(added, east, north, far, behind, lenses[h, :6], disc[h] ** 2, sphere[h] ** 2)
            if gap < sphere[h]:
                _sphere(added, east, north, far, behind, lenses[h, :7], cuts[h], masses[h])


@njit(cache=True, error_model="numpy")
def _disc(
    added: tuple[FloatArray, FloatArray, FloatArray],
    east: tuple[FloatArray, FloatArray, FloatArray],
    north: tuple[FloatArray, FloatArray, FloatArray],
    inverse: FloatArray,
    behind: int,
    lens: FloatArray,
    disc2: float,
    sphere2: float,
) -> None:
    """Add what is not in the spheres: the disc, and outside of them their mass."""
    (kappas, shear1, shear2), (e0, e1, e2), (n0, n1, n2) = added, east, north
    p0, p1, p2, chi, strength, _ = lens
    per_disc2 = 1 / disc2
    for i in range(behind):
        a = p0 * e0[i] + p1 * e1[i] + p2 * e2[i]
        b = p0 * n0[i] + p1 * n1[i] + p2 * n2[i]
        square, chord2 = _apart(a, b)
        q = max(1 - chord2 * per_disc2, 0.0)
        q2 = q * q
        both = 1 / square
        weight = strength * (1 - chi * inverse[i])
        half = 1 - 0.25 * chord2
        kappa = -4 * per_disc2 * q * q2
        mean = -per_disc2 * (1 + q) * (1 + q2) if chord2 < sphere2 else q2 * q2 * both * half
        tangential = weight * both * (mean * (2 * half - 1) * both * chord2 - kappa)
        kappas[i] += weight * kappa
        shear1[i] -= tangential * (a * a - b * b)
        shear2[i] -= tangential * 2 * a * b


@njit(cache=True, error_model="numpy")
def _sphere(
    added: tuple[FloatArray, FloatArray, FloatArray],
    east: tuple[FloatArray, FloatArray, FloatArray],
    north: tuple[FloatArray, FloatArray, FloatArray],
    inverse: FloatArray,
    behind: int,
    lens: FloatArray,
    cuts: FloatArray,
    masses: FloatArray,
) -> None:
    """Add the spheres to the sources within them."""
    (kappas, shear1, shear2), (e0, e1, e2), (n0, n1, n2) = added, east, north
    p0, p1, p2, chi, strength, _, scale = lens
    inner = 1 / (2 * scale * scale * masses.sum())
    sphere2 = (scale * cuts.max()) ** 2
    for i in range(behind):
        a = p0 * e0[i] + p1 * e1[i] + p2 * e2[i]
        b = p0 * n0[i] + p1 * n1[i] + p2 * n2[i]
        square, chord2 = _apart(a, b)
        if chord2 >= sphere2:
            continue
        f, g = nfw_projected(np.sqrt(chord2) / scale, cuts, masses)
        weight = strength * (1 - chi * inverse[i]) * inner
        both = 1 / square
        tangential = weight * both * ((f + g) * (1 - 0.5 * chord2) * both * chord2 - f)
        kappas[i] += weight * f
        shear1[i] -= tangential * (a * a - b * b)
        shear2[i] -= tangential * 2 * a * b


@njit(inline="always")
def _apart(a: float, b: float) -> tuple[float, float]:
    """Return s = a^2 + b^2 and the square of the chord c of lens and source: s = c^2 (1 - c^2 / 4).

    a, b: components of the lens along the source's east and north.
    """
    square = max(a * a + b * b, 1e-30)
    return square, 2 * square / (1 + np.sqrt(1 - min(square, 1.0)))
