"""Figures of slitless spectra from a finished frame: extracted and true spectra, and cutouts with their traces.

    python benchmarks/slitless_spectra.py CAMPAIGN --obsid 10100000001 --chip 2

Shows the brightest star and the galaxy with the strongest emission line. Writes docs/figures/slitless_spectra.png and
prints a comparison of all spectra with the truth.
"""

import argparse
import io
from pathlib import Path

import numpy as np
from PIL import Image

from csstsim.campaign.opened import OpenCampaign
from csstsim.catalog.table import TYPES
from csstsim.measure.spectra.extract import CUT, DIM, LOST, extract_spectra
from csstsim.measure.spectra.spectra_figures import spectra_figure
from csstsim.stages.extract import spectra_of_frame

FIGURE = Path(__file__).resolve().parents[1] / "docs" / "figures" / "slitless_spectra.png"


def summary(truth, table):
    """Print for each spectrum the extracted light over the true, and mean and width of the differences in sigma."""
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
    parser.add_argument("--figure", type=Path, default=FIGURE)
    options = parser.parse_args()
    run = OpenCampaign(options.campaign)
    truth, frame, orders, *others = spectra_of_frame(run, run.job(options.obsid, options.chip))
    table = extract_spectra(frame, orders, *others)
    summary(truth, table)
    picture = Image.open(io.BytesIO(spectra_figure(truth, frame, orders, table, dpi=70))).convert("RGB")
    picture.quantize(64).save(options.figure, optimize=True)


if __name__ == "__main__":
    main()
