"""Figures of slitless spectra from a finished frame: extracted against true, and cutouts with the traces over them.

    python benchmarks/slitless_spectra.py CAMPAIGN --obsid 10100000001 --chip 2

Takes the star with the most light and the galaxy whose emission line stands out most. Writes
docs/figures/slitless_spectra.png and slitless_cutouts.png, and prints how all spectra compare with the truth.
"""

import argparse
from pathlib import Path

import matplotlib
import numpy as np

from csstsim.analysis import spectra_of_frame
from csstsim.campaign import OpenCampaign
from csstsim.catalog.table import STAR, TYPES
from csstsim.measure.extract import CUT, DIM, LOST, extract_spectra
from csstsim.measure.spectra_figures import COLOURS, cutout_panel, line_strength, spectrum_panels, usable

matplotlib.use("agg")
from matplotlib import pyplot as plt
from matplotlib.lines import Line2D

FIGURES = Path(__file__).resolve().parents[1] / "docs" / "figures"


def chosen(truth, table):
    """Return rows of the truth table: the star with the most light, the galaxy with the strongest line."""
    spectra = {int(row): usable(table, row) for row in np.unique(table["row"])}
    spectra = {row: mine for row, mine in spectra.items() if mine is not None}
    stars = {r: table["model"][m].sum() for r, m in spectra.items() if truth["obj_type"][r] == STAR}
    others = {r: line_strength(table, m) for r, m in spectra.items() if truth["obj_type"][r] != STAR}
    return [max(some, key=some.get) for some in (stars, others) if some]


def title(truth, row):
    kind = TYPES[truth["obj_type"][row]]
    text = f"{kind}, {truth['mag'][row]:.2f} mag"
    if kind == "galaxy":
        text += f", z = {truth['z'][row]:.3f}, half-light radius {truth['size_disk'][row]:.2f} arcsec"
    return text


def draw_spectra(truth, table, rows, path):
    figure, axes = plt.subplots(2, len(rows), figsize=(6.5 * len(rows), 5.5), sharex="col", squeeze=False,
                                height_ratios=(2.2, 1), layout="constrained")  # fmt: skip
    for column, row in zip(axes.T, rows, strict=True):
        spectrum_panels(column, table, usable(table, row), title(truth, row))
    figure.savefig(path, dpi=80)


def draw_cutouts(truth, frame, orders, rows, path):
    figure, axes = plt.subplots(len(rows), 1, figsize=(10, 2.6 * len(rows)), squeeze=False, layout="constrained")
    for axis, row in zip(axes[:, 0], rows, strict=True):
        cutout_panel(axis, frame, orders, row, title(truth, row))
    axes[-1, 0].set_xlabel("x [px]")
    lines = [Line2D([], [], color=c, label=f"order {n:+d}" if n else "order 0") for n, c in COLOURS.items()]
    lines.append(Line2D([], [], color="k", ls="--", label="of others"))
    figure.legend(handles=lines, ncols=6, loc="outside lower center", fontsize=8, frameon=False)
    figure.savefig(path, dpi=56)


def summary(truth, table):
    """Print, spectrum by spectrum: light extracted over true, mean and width of the differences in sigma."""
    print("row  kind    mag   columns  optimal/true  box/true  error   pull mean, width  others/true")
    for row in np.unique(table["row"]):
        part = table.take((table["row"] == row) & (table["flags"] & (DIM | LOST | CUT) == 0))
        if len(part) < 50:
            continue
        light, box, true, error, others = (
            part[name].astype(float) for name in ("electrons", "box", "model", "electrons_err", "contamination")
        )
        pull = (light - true) / error
        print(
            f"{row:4d} {TYPES[truth['obj_type'][row]]:7s} {truth['mag'][row]:5.2f} {len(part):6d} "
            f"{light.sum() / true.sum():12.4f} {box.sum() / true.sum():10.4f} "
            f"{np.sqrt((error**2).sum()) / true.sum():8.4f} {pull.mean():8.2f} {pull.std():6.2f} "
            f"{others.sum() / true.sum():10.3f}"
        )


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("campaign")
    parser.add_argument("--obsid", required=True)
    parser.add_argument("--chip", type=int, required=True)
    parser.add_argument("--figures", type=Path, default=FIGURES)
    options = parser.parse_args()
    run = OpenCampaign(options.campaign)
    truth, frame, orders, *others = spectra_of_frame(run, run.job(options.obsid, options.chip))
    table = extract_spectra(frame, orders, *others)
    summary(truth, table)
    rows = chosen(truth, table)
    options.figures.mkdir(parents=True, exist_ok=True)
    draw_spectra(truth, table, rows, options.figures / "slitless_spectra.png")
    draw_cutouts(truth, frame, orders, rows, options.figures / "slitless_cutouts.png")


if __name__ == "__main__":
    main()
