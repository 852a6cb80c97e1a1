"""Galaxies of other shapes for the benchmark: any Sersic index, knots in a disk with a bulge, and images.

Flux 100 to 1e6 electrons, half-light radius 0.1" to 1", ellipticity to 0.6. Every second object of each kind lies near
a node of the PSF set, as in bench.imaging.cases.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from csstsim.base.rng import stream
from csstsim.catalog.galaxy_shapes.galsim_images import image_of
from csstsim.catalog.row_files import with_images
from csstsim.catalog.table import GALAXY
from csstsim.render.scene import make_scene
from csstsim.studies.bench.imaging.cases import Case, Shape, make_row, position, window_of

if TYPE_CHECKING:
    from csstsim.studies.bench.setting import Setting

FLUX = (1e2, 1e6)
SIZE = (0.1, 1.0)
ELLIPTICITY = 0.6
KINDS = "free n", "knots", "image"


@dataclass(frozen=True, eq=False)
class ShapeCase(Case):
    """A Case of one of KINDS."""

    kind: str

    def about(self) -> dict[str, Any]:
        """Return {column: value} that describe the object."""
        return super().about() | {"kind": self.kind}


def make_shapes(setting: Setting, count: int, seed: int = 1, largest: float = SIZE[1]) -> list[ShapeCase]:
    """Return `count` ShapeCases, a third of each kind; no half-light radius is above `largest` [arcsec]."""
    rng = stream(seed, "bench", "shapes")
    cases = []
    for i in range(count):
        kind = KINDS[i % 3]
        at_node = i // 3 % 2 == 0
        size = float(np.exp(rng.uniform(*np.log([SIZE[0], min(SIZE[1], largest)]))))
        electrons = float(np.exp(rng.uniform(*np.log(FLUX))))
        e = rng.uniform(0, ELLIPTICITY)
        bulge = 0.0
        columns = {}
        if kind == "free n":
            columns = {"n_disk": rng.uniform(1.0, 6.2)}
        elif kind == "knots":
            bulge = 0.2
            columns = {"knots": int(rng.integers(5, 41)), "knots_frac": rng.uniform(0.3, 0.8)}
        else:
            columns = _image(setting, rng, size, e)
            e = 0.0
        at = position(setting, rng, at_node)
        row = make_row(setting, rng, i, at, Shape(electrons, bulge, size, e), extra_columns=columns)
        window = window_of(row)
        scene = make_scene(row, setting.wcs, setting.psf, setting.exptime)
        cases.append(ShapeCase(row, scene, window, electrons, at_node, kind))
    return cases


def _image(setting: Setting, rng: np.random.Generator, size: float, e: float) -> dict[str, Any]:
    """Return the columns of an image of two Sersic profiles, one next to the other."""
    import galsim

    main = galsim.Sersic(rng.uniform(0.8, 2.0), half_light_radius=size, flux=0.8).shear(g1=e, g2=0.0)
    other = galsim.Exponential(half_light_radius=0.3 * size, flux=0.2).shift(size, 0.5 * size)
    folder = Path(setting.psf.path).parent / "images"
    image = image_of(main + other, folder, "csstsim bench")
    columns = {name: np.array([image[name]]) for name in ("image_file", "image_scale")}
    return {name: values[0] for name, values in with_images(columns, np.array([GALAXY]), "csstsim bench").items()}
