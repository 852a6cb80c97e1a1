"""The tables of docs/budget_shear.md, from a finished `csstsim budget shear`: python benchmarks/budget_shear.py FOLDER

FOLDER is that command's output: its budget.ecsv. Printed are, for each sample, the bars by the first estimator, then
the scatter of half the difference of the arms with one seed and with two, by estimator. With --blind FOLDER, an answer
to a blind test is written instead (`--answer FILE`): the mean shape of each field by hsm, over 1 + m of the base in
the budget; errors are those of the mean of rings.
"""

import argparse
import csv
from pathlib import Path

import numpy as np
from astropy.table import Table

from csstsim.budget.shear.estimators import Shapes, hsm
from csstsim.budget.shear.response import NAMES
from csstsim.budget.shear.run import to_sky
from csstsim.budget.shear.sample import RING
from csstsim.budget.shear.volume import GOALS, HOUR, sigma_m, volume


def bars(table):
    """Print the bars of each sample."""
    for sample in dict.fromkeys(table["sample"]):
        of = table[table["sample"] == sample]
        of = of[of["estimator"] == of["estimator"][0]]
        print(f"\n{sample}, {of['galaxies'][0]} galaxies, {of['estimator'][0]}\n")
        print("| effect | m1 | m2 | c1 | c2 | alpha | CPU-h for 3e-4 | for 1e-4 |\n|---|---|---|---|---|---|---|---|")
        for row in of:
            numbers = [_pair(row, name) for name in NAMES]
            bar = row["kind"] in ("base", "bar") and np.isfinite(sigma_m(row))
            hours = [f"{volume(row, goal)[1]:.2g}" if bar else "" for goal in GOALS]
            print("| " + " | ".join([row["about"], *numbers, *hours]) + " |")


def _pair(row, name):
    unit = 1e-2 if name == "alpha" else 1e-4
    value, error = row[name] / unit, row[f"{name}_err"] / unit
    return f"{value:+.1f} ± {error:.1f}" if np.isfinite(error) else f"{value:+.1f}"


def gains(table):
    """Print the scatter of the arms."""
    print("\n| sample | estimator | effect | one seed | two seeds | gain | volume |\n|---|---|---|---|---|---|---|")
    for row in table[np.isin(table["kind"], ("base", "bar"))]:
        words = row["sample"], row["estimator"], row["effect"]
        one, two, gain = row["scatter"], row["scatter_two"], row["gain"]
        print(f"| {' | '.join(words)} | {one:.4f} | {two:.4f} | {gain:.1f} | {gain**2:.0f} |")


def answer(folder, m, file):
    """Write the answer to a blind test; m (2,): of the base."""
    from astropy.io import fits

    with open(file, "w", newline="") as out:
        writer = csv.writer(out)
        writer.writerow(["field", "g1", "g2", "g1_err", "g2_err"])
        for number, path in enumerate(sorted(Path(folder).glob("field_*.fits"))):
            with fits.open(path) as hdus:
                image, psf, where = hdus["IMAGE"].data, hdus["PSF"].data, hdus["GALAXIES"].data
            half = psf.shape[-1] // 2
            side = np.arange(-half, half)
            x, y = (np.rint(where[name]).astype(int) for name in ("x", "y"))
            stamps = image[y[:, None, None] + side[:, None], x[:, None, None] + side].astype(float)
            shapes = hsm(stamps, psf.astype(float), 0.0, 0.0, None)
            e = to_sky(Shapes(shapes.e, shapes.response), np.array(where["jacobian"], float), True).e
            rings = np.array([ring.mean() for ring in e.reshape(-1, RING) if np.isfinite(ring).all()])
            error = [np.std(part, ddof=1) / np.sqrt(len(rings)) for part in (rings.real, rings.imag)]
            mean = rings.mean()
            writer.writerow([number, mean.real / (1 + m[0]), mean.imag / (1 + m[1]), *error])


def main():
    """Run as the module says."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder")
    parser.add_argument("--blind")
    parser.add_argument("--answer")
    options = parser.parse_args()
    table = Table.read(Path(options.folder) / "budget.ecsv")
    if options.blind:
        base = table[(table["kind"] == "base") & (table["estimator"] == "hsm")][0]
        answer(options.blind, (base["m1"], base["m2"]), options.answer)
        return
    bars(table)
    gains(table)
    spent = {row["sample"]: row["galaxies"] for row in table if row["kind"] == "base"}
    print(f"\ngalaxies: {spent}; hours of the bars: {sum(_hours(table)):.2f}")


def _hours(table):
    first = table[table["estimator"] == table["estimator"][0]]
    return [row["galaxies"] * row["seconds"] / HOUR for row in first if row["kind"] == "bar"]


if __name__ == "__main__":
    main()
