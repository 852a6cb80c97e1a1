"""Quasars of the embedded universe: how many, how bright, and in which galaxies (paper, section 3.2.1).

The luminosity function of Ross et al. (2013, ApJ 773, 14), a double power law in M1450,

    phi(M, z) = phi*(z) / (10^(0.4 (alpha + 1)(M - M*(z))) + 10^(0.4 (beta + 1)(M - M*(z))))     [Mpc-3 mag-1],

times the comoving volume gives the number on the sky. The faint slope alpha changes with redshift below z = 2.2. The
quasars of a redshift bin are assigned to the galaxies of that bin by rank: the more luminous the quasar, the larger the
product of the host's bulge mass and a log-normal accretion rate. Left out: clustering beyond that of the hosts,
obscured quasars, lensed quasars, and the conversion from the cosmology of the fit (H0 70, Om 0.3), which has 7-9% less
volume and distance moduli 0.06 mag smaller than that of csstsim.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from csstsim.base.types import AnyArray, FloatArray, Floats, IntArray
from csstsim.universe.coefficients import COEFFICIENTS

if TYPE_CHECKING:
    from csstsim.universe.lensing.cosmology import Cosmology

# Steps of the tabulated counts, in redshift and in magnitude
_DZ = 0.02
_DM = 0.02


def luminosity_function(m1450: Floats, z: Floats, numbers: Mapping[str, Any]) -> FloatArray:
    """Return phi [Mpc-3 mag-1] at `m1450` (AB) and `z` (arrays that broadcast).

    Each number of the chosen set holds at all its redshifts, or is a table of (z, value), linear in between.
    """
    chosen = numbers[numbers["luminosity_function"]]
    m1450, z = np.broadcast_arrays(np.asarray(m1450, dtype=float), np.asarray(z, dtype=float))
    high = z >= chosen["switch"]
    p = {
        name: np.where(high, _value_at(z, chosen["high"][name]), _value_at(z, value))
        for name, value in chosen["low"].items()
    }
    step = z - p["pivot"]
    x = m1450 - (p["m_star"] + chosen["shift"] - 2.5 * (p["k1"] * step + p["k2"] * step**2))
    log_phi = p["log_phi"] + p["log_phi_slope"] * step
    return 10**log_phi / (10 ** (0.4 * (p["alpha"] + 1) * x) + 10 ** (0.4 * (p["beta"] + 1) * x))


def cumulative_counts(numbers: Mapping[str, Any], cosmology: Cosmology) -> tuple[FloatArray, FloatArray]:
    """Return z and N(<z) [deg-2], each (n,), of quasars brighter than the faint limit in M1450."""
    first, last = numbers["redshift"]
    edges = np.linspace(first, last, round((last - first) / _DZ) + 1)
    middle = 0.5 * (edges[1:] + edges[:-1])
    magnitude = _magnitudes(numbers)
    density = np.trapezoid(luminosity_function(magnitude, middle[:, None], numbers), magnitude, axis=1)
    return edges, np.concatenate([[0.0], np.cumsum(density * cosmology.volume(edges[:-1], edges[1:]))])


def draw_quasars(
    rng: Callable[[str], np.random.Generator],
    area: float,
    galaxies: Mapping[str, AnyArray],
    numbers: Mapping[str, Any],
    cosmology: Cosmology,
) -> dict[str, AnyArray]:
    """Return the columns of a Poisson number of quasars on `area` [deg2], except position and magnitudes.

    `rng(name)` gives the generator of one quantity; `galaxies` has arrays z and bulgemass (solar masses) of the same
    area; cosmology: cosmology.Cosmology. Besides table columns: `m1450`, and `host`, the row of the host galaxy, whose
    redshift the quasar takes (-1 where a redshift bin has more quasars than galaxies).
    """
    edges, total = cumulative_counts(numbers, cosmology)
    count = rng("count").poisson(total[-1] * area)
    z = np.interp(rng("redshift").random(count) * total[-1], total, edges)
    m1450 = _luminosity(rng("luminosity"), z, numbers).astype(np.float32)
    host = match_hosts(rng("accretion"), z, m1450, galaxies, numbers)
    z[host >= 0] = np.asarray(galaxies["z"])[host[host >= 0]]
    # Absolute magnitude at 1450 A rest to AB magnitude at 1450 (1 + z) A.
    observed = m1450 + cosmology.distance_modulus(z) - 2.5 * np.log10(1 + z)
    columns = {"z": z, "m1450": m1450, "sed_scale": 10 ** (-0.4 * observed)}
    columns = {name: values.astype(np.float32) for name, values in columns.items()}
    coefficients = _coefficients(rng, m1450, numbers)
    return columns | {f"coeff{k}": coefficients[:, k] for k in range(COEFFICIENTS)} | {"host": host}


def match_hosts(
    generator: np.random.Generator,
    z: FloatArray,
    m1450: FloatArray,
    galaxies: Mapping[str, AnyArray],
    numbers: Mapping[str, Any],
) -> IntArray:
    """Return the row of the host of each quasar (n,), -1 for none; a galaxy hosts at most one.

    Galaxies without a redshift, a bulge mass or a bulge host none.
    """
    width = numbers["hosts"]["bin"]
    scatter = numbers["hosts"]["scatter"]
    galaxy_z = np.asarray(galaxies["z"], dtype=float)
    mass = np.asarray(galaxies["bulgemass"], dtype=float)
    accretion = np.where(mass > 0, mass, 0.0) * 10 ** (scatter * generator.standard_normal(len(mass)))
    galaxy_bin = np.floor(galaxy_z / width)  # NaN is in no bin
    quasar_bin = np.floor(z / width)
    host = np.full(len(z), -1, dtype=np.int64)
    for redshift_bin in np.unique(quasar_bin):
        quasars = np.flatnonzero(quasar_bin == redshift_bin)
        candidates = np.flatnonzero((galaxy_bin == redshift_bin) & (accretion > 0))
        by_luminosity = quasars[np.argsort(m1450[quasars], kind="stable")]
        by_accretion = candidates[np.argsort(-accretion[candidates], kind="stable")]
        pairs = min(len(by_luminosity), len(by_accretion))
        host[by_luminosity[:pairs]] = by_accretion[:pairs]
    return host


def _value_at(z: FloatArray, value: Any) -> Floats:
    """Return a number of the luminosity function at z."""
    return np.interp(z, *np.transpose(np.asarray(value, dtype=float))) if np.ndim(value) else value


def _magnitudes(numbers: Mapping[str, Any]) -> FloatArray:
    bright, faint = numbers["m1450"]
    return np.linspace(bright, faint, round((faint - bright) / _DM) + 1)


def _luminosity(generator: np.random.Generator, z: FloatArray, numbers: Mapping[str, Any]) -> FloatArray:
    """Draw M1450 from the luminosity function at each redshift, by its cumulative integral."""
    magnitude = _magnitudes(numbers)
    chance = generator.random(len(z))
    out = np.empty(len(z))
    for i, redshift in enumerate(z):
        phi = luminosity_function(magnitude, redshift, numbers)
        total = np.concatenate([[0.0], np.cumsum(0.5 * (phi[1:] + phi[:-1]))])
        out[i] = np.interp(chance[i] * total[-1], total, magnitude)
    return out


def _coefficients(
    rng: Callable[[str], np.random.Generator], m1450: FloatArray, numbers: Mapping[str, Any]
) -> FloatArray:
    """Return (n, 20) float32 coefficients as defined in quasar_sed."""
    continuum = numbers["continuum"]
    scatter = np.array([part["scatter"] for name, part in numbers["families"].items() if name != "m1450"])
    first = 1 + len(continuum["slopes"])
    out = np.zeros((len(m1450), COEFFICIENTS), np.float32)
    out[:, 0] = m1450
    out[:, 1:first] = continuum["scatter"] * rng("slopes").standard_normal((len(m1450), first - 1))
    out[:, first : first + len(scatter)] = scatter * rng("lines").standard_normal((len(m1450), len(scatter)))
    return out
