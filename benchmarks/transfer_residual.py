"""Stars' position and flux residuals against their rows to the amplifier, with charge transfer corrected and not.

    snakemake --profile profiles/default --config campaign=examples/quarter_brick/cti.yaml
    python benchmarks/transfer_residual.py [examples/quarter_brick/cti.yaml] [--filters r NUV] [--passes 0 1 3 5]

Measures the frames of a finished campaign with the paper's traps again for each number of passes of the correction.
Prints medians of isolated stars by rows to the amplifier, and the CPU seconds of each correction; draws
docs/figures/transfer_residual.png.
"""

import argparse
import time

import numpy as np

from csstsim.bricks.validation.trials import joined, trials
from csstsim.bricks.validation.validate import MeasuredFrame, judged_truth
from csstsim.campaign.opened import OpenCampaign
from csstsim.measure.catalogue import measure_frame
from csstsim.stages import level0 as level0_stage
from csstsim.stages.calibrate import calibrated_frame
from csstsim.stages.psf import open_psf

FIGURE = "docs/figures/transfer_residual.png"
SNR = 20.0, 500.0
BINS = 5


def measured(run, job):
    """Return (trials of a job's frame, CPU s of its calibration)."""
    start = time.process_time()
    file, calibrated = calibrated_frame(run, job)
    cost = time.process_time() - start
    table = measure_frame(
        calibrated, open_psf(run, job.chip), job.wcs, file.observer, obsid=job.obsid, chip=job.chip,
        filter=run.camera.filters[job.chip.filter], telescope=run.camera.telescope, pointing=job.pointing,
        window=job.window,
    )  # fmt: skip
    frame = MeasuredFrame(
        level0_stage.truth_of(run, job), table, run.camera.detector.channel_ny, run.camera.telescope.pixel_scale
    )
    return trials(judged_truth(frame), frame), cost


def binned(table, name, edges):
    """Return (median, its error) of stars in bins of their rows to the amplifier."""
    good = (table["sound"] > 0) & ~table["galaxy"].astype(bool) & (table["snr"] > SNR[0]) & (table["snr"] < SNR[1])
    rows, values = table["transfers"][good], table[name][good] - (name == "light")
    which = np.digitize(rows, edges[1:-1])
    bins = [values[which == k] for k in range(len(edges) - 1)]
    some = [v if len(v) > 2 else np.full(3, np.nan) for v in bins]
    return np.array([(np.median(v), 1.2533 * np.std(v) / np.sqrt(len(v))) for v in some]).T


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("campaign", nargs="?", default="examples/quarter_brick/cti.yaml")
    parser.add_argument("--filters", nargs="+", default=["r", "NUV"])
    parser.add_argument("--passes", type=int, nargs="+", default=[0, 1, 3])
    options = parser.parse_args()
    run = OpenCampaign(options.campaign)
    results = {}
    for band in options.filters:
        jobs = [job for job in run.imaging_jobs if job.chip.filter == band]
        for passes in options.passes:
            change = run.config.measurement.model_copy(update={"cti_passes": passes})
            run.config = run.config.model_copy(update={"measurement": change})
            found = [measured(run, job) for job in jobs]
            table = results[band, passes] = joined([part for part, _ in found])
            edges = np.linspace(table["transfers"].min(), table["transfers"].max(), BINS + 1)
            print(
                f"{band}, {passes} passes, {sum(cost for _, cost in found):.1f} CPU s to calibrate {len(jobs)} frames"
            )
            for name, unit, said in (("deferred_mas", 1, "place [mas]"), ("light", 100, "light [%]")):
                median, error = unit * binned(table, name, edges)
                row = ", ".join(f"{m:+.2f} +- {e:.2f}" for m, e in zip(median, error, strict=True))
                print(f"  {said}, rows {edges[0]:.0f} to {edges[-1]:.0f}: {row}", flush=True)
    draw(results, options)


def draw(results, options):
    from matplotlib.figure import Figure

    figure = Figure(figsize=(5.2 * len(options.filters), 7.5), layout="constrained")
    axes = figure.subplots(2, len(options.filters), sharex=True, squeeze=False)
    for column, band in zip(axes.T, options.filters, strict=True):
        for (filter_, passes), table in results.items():
            if filter_ != band:
                continue
            edges = np.linspace(table["transfers"].min(), table["transfers"].max(), BINS + 1)
            for axis, name, unit in zip(column, ("deferred_mas", "light"), (1, 100), strict=True):
                median, error = unit * binned(table, name, edges)
                label = "as read" if passes == 0 else f"corrected, passes: {passes}"
                axis.errorbar(0.5 * (edges[1:] + edges[:-1]), median, error, marker="o", ms=4, capsize=2, label=label)
        for axis, label in zip(
            column, ("position, away from the amplifier [mas]", "flux, out / in - 1 [%]"), strict=True
        ):
            axis.axhline(0, color="0.5", lw=0.8)
            axis.set_ylabel(label)
        column[0].set_title(f"{band}: stars of S/N {SNR[0]:.0f} to {SNR[1]:.0f}, the paper's traps", fontsize=10)
        column[1].set_xlabel("rows to the amplifier")
        column[0].legend(fontsize=8)
    figure.savefig(FIGURE, dpi=100)
    print(FIGURE)


if __name__ == "__main__":
    main()
