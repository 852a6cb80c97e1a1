"""Shear: m and c of stamps and photons against the reference's, on the same galaxies (shear_response).

    python benchmarks/shear.py [--shapes 300] [--photons 3e10] [--seed 1] [--folder DIR] [--quick]

Galaxies with half-light radii of 0.2" to 0.6" are spread over the r-band chip, each in eight versions. Photons are
shared equally by all images. Measurements are kept in the folder, in parts of 20 galaxies: an interrupted run continues
where it stopped, and more --shapes with the same photons per image add to it. After a change of the code use another
folder. 3e10 photons take 20 CPU-minutes, 3 of them for the reference. --quick: 20 galaxies, 2e8 photons, a minute.
"""

import argparse
import tempfile
from pathlib import Path

import numpy as np
from shear_response import VERSIONS, bias, make_galaxies, measure, photons, reference, stamps, true_shapes

from csstsim.base.files.atomic import atomic_path
from csstsim.base.process.progress import progress
from csstsim.bench.setting import make_setting

PART = 20  # galaxies


def measured(path, make):
    """Return the array kept at `path`; make it if there is none."""
    if not path.exists():
        with atomic_path(path) as temporary, open(temporary, "wb") as file:
            np.save(file, make())
    return np.load(path)


def run(folder, shapes, electrons, seed):
    """Return (true, {method: measured}) shapes of all versions of the galaxies; `electrons`: per image."""
    setting = make_setting(folder, "r")
    parts = []
    for part in progress(range(-(-shapes // PART)), "drawing galaxies"):
        table = make_galaxies(setting, PART, electrons, part, seed=seed)
        ways = {"reference": reference, "stamps": stamps, "photons": photons(seed, part)}
        found = {"true": true_shapes(table)}
        for name, draw in ways.items():
            light = f"_{electrons:.4g}" if name == "photons" else ""
            path = folder / f"shear_{name}{light}_{seed}_{part}.npy"
            found[name] = measured(path, lambda table=table, draw=draw: measure(setting, table, draw))
        parts.append(found)
    joined = {name: np.concatenate([found[name] for found in parts])[: shapes * VERSIONS] for name in parts[0]}
    return joined.pop("true"), joined


def report(true, found):
    """Print m and c of each method, and of each minus the reference."""
    print(f"{'':22s} {'m1 / 1e-3':>19s} {'m2 / 1e-3':>19s} {'c1 / 1e-4':>19s} {'c2 / 1e-4':>19s} {'HSM failed':>10s}")
    standard = found["reference"]
    rows = [(name, bias(shapes, true), shapes) for name, shapes in found.items()]
    rows += [(f"{name} - reference", bias(found[name], true, standard), found[name]) for name in ("stamps", "photons")]
    for name, one, shapes in rows:
        values = [*zip(1e3 * one.m, 1e3 * one.m_error, strict=True), *zip(1e4 * one.c, 1e4 * one.c_error, strict=True)]
        print(f"{name:22s}", *(f"{v:8.4f} +- {error:7.4f}" for v, error in values), f"{np.isnan(shapes).sum():10d}")


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--shapes", type=int, default=300, help="galaxies, each with its twin")
    parser.add_argument("--photons", type=float, default=3e10, help="in all")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--folder", type=Path, help="for the PSF set and the measurements")
    parser.add_argument("--quick", action="store_true")
    options = parser.parse_args()
    shapes, light = (20, 2e8) if options.quick else (options.shapes, options.photons)
    electrons = light / shapes / VERSIONS
    with tempfile.TemporaryDirectory() as temporary:
        folder = options.folder or Path(temporary)
        folder.mkdir(parents=True, exist_ok=True)
        true, found = run(folder, shapes, electrons, options.seed)
    print(f"{shapes} galaxies and twins, {VERSIONS * shapes} images of {electrons:.3g} photons: {light:.3g} in all")
    report(true, found)


if __name__ == "__main__":
    main()
