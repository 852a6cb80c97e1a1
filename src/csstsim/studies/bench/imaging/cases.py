"""The objects of a benchmark: a designed grid of extremes, then a seeded random sample between them.

Flux 10 to 1e7 electrons, half-light radius 0.05" to 5" (bulges to 1.5"), ellipticity |e| = (a - b) / (a + b) to 0.8.
Every second object lies within half a pixel of a node of the PSF set, where the error is only that of the renderer. The
others lie anywhere, so their errors include the interpolation between nodes.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from itertools import product
from typing import TYPE_CHECKING, Any, NamedTuple, Self

import numpy as np

from csstsim.base.rng import stream
from csstsim.base.types import FloatArray
from csstsim.catalog.selection.reach import STAR_MIN, galaxy_radius, point_reach
from csstsim.catalog.table import GALAXY, STAR, ObjectTable
from csstsim.instrument.chip import Window
from csstsim.render.scene import Scene, make_scene

if TYPE_CHECKING:
    from csstsim.studies.bench.setting import Setting

FLUX = 10.0, 1e7  # electrons
SIZE = 0.05, 5.0  # arcsec
BULGE_MAX = 1.5  # arcsec
ELLIPTICITY = 0.8
FRACTIONS = (0.16, 0.3, 0.34, 0.2)  # of the flux by sub-band, unequal so that a permutation shows as an error
# px: half the side of the stamp that is measured
HALF_MIN = 32
HALF_MAX = 160
MARGIN = 16  # px beyond the reach, so that flux outside of a stamp shows as an error
EDGE = 300  # px: minimum distance from the chip's edge


class Position(NamedTuple):
    """A position on a chip, or on an image [px]."""

    x: float
    y: float


class Shape(NamedTuple):
    """A galaxy, or a star if `size` is 0: electrons, fraction of the bulge, half-light radius [arcsec], |e|."""

    electrons: float
    bulge: float = 0.0
    size: float = 0.0
    e: float = 0.0


@dataclass(frozen=True, eq=False)
class Case:
    """One object, alone on its window."""

    row: ObjectTable  # one row, with the columns of catalog.selection.select
    scene: Scene  # of the same object
    window: Window
    electrons: float
    at_node: bool

    @property
    def half(self) -> int:
        """Half the side of the window [px]; it has 2 half + 1 pixels a side."""
        return (self.window.nx - 1) // 2

    @property
    def id(self) -> int:
        """The object's number."""
        return int(self.row["id"][0])

    @property
    def star(self) -> bool:
        """Whether it is a star."""
        return self.row["obj_type"][0] == STAR

    def about(self) -> dict[str, Any]:
        """Return {column: value} that describe the object."""
        return {
            "object": self.id,
            "kind": "star" if self.star else "galaxy",
            "electrons": self.electrons,
            "half_light": float(self.row["size_disk"][0]),
            "bulge": float(self.row["bulge_frac"][0]),
            "e": float(np.hypot(self.row["e1"], self.row["e2"])[0]),
            "reach": int(self.row["reach"][0]),
            "at_node": self.at_node,
        }

    def brighter(self, electrons: float) -> Self:
        """Return the same case with another number of electrons."""
        factor = electrons / self.electrons
        columns = {name: self.row[name] * factor for name in ("flux0", "flux1", "flux2", "flux3")}
        scene = replace(self.scene, electrons=self.scene.electrons * factor)
        return replace(self, row=ObjectTable(self.row).with_columns(**columns), scene=scene, electrons=electrons)


def make_cases(
    setting: Setting, count: int, seed: int = 1, largest: float = SIZE[1], make: Callable[..., Case] | None = None
) -> list[Case]:
    """Return `count` Cases, half of them stars, each by `make` (by default make_case).

    No half-light radius is above `largest` [arcsec].
    """
    rng = stream(seed, "bench", "cases")
    shapes = _stars(rng, count - count // 2) + _galaxies(rng, count // 2, largest)
    return [(make or make_case)(setting, rng, i, **shape) for i, shape in enumerate(shapes)]


def _stars(rng: np.random.Generator, count: int) -> list[dict[str, float]]:
    grid = np.geomspace(*FLUX, 7)[: count // 4]
    low, high = np.log(FLUX)
    random_fluxes = np.exp(rng.uniform(low, high, count - len(grid)))
    return [{"electrons": flux} for flux in (*grid, *random_fluxes)]


def _galaxies(rng: np.random.Generator, count: int, largest: float) -> list[dict[str, float]]:
    bulges = (0.0, 1.0, 0.4)
    sizes = (SIZE[0], 0.5, min(2.0, largest))
    grid = list(product((1e2, 1e4, 1e6), bulges, sizes, (0.0, ELLIPTICITY)))
    shapes = [
        dict(zip(("electrons", "bulge", "size", "e"), grid[i], strict=True))
        for i in rng.permutation(len(grid))[: count // 4]
    ]
    while len(shapes) < count:
        shapes.append(
            {
                "electrons": np.exp(rng.uniform(*np.log(FLUX))),
                "bulge": (0.0, 1.0, rng.random())[rng.integers(3)],
                "size": np.exp(rng.uniform(np.log(SIZE[0]), np.log(min(SIZE[1], largest)))),
                "e": rng.uniform(0, ELLIPTICITY),
            }
        )
    return shapes


def make_case(
    setting: Setting,
    rng: np.random.Generator,
    i: int,
    electrons: float,
    bulge: float = 0.0,
    size: float = 0.0,
    e: float = 0.0,
) -> Case:
    """Return the Case of a galaxy of `size` [arcsec], or of a star if it is 0; cases of even `i` are at a node."""
    at_node = i % 2 == 0
    table = make_row(setting, rng, i, position(setting, rng, at_node), Shape(electrons, bulge, size, e))
    scene = make_scene(table, setting.wcs, setting.psf, setting.exptime)
    return Case(table, scene, window_of(table), electrons, at_node)


def window_of(table: ObjectTable) -> Window:
    """Return the Window about a table's one object."""
    half = half_of(table)
    x = round(float(table["x"][0]))
    y = round(float(table["y"][0]))
    return Window(x - half, x + half + 1, y - half, y + half + 1)


def half_of(table: ObjectTable, half_max: int = HALF_MAX) -> int:
    """Return half the side of the window of a table's one object [px]."""
    return int(np.clip(table["reach"][0] + MARGIN, HALF_MIN, half_max))


def make_row(
    setting: Setting,
    rng: np.random.Generator,
    i: int,
    at: Position,
    shape: Shape,
    fractions: Iterable[float] = FRACTIONS,
    extra_columns: Mapping[str, Any] | None = None,
) -> ObjectTable:
    """Return the table of object `i` at a position on the chip, turned at random.

    fractions (4,): of its flux by sub-band; extra_columns: {column: value}.
    """
    turn = rng.uniform(0, 2 * np.pi)
    ra, dec = setting.wcs.pixel_to_world(at.x, at.y)
    columns = {
        "id": i,
        "obj_type": GALAXY if shape.size else STAR,
        "ra": ra,
        "dec": dec,
        "ra_orig": ra,
        "dec_orig": dec,
        "x": at.x,
        "y": at.y,
        "bulge_frac": shape.bulge,
        "size_disk": shape.size,
        "size_bulge": min(shape.size, BULGE_MAX),
        "e1": shape.e * np.cos(turn),
        "e2": shape.e * np.sin(turn),
        "wing": 0.0,
    }
    columns |= {f"flux{k}": shape.electrons * fraction / setting.exptime for k, fraction in enumerate(fractions)}
    columns |= extra_columns or {}
    table = ObjectTable.complete({name: np.atleast_1d(value) for name, value in columns.items()}, ())
    box = setting.psf.image.shape[-1] / 2 / setting.psf.oversampling
    flux = np.array([shape.electrons])
    reach = point_reach(flux, setting.variance, setting.filter, setting.camera.telescope, box)
    lost: FloatArray = np.zeros(1)
    if shape.size:
        radius, lost = galaxy_radius(table, flux, setting.variance, setting.camera.telescope.pixel_scale)
        reach = reach + radius
    else:
        reach = np.maximum(reach, STAR_MIN)
    return table.with_columns(reach=np.ceil(reach).astype(np.int32), lost=lost)


def position(setting: Setting, rng: np.random.Generator, at_node: bool) -> Position:
    """Return a Position within half a pixel of a node that is not at the chip's edge, or anywhere else."""
    nodes = setting.psf.nodes_xy
    detector = setting.chip.detector
    if not at_node:
        return Position(rng.uniform(EDGE, detector.nx - EDGE), rng.uniform(EDGE, detector.ny - EDGE))
    inside = (nodes > EDGE).all(axis=1) & (nodes < (detector.nx - EDGE, detector.ny - EDGE)).all(axis=1)
    x, y = nodes[rng.choice(np.flatnonzero(inside))] + rng.uniform(-0.5, 0.5, 2)
    return Position(x, y)
