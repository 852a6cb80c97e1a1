"""Figures of slitless spectra: extracted and true spectra, and cutouts with their traces.

    snakemake --cores 2                           # the demo
    python benchmarks/slitless_spectra.py [CAMPAIGN --obsid 10100000015 --chip 29]

Shows the star with the most light, and the galaxy or quasar with the strongest line, of a finished frame. Compares all
spectra with the truth.
"""

import argparse
import io

from evidence import ROOT
from evidence.record import Record

import numpy as np
from PIL import Image
from slitless_toy import CHIP, OBSID, toy_campaign

from csstsim.campaign.opened import OpenCampaign
from csstsim.catalog.table import TYPES, ObjectTable
from csstsim.measure.spectra.extract import CUT, DIM, LOST, extract_spectra
from csstsim.measure.spectra.spectra_figures import spectra_figure
from csstsim.stages import chip as chip_stage
from csstsim.stages.extract import spectra_of_frame

DEMO = ROOT / "config" / "campaign.yaml"
LEAST = 50  # usable columns of a spectrum that counts


def compared(truth: ObjectTable, table: ObjectTable) -> tuple[list[float], list[float]]:
    """Print for each spectrum its light over the true, pulls, and others' light; return the first ratios, widths."""
    ratios, widths = [], []
    print("row  kind    mag   columns  optimal/true  box/true  error   pull mean, width  others/true")
    for row in np.unique(table["row"]):
        part = table.take((table["row"] == row) & (table["flags"] & (DIM | LOST | CUT) == 0))
        if len(part) < LEAST:
            continue
        light, box, true, error, others = (
            part[name].astype(float) for name in ("electrons", "box", "model", "electrons_err", "contamination")
        )
        pull, total = (light - true) / error, true.sum()
        ratios.append(light.sum() / total)
        widths.append(pull.std())
        print(
            f"{row:4d} {TYPES[truth['obj_type'][row]]:7s} {truth['mag'][row]:5.2f} {len(part):6d} "
            f"{ratios[-1]:12.4f} {box.sum() / total:10.4f} {np.sqrt((error**2).sum()) / total:8.4f} "
            f"{pull.mean():8.2f} {widths[-1]:6.2f} {others.sum() / total:10.3f}"
        )
    return ratios, widths


def main(record: Record) -> None:
    """Extract the spectra of the frame, which is drawn first at toy size."""
    options = record.options
    if record.toy:
        options.campaign, options.obsid, options.chip = toy_campaign(record.results / "slitless_spectra"), OBSID, CHIP
    run = OpenCampaign(options.campaign)
    job = run.job(options.obsid, options.chip)
    if record.toy:
        chip_stage.chip(run, job, log=lambda text: None)
    truth, frame, orders, *others = spectra_of_frame(run, job)
    table = extract_spectra(frame, orders, *others)
    ratios, widths = compared(truth, table)
    record.value("spectra", len(ratios), "spectra of a frame")
    record.value("ratio", np.median(ratios), "their light over the true one, median")
    record.value("width", np.median(widths), "width of their pulls, median")
    picture = Image.open(io.BytesIO(spectra_figure(truth, frame, orders, table, dpi=70))).convert("RGB")
    picture.quantize(256).save(record.figure("slitless_spectra.png"), optimize=True)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("campaign", nargs="?", default=DEMO)
    parser.add_argument("--obsid", default="10100000015")
    parser.add_argument("--chip", type=int, default=29)
    with Record(parser) as record:
        main(record)
