"""Make the galaxies of a patch of sky once, for galaxy_clustering.py: places, redshifts, i magnitudes, haloes.

    python benchmarks/clustered_sky.py [--bricks 64] [--first 409600] [--structure haloes]
        [--output results/clustered_sky]

The patch is a HEALPix pixel of as many bricks (4 to 256 of 0.0525 deg2 each). The galaxies are those of a campaign but
for the faint limit: `DENSITY` keeps those to i = 26, so a brick takes two CPU seconds. Writes one npz file.
"""

import argparse
import tempfile
from pathlib import Path

import numpy as np
import yaml

from csstsim.base.healpix import BRICKS
from csstsim.base.process.progress import progress
from csstsim.base.shipped import SHIPPED
from csstsim.catalog.truth_bricks import AREA_DEG2, _clustered, _population, _streams, place
from csstsim.instrument.camera import load_camera
from csstsim.universe.parameters import load_universe

SEED, FIRST = 7, 6400 * 64  # a patch at middle latitude, 3.4 deg2 of 64 bricks
DENSITY = 80.0  # per arcmin2
COLUMNS = ("ra", "dec", "z", "i", "gal_type", "halomass", "satellite", "log_mass")


def thin_universe(density=DENSITY):
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


def galaxies(universe, camera, structure, pix):
    """Return the COLUMNS of the galaxies of a brick."""
    streams, population = _streams(SEED, pix, "galaxies"), _population(universe, camera)
    if structure == "none":
        z, log_mass, kind = population.grid.draw(
            streams("mass"), streams("count").poisson(population.grid.total * AREA_DEG2)
        )
        sample = {"z": z, "log_mass": log_mass, "gal_type": kind}
        sample["ra"], sample["dec"], _ = place(pix, streams("position"), len(z))
        sample |= {"halomass": np.full(len(z), np.nan), "satellite": np.full(len(z), -1, np.int8)}
    else:
        sample = _clustered(SEED, universe, camera, structure).sample(pix, streams, AREA_DEG2)
    sample["i"] = population.properties(streams, sample["z"], sample["log_mass"], sample["gal_type"])["i"]
    return {name: sample[name][sample["i"] < population.limit] for name in COLUMNS}


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--bricks", type=int, default=64, choices=(1, 4, 16, 64, 256))
    parser.add_argument("--first", type=int, default=FIRST, help="first brick, a multiple of `bricks`")
    parser.add_argument("--structure", default="haloes", choices=("haloes", "field", "none"))
    parser.add_argument("--output", type=Path, default=Path("results/clustered_sky"))
    args = parser.parse_args()
    if args.first % args.bricks or not 0 <= args.first < BRICKS:
        parser.error(f"--first {args.first}: needs a multiple of {args.bricks} below {BRICKS}")
    universe, camera = thin_universe(), load_camera()
    parts = []
    for pix in progress(range(args.first, args.first + args.bricks), "bricks"):
        part = galaxies(universe, camera, args.structure, pix)
        parts.append(part | {"brick": np.full(len(part["z"]), pix)})
    args.output.mkdir(parents=True, exist_ok=True)
    path = args.output / f"{args.structure}.npz"
    np.savez(path, **{name: np.concatenate([part[name] for part in parts]) for name in parts[0]})
    print(path, sum(len(part["z"]) for part in parts), "galaxies")


if __name__ == "__main__":
    main()
