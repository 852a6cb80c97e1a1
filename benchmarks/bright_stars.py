"""Flux and size of bright stars by the number of passes of the brighter-fatter correction.

    snakemake --profile profiles/default --config campaign=examples/quarter_brick/no_cti.yaml
    python benchmarks/bright_stars.py [--filters r NUV] [--passes 0 1 2 3]

Measures the frames of the finished campaign again. Prints medians of isolated stars: PSF flux over the true one, less
1, and size over that of the PSF model, less 1.
"""

import argparse

import numpy as np
from transfer_residual import measured

from csstsim.bricks.validation.compare import spread
from csstsim.bricks.validation.trials import joined
from csstsim.campaign.opened import OpenCampaign
from csstsim.stages import calibrate as calibrate_stage

SNR = (50, 100), (100, 200), (200, 500), (500, 1500)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("campaign", nargs="?", default="examples/quarter_brick/no_cti.yaml")
    parser.add_argument("--filters", nargs="+", default=["r", "NUV"])
    parser.add_argument("--passes", type=int, nargs="+", default=[0, 1, 2, 3])
    options = parser.parse_args()
    run = OpenCampaign(options.campaign)
    print("| filter | passes | S/N | stars | light [%] | size [%] |\n|---|---|---|---|---|---|")
    for band in options.filters:
        jobs = [job for job in run.imaging_jobs if job.chip.filter == band]
        for calibrate_stage.PUSHES in options.passes:
            table = joined([measured(run, job)[0] for job in jobs])
            good = (table["sound"] > 0) & ~table["galaxy"].astype(bool) & (table["lonely"] > 0)
            for low, high in SNR:
                some = good & (table["snr"] >= low) & (table["snr"] < high) & np.isfinite(table["psf_size"])
                if some.sum() > 1:
                    figures = [spread(100 * values[some]) for values in (table["light"] - 1, table["psf_size"])]
                    said = " | ".join(f"{figure['median']:+.2f} +- {figure['error']:.2f}" for figure in figures)
                    print(f"| {band} | {calibrate_stage.PUSHES} | {low} - {high} | {some.sum()} | {said} |")


if __name__ == "__main__":
    main()
