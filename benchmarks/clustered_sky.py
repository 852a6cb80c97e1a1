"""Galaxies of a patch of sky, for galaxy_clustering.py and mean_numbers.py: positions, redshifts, i, haloes.

They are those of a campaign but for the faint limit: `DENSITY` keeps those to i = 26, so a brick takes two CPU seconds.
"""

import tempfile
from pathlib import Path

import numpy as np
import yaml

from csstsim.base.process.progress import progress
from csstsim.base.shipped import SHIPPED
from csstsim.catalog.truth_bricks import AREA_DEG2, _clustered, _population, _streams, random_positions
from csstsim.instrument.camera import Camera, load_camera
from csstsim.universe.parameters import Universe, load_universe

SEED = 7
DENSITY = 80.0  # per arcmin2
COLUMNS = ("ra", "dec", "z", "i", "gal_type", "halomass", "satellite", "log_mass")


def thin_universe(density: float = DENSITY) -> Universe:
    """Return the shipped universe with fewer galaxies."""
    with tempfile.TemporaryDirectory() as folder:
        for file in (SHIPPED / "universe").iterdir():
            (Path(folder) / file.name).symlink_to(file)
        numbers = yaml.safe_load((SHIPPED / "universe" / "galaxies.yaml").read_text(encoding="utf-8"))
        numbers["density"]["value"] = density
        (Path(folder) / "galaxies.yaml").unlink()
        (Path(folder) / "galaxies.yaml").write_text(yaml.safe_dump(numbers), encoding="utf-8")
        universe = load_universe(Path(folder))
        universe.galaxy_seds, universe.dust.nside  # noqa: B018 - read while the folder is there
    return universe


def galaxies(universe: Universe, camera: Camera, structure: str, pix: int) -> dict[str, np.ndarray]:
    """Return the COLUMNS of the galaxies of a brick."""
    streams, population = _streams(SEED, pix, "galaxies"), _population(universe, camera)
    if structure == "none":
        z, log_mass, kind = population.grid.draw(
            streams("mass"), streams("count").poisson(population.grid.total * AREA_DEG2)
        )
        sample = {"z": z, "log_mass": log_mass, "gal_type": kind}
        sample["ra"], sample["dec"], _ = random_positions(pix, streams("position"), len(z))
        sample |= {"halomass": np.full(len(z), np.nan), "satellite": np.full(len(z), -1, np.int8)}
    else:
        sample = _clustered(SEED, universe, camera, structure).sample(pix, streams, AREA_DEG2)
    sample["i"] = population.properties(streams, sample["z"], sample["log_mass"], sample["gal_type"])["i"]
    return {name: sample[name][sample["i"] < population.limit] for name in COLUMNS}


def patch(structure: str, bricks: range, path: Path, density: float = DENSITY) -> dict[str, np.ndarray]:
    """Return the COLUMNS and the `brick` of the galaxies of bricks, made or as kept in `path` (npz)."""
    if not path.exists():
        universe, camera, parts = thin_universe(density), load_camera(), []
        for pix in progress(bricks, "bricks"):
            found = galaxies(universe, camera, structure, pix)
            parts.append(found | {"brick": np.full(len(found["z"]), pix)})
        part = path.with_suffix(".part.npz")
        np.savez(part, **{name: np.concatenate([each[name] for each in parts]) for name in parts[0]})
        part.replace(path)
    with np.load(path) as kept:
        return dict(kept)
