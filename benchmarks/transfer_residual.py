"""Stars' position and flux residuals against their rows to the amplifier, with charge transfer corrected and not.

    python benchmarks/campaign_gates.py examples/quarter_brick/cti.yaml
    python benchmarks/transfer_residual.py [examples/quarter_brick/cti.yaml] [--filters r NUV] [--passes 0 1 3]

Measures the frames of a finished campaign with the paper's traps again for each number of passes of the correction.
Records medians of isolated stars by rows to the amplifier, and the CPU seconds of each correction; draws
docs/figures/transfer_residual.png. At toy size it makes a campaign of one small chip.
"""

import argparse
import time
from pathlib import Path

from evidence.record import Record

import numpy as np
from matplotlib.figure import Figure
from support.mini_campaign import write_campaign
from toy_sky import toy_sky

from csstsim.campaign.job import Job
from csstsim.campaign.opened import OpenCampaign
from csstsim.catalog.astrometry.reduction import icrs
from csstsim.catalog.table import ObjectTable
from csstsim.command_line.main import main as csstsim
from csstsim.measure.bricks.validation.measured_frame import MeasuredFrame, truth_inside
from csstsim.measure.bricks.validation.trials import joined, trials
from csstsim.measure.catalogue import FrameFacts, measure_frame
from csstsim.stages import level0 as level0_stage
from csstsim.stages.calibrate import calibrated_frame
from csstsim.stages.psf import open_psf

SNR = 20.0, 500.0
BINS = 5
QUANTITIES = {"deferred_mas": ("position", "mas", 1), "light": ("flux", "%", 100)}
TOY_SIDE = 512  # px


def toy_campaign(folder: Path) -> Path:
    """Make a campaign of one r chip of TOY_SIDE px with stars and galaxies; return its file."""
    side = {"nx": TOY_SIDE, "ny": TOY_SIDE, "channel_nx": TOY_SIDE // 8, "channel_ny": TOY_SIDE // 2}
    pointing = "10100000001,SCIE,60.15,-40.0,20.0,2027-11-20T01:08:00,150"
    job = OpenCampaign(write_campaign(folder, [pointing], geometry=side)).job("10100000001", 9)
    ra, dec = (float(angle) for angle in icrs(*job.wcs.pixel_to_world(TOY_SIDE / 2, TOY_SIDE / 2), job.observer))
    sky = toy_sky(folder, ra, dec, radius=TOY_SIDE * 0.074 / 3600 / 2)
    file = write_campaign(folder, [pointing], geometry=side, **sky)
    csstsim(["chip", str(file), "--obsid", job.obsid, "--chip", "9"], standalone_mode=False)
    return file


def measured(run: OpenCampaign, job: Job) -> tuple[ObjectTable, float]:
    """Return (trials of a job's frame, CPU s of its calibration)."""
    start = time.process_time()
    file, calibrated = calibrated_frame(run, job)
    cost = time.process_time() - start
    table = measure_frame(
        calibrated,
        open_psf(run, job.chip),
        job.wcs,
        file.observer,
        FrameFacts.of(job),
    )
    frame = MeasuredFrame(
        level0_stage.truth_of(run, job), table, run.camera.detector.channel_ny, run.camera.telescope.pixel_scale
    )
    return trials(truth_inside(frame), frame), cost


def binned(table: ObjectTable, name: str, edges: np.ndarray) -> np.ndarray:
    """Return (median, its error) of stars in bins of their rows to the amplifier."""
    good = (table["sound"] > 0) & ~table["galaxy"].astype(bool) & (table["snr"] > SNR[0]) & (table["snr"] < SNR[1])
    rows, values = table["transfers"][good], table[name][good] - (name == "light")
    which = np.digitize(rows, edges[1:-1])
    bins = [values[which == k] for k in range(len(edges) - 1)]
    some = [v if len(v) > 2 else np.full(3, np.nan) for v in bins]
    return np.array([(np.median(v), 1.2533 * np.std(v) / np.sqrt(len(v))) for v in some]).T


def edges_of(table: ObjectTable) -> np.ndarray:
    """Return the edges of the bins of rows."""
    return np.linspace(table["transfers"].min(), table["transfers"].max(), BINS + 1)


def main(record: Record) -> None:
    """Measure with each number of passes, and draw."""
    given, toy = record.options, record.toy
    run = OpenCampaign(toy_campaign(record.results / "transfer_residual") if toy else given.campaign)
    filters = given.filters[:1] if toy else given.filters
    results, rows = {}, []
    for band in filters:
        jobs = [job for job in run.imaging_jobs if job.chip.filter == band]
        for passes in given.passes:
            change = run.config.measurement.model_copy(update={"cti_passes": passes})
            run.config = run.config.model_copy(update={"measurement": change})
            found = [measured(run, job) for job in jobs]
            table = results[band, passes] = joined([part for part, _ in found])
            cost = sum(seconds for _, seconds in found) / len(jobs)
            said = f"a frame of {band} calibrated, {passes} passes"
            record.value(f"{band}_{passes}_cpu", cost, said, unit="CPU-s")
            for name, (quantity, unit, scale) in QUANTITIES.items():
                median, error = scale * binned(table, name, edges_of(table))
                pairs = list(zip(median, error, strict=True))
                rows.append([band, passes, f"{quantity}, {unit}", *(f"{m:+.2f} ± {e:.2f}" for m, e in pairs)])
                worst, its_error = max(pairs, key=lambda pair: abs(np.nan_to_num(pair[0])))
                what = f"median {quantity} residual of stars in {band}, {passes} passes: the fifth of rows farthest off"
                record.value(f"{band}_{passes}_{quantity}", worst, what, unit=unit, error=its_error)
    fifths = [f"fifth {k + 1}" for k in range(BINS)]
    record.table("residuals", ["band", "passes", "residual by rows to the amplifier", *fifths], rows)
    draw(results, filters, record.figure("transfer_residual.png"))


def draw(results: dict[tuple[str, int], ObjectTable], filters: list[str], file: Path) -> None:
    """Draw residuals against rows."""
    figure = Figure(figsize=(5.2 * len(filters), 7.5), layout="constrained")
    axes = figure.subplots(2, len(filters), sharex=True, squeeze=False)
    for column, band in zip(axes.T, filters, strict=True):
        for (filter_, passes), table in results.items():
            if filter_ != band:
                continue
            edges = edges_of(table)
            for axis, (name, (_, _, scale)) in zip(column, QUANTITIES.items(), strict=True):
                median, error = scale * binned(table, name, edges)
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
    figure.savefig(file, dpi=100)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("campaign", nargs="?", default="examples/quarter_brick/cti.yaml")
    parser.add_argument("--filters", nargs="+", default=["r", "NUV"])
    parser.add_argument("--passes", type=int, nargs="+", default=[0, 1, 3])
    with Record(parser) as record:
        main(record)
