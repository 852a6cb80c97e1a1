"""Galaxies of a window: rings of four on a grid, each ring one galaxy and its neighbours turned by 0, 45, 90, 135 deg.

Turned by 90 degrees a galaxy's own shape cancels in the mean; by 45 degrees, its response to shear, 1 - Re(e^2), loses
its scatter as well. The mean shape of a ring, sheared by g, is g but for terms of the order e^4 g^3.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from csstsim.base.files.yaml_file import read_yaml
from csstsim.base.rng import stream
from csstsim.base.shipped import SHIPPED
from csstsim.base.types import AnyArray, ComplexArray, FloatArray, Floats, IntArray
from csstsim.catalog.astrometry.reduction import icrs
from csstsim.universe.lensing.cosmology import Cosmology

if TYPE_CHECKING:
    from csstsim.campaign.job import Job
    from csstsim.instrument.chip import Window
    from csstsim.studies.budget.shear.plan import Lens, Neighbours, Setting, ShearPlan

RING = 4
EDGE = 10  # px, between the window's edge and the first stamp
LARGEST = 0.7  # of an ellipticity
OTHERS = 500_000  # of the first neighbour's id over that of the first galaxy
FIELD = 1_000_000  # ids of a field
FRACTION_WITH_BULGE = 1 / 3  # galaxies of the full profile that have one (E)


class Others(NamedTuple):
    """Neighbours of galaxies, each field (k,)."""

    galaxy: IntArray  # row of the galaxy
    offset: ComplexArray  # arcsec from it, east + i north
    e: ComplexArray
    mag: FloatArray
    size: FloatArray  # arcsec, half-light radius
    efficiency: FloatArray  # shear at its redshift over that of the galaxy; NaN without redshifts


@dataclass(frozen=True, eq=False)
class Galaxies:
    """Galaxies of a window: x, y (n,) pixels of the chip; ring (n,) number; e (n,) complex; columns {name: (n,)}.

    others: {kind of neighbours: Others}.
    """

    x: FloatArray
    y: FloatArray
    ring: IntArray
    e: ComplexArray
    columns: dict[str, AnyArray]
    others: dict[str, Others]

    def __len__(self) -> int:
        return len(self.x)


def galaxies(plan: ShearPlan, name: str, field: int, window: Window) -> Galaxies:
    """Return the Galaxies of a sample in a window; they depend on the plan's seed, the sample and the field alone."""
    sample = plan.samples[name]
    rng = stream(plan.seed, "budget", "shear", name, field)
    cells = plan.cells
    rings = cells * cells // RING
    n = rings * RING
    row, column = np.divmod(np.arange(n), cells)
    middle = EDGE + plan.spacing * 0.5
    x = window.x0 + middle + plan.spacing * column + rng.uniform(-0.5, 0.5, n)
    y = window.y0 + middle + plan.spacing * row + rng.uniform(-0.5, 0.5, n)
    turn = np.tile(np.arange(RING) * np.pi / 4, rings)
    mag = np.repeat(_magnitudes(rng, sample.magnitude, sample.slope, rings), RING)
    smallest, largest = np.log(sample.size)
    size = np.repeat(np.exp(rng.uniform(smallest, largest, rings)), RING)
    e = np.repeat(_shapes(rng, sample.ellipticity, rings), RING) * np.exp(2j * turn)
    columns = {"mag": mag, "size_disk": size, **_components(rng, size, rings)}
    others: dict[str, Others] = {}
    for kind, of in sorted(plan.neighbours.items()):
        other = _others(rng, of, turn, rings)
        own = stream(plan.seed, "budget", "shear", name, field, "redshift", kind)
        others[kind] = other._replace(efficiency=_efficiencies(own, of, plan.lens, len(other.galaxy) // RING))
    return Galaxies(x, y, np.repeat(np.arange(rings), RING), e, columns, others)


def table(
    galaxies: Galaxies, setting: Setting, plan: ShearPlan, job: Job, field: int, g: complex, band: str
) -> dict[str, AnyArray]:
    """Return the columns of csstsim.catalog.own_table for the galaxies of an arm of shear g, and their neighbours."""
    n = len(galaxies)
    full = setting.profile == "full"
    same = galaxies.columns
    own: dict[str, AnyArray] = {
        "id": field * FIELD + 1 + np.arange(n),
        "x": galaxies.x,
        "y": galaxies.y,
        "e": galaxies.e,
        "mag": same["mag"],
        "size_disk": same["size_disk"],
        "g": np.full(n, g),
        **{name: same[name] if full else np.full(n, plain) for name, plain in _PLAIN.items()},
        "size_bulge": same["size_bulge"] if full else same["size_disk"],
    }
    parts = [own]
    jacobian = job.wcs.jacobian(*job.wcs.pixel_to_world(galaxies.x, galaxies.y))
    first = field * FIELD + OTHERS
    for kind, other in galaxies.others.items():
        if not getattr(setting, kind):
            continue
        k = len(other.galaxy)
        factors = {"same": np.ones(k), "none": np.zeros(k), "by_redshift": other.efficiency}
        shear = g * factors[setting.neighbour_shear]
        offset = sheared_offset(other.offset, shear)
        dx, dy = np.einsum("kij,jk->ik", jacobian[other.galaxy], np.stack([offset.real, offset.imag]))
        parts.append(
            {
                "id": first + np.arange(k),
                "x": galaxies.x[other.galaxy] + dx,
                "y": galaxies.y[other.galaxy] + dy,
                "e": other.e,
                "mag": other.mag,
                "size_disk": other.size,
                "size_bulge": other.size,
                "g": shear,
                **{name: np.full(k, plain) for name, plain in _PLAIN.items()},
            }
        )
        first += k
    joined = {name: np.concatenate([part[name] for part in parts]) for name in own}
    ra, dec = icrs(*job.wcs.pixel_to_world(joined.pop("x"), joined.pop("y")), job.observer)
    e = joined.pop("e")
    shear = joined.pop("g")
    return joined | {
        "ra": ra,
        "dec": dec,
        f"mag_{band}": joined.pop("mag"),
        "type": np.full(len(ra), "galaxy"),
        "e1": e.real,
        "e2": e.imag,
        "gamma1": shear.real,
        "gamma2": shear.imag,
    }


_PLAIN = {"bulge_frac": 0.0, "n_disk": 1.0, "n_bulge": 4.0, "knots": 0, "knots_frac": 0.0}


def sheared_offset(offset: ComplexArray, g: complex | ComplexArray) -> ComplexArray:
    """Return complex offsets on the sky of what lies at `offset` behind a shear g: A^-1 offset, of no convergence."""
    size: Floats = abs(g) if isinstance(g, complex) else np.abs(g)
    return (offset + g * np.conj(offset)) / (1 - size**2)


def efficiency(z: Floats, lens: Lens) -> FloatArray:
    """Return the shear by a plan's Lens at redshifts z, over that of the galaxies: of (1 - chi_l / chi), 0 before it.

    In a flat universe the shear by one plane goes as D_ls / D_s = 1 - chi_l / chi_s (Bartelmann & Schneider 2001).
    """
    cosmology = Cosmology(read_yaml(SHIPPED / "universe" / "cosmology.yaml"))
    near = cosmology.comoving_distance(lens.redshift)
    far = cosmology.comoving_distance(lens.galaxies)
    behind = np.maximum(cosmology.comoving_distance(z), near)
    return (1 - near / behind) / (1 - near / far)


def _efficiencies(rng: np.random.Generator, of: Neighbours, lens: Lens | None, rings: int) -> FloatArray:
    """Return Others.efficiency of neighbours of `rings` rings: the four of a ring have one redshift."""
    if lens is None or of.redshift is None:
        return np.full(RING * rings, np.nan)
    return np.repeat(efficiency(rng.uniform(*of.redshift, rings), lens), RING)


def _magnitudes(rng: np.random.Generator, limits: tuple[float, float], slope: float, n: int) -> FloatArray:
    low, high = limits
    u = rng.random(n)
    if abs(slope) * (high - low) < 1e-9:
        return low + (high - low) * u
    return low + np.log10(1 + u * (10 ** (slope * (high - low)) - 1)) / slope


def _shapes(rng: np.random.Generator, rms: float, n: int) -> ComplexArray:
    """Return (n,) complex ellipticities: Gaussian components, cut at LARGEST."""
    largest = -np.expm1(-0.5 * (LARGEST / rms) ** 2) if rms > 0 else 1.0
    return rms * np.sqrt(-2 * np.log1p(-largest * rng.random(n))) * np.exp(2j * np.pi * rng.random(n))


def _components(rng: np.random.Generator, size: FloatArray, rings: int) -> dict[str, AnyArray]:
    """Return the columns of the full profile, one value a ring (E: round numbers around those of components.yaml)."""
    bulge = np.where(rng.random(rings) < FRACTION_WITH_BULGE, rng.uniform(0.1, 0.6, rings), 0.0)
    found = {
        "bulge_frac": bulge,
        "n_disk": rng.choice([0.75, 1.0, 1.25, 1.5], rings),
        "n_bulge": rng.choice([2, 3, 4], rings),
        "knots": np.where(rng.random(rings) < 0.5, rng.integers(5, 30, rings), 0),
    }
    found["knots_frac"] = np.where(found["knots"] > 0, rng.uniform(0.05, 0.3, rings), 0.0)
    found = {name: np.repeat(values, RING) for name, values in found.items()}
    return found | {"size_bulge": size * np.repeat(rng.uniform(0.3, 0.7, rings), RING)}


def _others(rng: np.random.Generator, of: Neighbours, turn: FloatArray, rings: int) -> Others:
    """Return the neighbours of all galaxies, without redshifts: those of a ring are turned with it."""
    counts = rng.poisson(of.number, rings)
    k = counts.sum()
    ring = np.repeat(np.arange(rings), counts)
    angle = 2 * np.pi * rng.random(k)
    low, high = of.distance
    offset = np.sqrt(rng.uniform(low**2, high**2, k)) * np.exp(1j * angle)
    e = _shapes(rng, 0.25, k)
    mag = rng.uniform(*of.magnitude, k)
    size = rng.uniform(*of.size, k)
    row = (RING * ring[:, None] + np.arange(RING)).ravel()
    again = np.repeat(np.arange(k), RING)
    by = turn[row]
    return Others(
        galaxy=row,
        offset=offset[again] * np.exp(1j * by),
        e=e[again] * np.exp(2j * by),
        mag=mag[again],
        size=size[again],
        efficiency=np.full(len(row), np.nan),
    )
