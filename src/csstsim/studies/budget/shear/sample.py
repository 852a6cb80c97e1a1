"""Galaxies of a window: rings of four on a grid, each ring one galaxy and its neighbours turned by 0, 45, 90, 135 deg.

A turn by 90 degrees cancels the galaxy's intrinsic shape in the mean; one by 45 degrees also cancels the scatter of its
response to shear, 1 - Re(e^2). The mean shape of a ring, sheared by g, is g up to terms of order e^4 g^3.
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
ELLIPTICITY_MAX = 0.7
FIRST_NEIGHBOUR_ID = 500_000  # of a field, counted from the field's first id
IDS_PER_FIELD = 1_000_000
FRACTION_WITH_BULGE = 1 / 3  # galaxies of the full profile that have one (E)


class NeighbourTable(NamedTuple):
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

    neighbours: {kind: NeighbourTable}.
    """

    x: FloatArray
    y: FloatArray
    ring: IntArray
    e: ComplexArray
    columns: dict[str, AnyArray]
    neighbours: dict[str, NeighbourTable]

    def __len__(self) -> int:
        return len(self.x)


def make_galaxies(plan: ShearPlan, name: str, field: int, window: Window) -> Galaxies:
    """Return the Galaxies of a sample in a window; they depend only on the plan's seed, the sample and the field."""
    sample = plan.samples[name]
    rng = stream(plan.seed, "budget", "shear", name, field)
    cells = plan.cells
    rings = cells * cells // RING
    n = rings * RING
    row, column = np.divmod(np.arange(n), cells)
    middle = EDGE + plan.spacing * 0.5
    x = window.x0 + middle + plan.spacing * column + rng.uniform(-0.5, 0.5, n)
    y = window.y0 + middle + plan.spacing * row + rng.uniform(-0.5, 0.5, n)
    angle = np.tile(np.arange(RING) * np.pi / 4, rings)
    mag = np.repeat(_magnitudes(rng, sample.magnitude, sample.slope, rings), RING)
    smallest, largest = np.log(sample.size)
    size = np.repeat(np.exp(rng.uniform(smallest, largest, rings)), RING)
    ellipticity = np.repeat(_shapes(rng, sample.ellipticity, rings), RING) * np.exp(2j * angle)
    columns = {"mag": mag, "size_disk": size, **_components(rng, size, rings)}
    neighbours: dict[str, NeighbourTable] = {}
    for kind, described in sorted(plan.neighbours.items()):
        table = _neighbours(rng, described, angle, rings)
        redshift_rng = stream(plan.seed, "budget", "shear", name, field, "redshift", kind)
        efficiencies = _efficiencies(redshift_rng, described, plan.lens, len(table.galaxy) // RING)
        neighbours[kind] = table._replace(efficiency=efficiencies)
    return Galaxies(x, y, np.repeat(np.arange(rings), RING), ellipticity, columns, neighbours)


def catalogue_columns(
    galaxies: Galaxies, setting: Setting, plan: ShearPlan, job: Job, field: int, g: complex, band: str
) -> dict[str, AnyArray]:
    """Return the columns of csstsim.catalog.own_table for the galaxies of an arm of shear g, and their neighbours."""
    n = len(galaxies)
    full = setting.profile == "full"
    columns = galaxies.columns
    targets: dict[str, AnyArray] = {
        "id": field * IDS_PER_FIELD + 1 + np.arange(n),
        "x": galaxies.x,
        "y": galaxies.y,
        "e": galaxies.e,
        "mag": columns["mag"],
        "size_disk": columns["size_disk"],
        "g": np.full(n, g),
        **{name: columns[name] if full else np.full(n, plain) for name, plain in _PLAIN_PROFILE.items()},
        "size_bulge": columns["size_bulge"] if full else columns["size_disk"],
    }
    parts = [targets]
    jacobian = job.wcs.jacobian(*job.wcs.pixel_to_world(galaxies.x, galaxies.y))
    first_id = field * IDS_PER_FIELD + FIRST_NEIGHBOUR_ID
    for kind, neighbours in galaxies.neighbours.items():
        if not getattr(setting, kind):
            continue
        k = len(neighbours.galaxy)
        shear_factors = {"same": np.ones(k), "none": np.zeros(k), "by_redshift": neighbours.efficiency}
        shear = g * shear_factors[setting.neighbour_shear]
        offset = sheared_offset(neighbours.offset, shear)
        dx, dy = np.einsum("kij,jk->ik", jacobian[neighbours.galaxy], np.stack([offset.real, offset.imag]))
        parts.append(
            {
                "id": first_id + np.arange(k),
                "x": galaxies.x[neighbours.galaxy] + dx,
                "y": galaxies.y[neighbours.galaxy] + dy,
                "e": neighbours.e,
                "mag": neighbours.mag,
                "size_disk": neighbours.size,
                "size_bulge": neighbours.size,
                "g": shear,
                **{name: np.full(k, plain) for name, plain in _PLAIN_PROFILE.items()},
            }
        )
        first_id += k
    joined = {name: np.concatenate([part[name] for part in parts]) for name in targets}
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


_PLAIN_PROFILE = {"bulge_frac": 0.0, "n_disk": 1.0, "n_bulge": 4.0, "knots": 0, "knots_frac": 0.0}


def sheared_offset(offset: ComplexArray, g: complex | ComplexArray) -> ComplexArray:
    """Return the sheared positions of complex offsets on the sky: A^-1 offset, for a shear g without convergence."""
    size: Floats = abs(g) if isinstance(g, complex) else np.abs(g)
    return (offset + g * np.conj(offset)) / (1 - size**2)


def efficiency(z: Floats, lens: Lens) -> FloatArray:
    """Return the shear by a plan's Lens at redshifts z over that of the galaxies: of (1 - chi_l / chi), 0 in front.

    In a flat universe the shear by one plane goes as D_ls / D_s = 1 - chi_l / chi_s (Bartelmann & Schneider 2001).
    """
    cosmology = Cosmology(read_yaml(SHIPPED / "universe" / "cosmology.yaml"))
    to_lens = cosmology.comoving_distance(lens.redshift)
    to_galaxies = cosmology.comoving_distance(lens.galaxies)
    distance = np.maximum(cosmology.comoving_distance(z), to_lens)
    return (1 - to_lens / distance) / (1 - to_lens / to_galaxies)


def _efficiencies(rng: np.random.Generator, neighbours: Neighbours, lens: Lens | None, rings: int) -> FloatArray:
    """Return NeighbourTable.efficiency for `rings` rings of neighbours: the four of a ring have one redshift."""
    if lens is None or neighbours.redshift is None:
        return np.full(RING * rings, np.nan)
    return np.repeat(efficiency(rng.uniform(*neighbours.redshift, rings), lens), RING)


def _magnitudes(rng: np.random.Generator, limits: tuple[float, float], slope: float, n: int) -> FloatArray:
    low, high = limits
    u = rng.random(n)
    if abs(slope) * (high - low) < 1e-9:
        return low + (high - low) * u
    return low + np.log10(1 + u * (10 ** (slope * (high - low)) - 1)) / slope


def _shapes(rng: np.random.Generator, rms: float, n: int) -> ComplexArray:
    """Return (n,) complex ellipticities: Gaussian components of this rms, cut at ELLIPTICITY_MAX."""
    probability_max = -np.expm1(-0.5 * (ELLIPTICITY_MAX / rms) ** 2) if rms > 0 else 1.0
    return rms * np.sqrt(-2 * np.log1p(-probability_max * rng.random(n))) * np.exp(2j * np.pi * rng.random(n))


def _components(rng: np.random.Generator, size: FloatArray, rings: int) -> dict[str, AnyArray]:
    """Return the columns of the full profile, one value per ring (E: rounded values of components.yaml)."""
    fraction = np.where(rng.random(rings) < FRACTION_WITH_BULGE, rng.uniform(0.1, 0.6, rings), 0.0)
    columns = {
        "bulge_frac": fraction,
        "n_disk": rng.choice([0.75, 1.0, 1.25, 1.5], rings),
        "n_bulge": rng.choice([2, 3, 4], rings),
        "knots": np.where(rng.random(rings) < 0.5, rng.integers(5, 30, rings), 0),
    }
    columns["knots_frac"] = np.where(columns["knots"] > 0, rng.uniform(0.05, 0.3, rings), 0.0)
    columns = {name: np.repeat(values, RING) for name, values in columns.items()}
    return columns | {"size_bulge": size * np.repeat(rng.uniform(0.3, 0.7, rings), RING)}


def _neighbours(rng: np.random.Generator, described: Neighbours, angle: FloatArray, rings: int) -> NeighbourTable:
    """Return the neighbours of all galaxies, without redshifts; they are turned with the galaxies of a ring."""
    counts = rng.poisson(described.number, rings)
    n = counts.sum()
    ring = np.repeat(np.arange(rings), counts)
    direction = 2 * np.pi * rng.random(n)
    low, high = described.distance
    offset = np.sqrt(rng.uniform(low**2, high**2, n)) * np.exp(1j * direction)
    e = _shapes(rng, 0.25, n)
    mag = rng.uniform(*described.magnitude, n)
    size = rng.uniform(*described.size, n)
    galaxy = (RING * ring[:, None] + np.arange(RING)).ravel()
    repeated = np.repeat(np.arange(n), RING)
    turn = angle[galaxy]
    return NeighbourTable(
        galaxy=galaxy,
        offset=offset[repeated] * np.exp(1j * turn),
        e=e[repeated] * np.exp(2j * turn),
        mag=mag[repeated],
        size=size[repeated],
        efficiency=np.full(len(galaxy), np.nan),
    )
