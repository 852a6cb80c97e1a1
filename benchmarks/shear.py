"""Shear: m and c of stamps and photons against the reference's, on the same galaxies (shear_response).

    python benchmarks/shear.py [--shapes 300] [--photons 3e10] [--seed 1] [--folder DIR]

Galaxies with half-light radii of 0.2" to 0.6" are spread over the r-band chip, each in eight versions. Photons are
shared equally by all images. Measurements are kept in the folder, if one is given, in parts of 20 galaxies: such a run
continues where it was stopped, and more --shapes with the same photons per image add to it. After a change of the code
use another folder. 3e10 photons take 20 CPU-minutes, 3 of them for the reference.
"""

import argparse
import tempfile
from pathlib import Path

from evidence.record import Record

import numpy as np
from bench_setting import setting_of
from shear_response import VERSIONS, bias, make_galaxies, measure, photons, reference, stamps, true_shapes

from csstsim.base.files.atomic import atomic_path
from csstsim.base.process.progress import progress
from csstsim.studies.bench.setting import Setting

PART, TOY_PART = 20, 3  # galaxies
TOY_SHAPES, TOY_PHOTONS = 3, 2.4e6
COLUMNS = "m1 / 1e-3", "m2 / 1e-3", "c1 / 1e-4", "c2 / 1e-4"
M_GOAL, C_GOAL = 1e-3, 1e-4


def measured(path, make):
    """Return the array kept at `path`; make it if there is none."""
    if not path.exists():
        with atomic_path(path) as temporary, open(temporary, "wb") as file:
            np.save(file, make())
    return np.load(path)


def run(setting: Setting, folder: Path, shapes: int, size: int, electrons: float, seed: int) -> tuple[np.ndarray, dict]:
    """Return (true, {method: measured}) shapes of all versions of the galaxies.

    size: galaxies of a part; electrons: per image.
    """
    parts = []
    for part in progress(range(-(-shapes // size)), "drawing galaxies"):
        table = make_galaxies(setting, size, electrons, part, seed=seed)
        ways = {"reference": reference, "stamps": stamps, "photons": photons(seed, part)}
        found = {"true": true_shapes(table)}
        for name, draw in ways.items():
            light = f"_{electrons:.4g}" if name == "photons" else ""
            path = folder / f"shear_{name}{light}_{seed}_{part}.npy"
            found[name] = measured(path, lambda table=table, draw=draw: measure(setting, table, draw))
        parts.append(found)
    joined = {name: np.concatenate([found[name] for found in parts])[: shapes * VERSIONS] for name in parts[0]}
    return joined.pop("true"), joined


def report(record: Record, true: np.ndarray, found: dict[str, np.ndarray]) -> None:
    """Record m and c of the reference, and of each method minus the reference."""
    standard = found["reference"]
    made = {"reference": ("reference, HSM's bias included", bias(standard, true))}
    for name in ("stamps", "photons"):
        made[name] = f"{name} - reference", bias(found[name], true, standard)
    rows = []
    for title, one in made.values():
        values = [*zip(1e3 * one.m, 1e3 * one.m_error, strict=True), *zip(1e4 * one.c, 1e4 * one.c_error, strict=True)]
        digits = [max(1, 1 - int(np.floor(np.log10(max(error, 1e-9))))) for _, error in values]
        rows.append([title, *(f"{v:.{n}f} ± {error:.{n}f}" for (v, error), n in zip(values, digits, strict=True))])
    record.table("bias", ["", *COLUMNS], rows)
    for name in ("stamps", "photons"):
        one = made[name][1]
        for i in range(2):
            record.value(f"{name}_m{i + 1}", one.m[i], f"{name} minus reference: m{i + 1}", error=one.m_error[i])
            record.value(f"{name}_c{i + 1}", one.c[i], f"{name} minus reference: c{i + 1}", error=one.c_error[i])
        for key, values, errors, goal in (("m", one.m, one.m_error, M_GOAL), ("c", one.c, one.c_error, C_GOAL)):
            i = np.abs(values).argmax()
            met = bool((np.abs(values) - 2 * errors < goal).all())  # chance may carry it above
            what = f"{name} minus reference: largest |{key}|, below {goal:g} and two errors"
            record.value(f"{name}_{key}", abs(values[i]), what, error=errors[i], goal=met)
    failed = sum(int(np.isnan(shapes).sum()) for shapes in found.values())
    record.value("failed", failed, "shapes that HSM could not measure, of all methods")


def main(record: Record) -> None:
    """Draw and measure the galaxies by each method."""
    options, toy = record.options, record.toy
    shapes, light, size = (TOY_SHAPES, TOY_PHOTONS, TOY_PART) if toy else (options.shapes, options.photons, PART)
    electrons = light / shapes / VERSIONS
    with tempfile.TemporaryDirectory() as temporary:
        folder = options.folder or Path(temporary)
        folder.mkdir(parents=True, exist_ok=True)
        true, found = run(setting_of(record, "r"), folder, shapes, size, electrons, options.seed)
    print(f"{shapes} galaxies and twins, {VERSIONS * shapes} images of {electrons:.3g} photons: {light:.3g} in all")
    report(record, true, found)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--shapes", type=int, default=300, help="galaxies, each with its twin")
    parser.add_argument("--photons", type=float, default=3e10, help="in all")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--folder", type=Path, help="for the measurements, if they are to be kept")
    with Record(parser) as record:
        main(record)
