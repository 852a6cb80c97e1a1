"""Convergence and shear by haloes, summed pair by pair, with the exact distances of halo and source (halo_profile).

    kappa = 3/2 Om (H0 / c)^2 (1 + z_h) chi_h (1 - chi_h / chi_s) V Sigma / M,   V = M mu / rho    (comoving)

Radii are chords on the unit sphere times chi_h. In them areas on the sphere are flat, so the halo's mass and that of
its disc cancel exactly, and gamma_t = mean (1 - g) / (1 - g / 2) - kappa with g = chord^2 / 2 has no B mode. Born.
"""

import numpy as np
from numba import njit

from csstsim.base.sphere import frames
from csstsim.universe.structure.halo_profile import disc_radius, nfw_mass, nfw_projected, whole_mass

_BUCKET = np.radians(0.7 / 60)  # side of the squares into which sources are sorted


def halo_lenses(haloes, mass_function, numbers):
    """Return what `halo_shear` needs of haloes (n, 7 + cuts); numbers: section haloes of structure.yaml.

    haloes: the columns of haloes.Haloes. Columns: direction (3), chi [Mpc], strength (kappa x chord^2), radius of the
    disc and scale radius [rad], and the radii at which the density ends, over the scale radius.
    """
    a, d = np.radians(haloes["ra"]), np.radians(haloes["dec"])
    mass, c, cosmology = 10 ** haloes["log_mass"], np.asarray(haloes["concentration"]), mass_function.cosmology
    chi = cosmology.comoving_distance(haloes["z"])
    strength = 1.5 * cosmology.omega_m / cosmology.hubble_distance**2 * (1 + haloes["z"])
    strength = strength * mass * whole_mass(c, numbers["cuts"]) / mass_function.density / (np.pi * chi)
    disc = disc_radius(mass_function, mass, numbers) / chi
    scale = mass_function.virial_radius(mass) / chi / c
    return np.column_stack([frames(a, d)[0], chi, strength, disc, scale, np.outer(c, numbers["cuts"])])


def halo_shear(lenses, ra, dec, chi):
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
    at, inverse = np.column_stack([n, east, north])[ranked], inverse[ranked]
    sums = np.zeros((len(chi), 3))
    along, across, toward = np.einsum("nk,ak->an", lenses[:, :3], np.stack([*plane, middle]))
    centres = np.column_stack([(along - corner[0]) / _BUCKET, (across - corner[1]) / _BUCKET, toward])
    _add(sums, at, inverse, starts, rows, columns, lenses, centres, _BUCKET)
    out[:, ranked] = sums.T
    return out


@njit(cache=True)
def _add(sums, at, inverse, starts, rows, columns, lenses, centres, bucket):
    """Add every lens to sums (sources, 3); sources are sorted by bucket, the farthest first, `starts` of each."""
    for h in range(len(lenses)):
        p0, p1, p2, chi, strength, disc, scale = lenses[h, :7]
        cuts = lenses[h, 7:]
        if centres[h, 2] < 0:
            continue
        reach = disc / bucket  # a projected radius is at most the chord
        disc2, widest2, per_disc2 = disc * disc, (scale * cuts.max()) ** 2, 1 / (disc * disc)
        inner = 1 / (2 * scale * scale * nfw_mass(cuts).sum())
        low, high = max(int(np.floor(centres[h, 1] - reach)), 0), min(int(np.floor(centres[h, 1] + reach)), rows - 1)
        for row in range(low, high + 1):
            off = max(row - centres[h, 1], centres[h, 1] - row - 1, 0.0)
            half = np.sqrt(max(reach * reach - off * off, 0.0))
            left = max(int(np.floor(centres[h, 0] - half)), 0)
            right = min(int(np.floor(centres[h, 0] + half)), columns - 1)
            if left > right:
                continue
            for cell in range(row * columns + left, row * columns + right + 1):
                for i in range(starts[cell], starts[cell + 1]):
                    weight = strength * (1 - chi * inverse[i])
                    if not weight > 0:  # nor are those after it behind the lens
                        break
                    d0, d1, d2 = p0 - at[i, 0], p1 - at[i, 1], p2 - at[i, 2]
                    chord2 = max(d0 * d0 + d1 * d1 + d2 * d2, 1e-30)
                    if chord2 >= disc2:
                        continue
                    q = 1 - chord2 * per_disc2
                    q3 = q * q * q
                    kappa = -4 * per_disc2 * q3
                    gap = 0.5 * chord2
                    both = 1 / (chord2 * (1 - 0.5 * gap))  # one division for both quotients
                    per_chord2 = both * (1 - 0.5 * gap)
                    mean = q3 * q * per_chord2
                    if chord2 < widest2:
                        mean -= per_chord2
                        for cut in cuts:
                            f, g = nfw_projected(np.sqrt(chord2) / scale, cut)
                            kappa += inner * f
                            mean += inner * (f + g)
                    tangential = weight * both * (mean * (1 - gap) * both * chord2 - kappa)
                    a = d0 * at[i, 3] + d1 * at[i, 4] + d2 * at[i, 5]
                    b = d0 * at[i, 6] + d1 * at[i, 7] + d2 * at[i, 8]
                    sums[i, 0] += weight * kappa
                    sums[i, 1] -= tangential * (a * a - b * b)
                    sums[i, 2] -= tangential * 2 * a * b
