"""The tables of docs/budget_shear.md, from finished `csstsim budget shear`: python benchmarks/budget_shear.py FOLDER...

Each FOLDER is that command's output: its budget.ecsv. Printed are, for each sample, the bars by the first estimator,
then the scatter of half the difference of the arms with one seed and with two, by estimator, and what the bars cost.
With --csv FILE, all rows go to a table, too. With --blind FOLDER, an answer
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
from csstsim.budget.shear.volume import GOALS, sigma_m, volume


def bars(table):
    """Print the bars of each sample."""
    for sample in dict.fromkeys(table["sample"]):
        of = table[table["sample"] == sample]
        of = of[of["estimator"] == of["estimator"][0]]
        print(f"\n{sample}, {of['galaxies'][0]} galaxies, {of['estimator'][0]}\n")
        print("| effect | windows | m1 | m2 | c1 | c2 | alpha | sigma(m) 1e-4: CPU-h |")
        print("|---|---|---|---|---|---|---|---|")
        for row in of:
            numbers = [_pair(row, name) for name in NAMES]
            bar = row["kind"] in ("base", "bar") and np.isfinite(sigma_m(row))
            hours = f"{volume(row, min(GOALS))[1]:.2g}" if bar else ""
            print("| " + " | ".join([row["about"], str(row["windows"]), *numbers, hours]) + " |")


def _pair(row, name):
    unit = 1e-2 if name == "alpha" else 1e-4
    value, error = row[name] / unit, row[f"{name}_err"] / unit
    digits = 2 if 0 < error < 0.1 else 1
    return f"{value:+.{digits}f} ± {error:.{digits}f}" if np.isfinite(error) else f"{value:+.1f}"


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
    parser.add_argument("folders", metavar="FOLDER", nargs="+")
    parser.add_argument("--csv")
    parser.add_argument("--blind")
    parser.add_argument("--answer")
    options = parser.parse_args()
    tables = [Table.read(Path(folder) / "budget.ecsv") for folder in options.folders]
    table = tables[0]
    if options.blind:
        base = table[(table["kind"] == "base") & (table["estimator"] == "hsm")][0]
        answer(options.blind, (base["m1"], base["m2"]), options.answer)
        return
    for table in tables:
        bars(table)
        gains(table)
        for sample in dict.fromkeys(table["sample"]):
            of = table[(table["sample"] == sample) & (table["estimator"] == table["estimator"][0])]
            of = of[(of["kind"] == "bar") & np.isfinite([sigma_m(row) for row in of])]
            hours = [[volume(row, goal)[1] for row in of] for goal in GOALS]
            most, now = of["effect"][np.argmax(hours[1])], [sigma_m(row) for row in of]
            print(
                f"\n{sample}: {len(of)} bars, {sum(s <= GOALS[0] for s in now)} with sigma(m) of at most {GOALS[0]:g}"
            )
            print(f"largest: {max(now):.2g}; CPU-h to {GOALS}: {sum(hours[0]):.2g}, {sum(hours[1]):.2g}")
            print(f"dearest at {GOALS[1]:g}: {most}, {max(hours[1]):.2g} CPU-h")
    if options.csv:
        write(tables, options.csv)


def write(tables, file):
    """Write all rows to a CSV, five digits a number; `spacing` and `noise` are those of the plan."""
    lines = []
    for table in tables:
        same = table.meta["plan"]["spacing"], table.meta["plan"]["base"]["noise"]
        for row in table:
            values = [f"{v:.5g}" if isinstance(v, float) else v for v in row.values()]
            lines.append([values[0], *same, *values[1:]])
    with open(file, "w", newline="") as out:
        csv.writer(out).writerows([["sample", "spacing", "noise", *tables[0].colnames[1:]], *lines])


if __name__ == "__main__":
    main()
