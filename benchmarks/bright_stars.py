"""Flux and size of bright stars, with the brighter-fatter effect corrected and not.

    python benchmarks/campaign_gates.py examples/quarter_brick/no_cti.yaml
    python benchmarks/bright_stars.py [--filters r NUV]

Measures the frames of the finished campaign again. Records medians of isolated stars: PSF flux over the true one, less
1, and size over that of the PSF model, less 1. At toy size it makes a campaign of one small chip.
"""

import argparse
from contextlib import nullcontext
from unittest.mock import patch

from evidence.record import Record

import numpy as np
from transfer_residual import measured, toy_campaign

from csstsim.campaign.opened import OpenCampaign
from csstsim.measure.bricks.validation.compare import spread
from csstsim.measure.bricks.validation.trials import joined

SNR = (50, 100), (100, 200), (200, 500), (500, 1500)
CORRECTION = "csstsim.measure.calibration.charge_correction.move_back"


def main(record: Record) -> None:
    """Measure with the correction and without."""
    given, toy = record.options, record.toy
    run = OpenCampaign(toy_campaign(record.results / "bright_stars") if toy else given.campaign)
    rows = []
    for band in given.filters[:1] if toy else given.filters:
        jobs = [job for job in run.imaging_jobs if job.chip.filter == band]
        stars = {}
        for when, without in (("before", patch(CORRECTION)), ("after", nullcontext())):
            with without:
                table = joined([measured(run, job)[0] for job in jobs])
            stars[when] = table.with_columns(flux=100 * (table["light"] - 1), size=100 * table["psf_size"])
        for low, high in SNR:
            some = {
                when: (t["sound"] > 0) & ~t["galaxy"].astype(bool) & (t["lonely"] > 0) & np.isfinite(t["size"])
                & (t["snr"] >= low) & (t["snr"] < high)
                for when, t in stars.items()
            }  # fmt: skip
            if min(each.sum() for each in some.values()) < 2 and not toy:
                continue
            cells = []
            for quantity in ("flux", "size"):
                for when, table in stars.items():
                    found = spread(table[quantity][some[when]])
                    median, error = (np.nan if found[k] is None else found[k] for k in ("median", "error"))
                    cells.append(f"{median:+.2f} ± {error:.2f}")
                    what = (
                        f"median {quantity} of stars of S/N {low} to {high} in {band}, out / in - 1, {when} correction"
                    )
                    key = f"{band}_{low}_{quantity}_{when}"
                    record.value(key, median, what, unit="%", error=error)
            rows.append([band, f"{low} to {high}", some["after"].sum(), *cells])
    header = ["band", "S/N", "stars", "flux before, %", "flux after, %", "size before, %", "size after, %"]
    record.table("stars", header, rows)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("campaign", nargs="?", default="examples/quarter_brick/no_cti.yaml")
    parser.add_argument("--filters", nargs="+", default=["r", "NUV"])
    with Record(parser) as record:
        main(record)
