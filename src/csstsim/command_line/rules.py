"""The commands of the workflow's rules: each calls the function of its name in csstsim.stages."""

from __future__ import annotations

import functools
import sys
from typing import TYPE_CHECKING

import click

from csstsim.command_line.options import Finite, brick_opt, chip_opt, of_bricks, of_job, of_jobs, scratch_opt, stage

if TYPE_CHECKING:
    from typing import Any

    from csstsim.campaign.job import Job
    from csstsim.campaign.opened import OpenCampaign


@click.command()
@stage
@brick_opt
def truth(run: OpenCampaign, pix: int) -> None:
    """Generate one truth brick of the embedded universe.

    \b
    For example:
      csstsim truth campaign.yaml --brick 550613
    """
    from csstsim.stages.truth import truth as run_stage

    run_stage(run, pix)


@click.command()
@stage
@chip_opt
def psf(run: OpenCampaign, chip_id: int) -> None:
    """Compute the PSF set of one chip.

    \b
    For example:
      csstsim psf campaign.yaml --chip 9
    """
    from csstsim.campaign.running.one_by_one import record_missing_psf
    from csstsim.stages.psf import psf as run_stage

    try:
        run_stage(run, chip_id)
    except Exception as exc:
        record_missing_psf(run, chip_id, exc)
        raise


@click.command()
@of_job
@scratch_opt
def select(run: OpenCampaign, job: Job) -> None:
    """Select the objects that reach a chip; compute electrons/s.

    \b
    For example:
      csstsim select campaign.yaml --obsid 10100000004 --chip 9
    """
    from csstsim.stages.select import select as run_stage

    run_stage(run, job)


@click.command()
@of_job
@scratch_opt
def render(run: OpenCampaign, job: Job) -> None:
    """Render the objects and the sky, in electrons.

    \b
    For example:
      csstsim render campaign.yaml --obsid 10100000004 --chip 9
    """
    from csstsim.stages.render import render as run_stage

    run_stage(run, job)


@click.command()
@of_job
@scratch_opt
def readout(run: OpenCampaign, job: Job) -> None:
    """Apply the detector: noise, overscan, bias, gain to DN.

    \b
    For example:
      csstsim readout campaign.yaml --obsid 10100000004 --chip 9
    """
    from csstsim.stages.readout import readout as run_stage

    run_stage(run, job)


@click.command()
@of_job
@scratch_opt
def level0(run: OpenCampaign, job: Job) -> None:
    """Digitise; write the Level-0 file and its truth table.

    \b
    For example:
      csstsim level0 campaign.yaml --obsid 10100000004 --chip 9
    """
    from csstsim.stages.level0 import level0 as run_stage

    run_stage(run, job)


@click.command()
@stage
@chip_opt
def masters(run: OpenCampaign, chip_id: int) -> None:
    """Combine bias, dark and flat exposures to master frames.

    \b
    For example:
      csstsim masters calibration.yaml --chip 9
    """
    from csstsim.stages.masters import masters as run_stage

    run_stage(run, chip_id)


@click.command()
@of_job
def calibrate(run: OpenCampaign, job: Job) -> None:
    """Calibrate a Level-0 file; write the image in electrons/s.

    \b
    For example:
      csstsim calibrate campaign.yaml --obsid 10100000004 --chip 9
    """
    from csstsim.stages.calibrate import calibrate as run_stage

    run_stage(run, job)


@click.command()
@of_jobs
def measure(run: OpenCampaign, jobs: list[Job], resume: bool) -> None:
    """Detect and measure the sources of Level-0 files.

    \b
    For example:
      csstsim measure campaign.yaml --obsid 10100000004 --chip 9
    Two chips, one after the other:
      csstsim measure campaign.yaml --obsid 10100000004 --chip 8 --chip 9
    """
    from csstsim.campaign.running.one_by_one import one_by_one
    from csstsim.stages.measure import measure as run_stage

    one_by_one(run, "measure", jobs, functools.partial(run_stage, run), resume)


@click.command()
@of_jobs
@click.option("--snr", type=Finite(0), help="Minimum S/N in a resolution element or a line [default: 5].")
@click.option("--ids", help="Extract only these ids of the truth table, separated by commas.")
@click.option("--all", "everything", is_flag=True, help="Extract every object with flux on the chip, at any S/N.")
@click.option(
    "--contamination",
    type=click.Choice(["truth", "catalogue", "kept"]),
    help="Flux of neighbours, from true spectra or from catalogue magnitudes; kept: computed, but not subtracted "
    "[default: the campaign's].",
)
@click.option("--image", is_flag=True, help="Also write an image of the modelled flux of all objects.")
def extract(
    run: OpenCampaign,
    jobs: list[Job],
    resume: bool,
    snr: float | None,
    ids: str | None,
    everything: bool,
    contamination: str | None,
    image: bool,
) -> None:
    """Extract the spectra of slitless Level-0 files.

    An object is extracted if its continuum or one of its emission lines has the minimum S/N. The numbers of objects
    left out are printed with the reasons. With --snr, --ids, --all or --contamination, the spectra are written to a
    separate file in chosen/.

    \b
    For example:
      csstsim extract campaign.yaml --obsid 10100000015 --chip 29
      csstsim extract campaign.yaml --obsid 10100000015 --chip 29 --ids 1,2 --snr 0
    Neighbours modelled from their magnitudes, as in a real survey, and an image of the model:
      csstsim extract campaign.yaml --obsid 10100000015 --chip 29 --contamination catalogue --image
    """
    from csstsim.campaign.running.one_by_one import one_by_one
    from csstsim.stages.extract import SNR_MIN
    from csstsim.stages.extract import extract as run_stage

    if everything and (snr is not None or ids):
        raise click.UsageError("--all excludes --snr and --ids")
    try:
        wanted = None if ids is None else [int(word) for word in ids.split(",")]
    except ValueError:
        raise click.BadParameter("numbers, separated by commas", param_hint="--ids") from None
    if not (everything or image) and snr is None and wanted is None and contamination is None:
        one_by_one(run, "extract", jobs, functools.partial(run_stage, run), resume)
        return
    neighbours = None
    if contamination is not None:
        changed: dict[str, Any] = (
            {"subtract": False} if contamination == "kept" else {"known_from": contamination, "subtract": True}
        )
        if contamination == "truth":
            changed["table"] = None
        neighbours = run.config.measurement.contamination.model_copy(update=changed)
    for job in jobs:
        with job.named():
            snr_min = 0.0 if everything else SNR_MIN if snr is None else snr
            run_stage(run, job, snr_min, wanted, neighbours, image)


@click.command()
@of_bricks
def merge(run: OpenCampaign, pix: int) -> None:
    """Merge the detections in a brick to one row per source.

    \b
    For example:
      csstsim merge campaign.yaml --brick 550613
    """
    from csstsim.stages.merge import merge as run_stage

    run_stage(run, pix)


@click.command()
@of_bricks
def validate(run: OpenCampaign, pix: int) -> None:
    """Compare a merged brick with the truth.

    \b
    For example:
      csstsim validate campaign.yaml --brick 550613
    """
    from csstsim.stages.validate import validate as run_stage

    run_stage(run, pix)


@click.command()
@stage
@click.option("--strict", is_flag=True, help="End with exit code 1 if a gate fails.")
def report(run: OpenCampaign, strict: bool) -> None:
    """Write the report of a campaign: one web page.

    The page shows the validation of all bricks. verdict.json in the same folder has the result of each gate.

    \b
    For example:
      csstsim report campaign.yaml --strict
    """
    from csstsim.stages.report import report as run_stage

    if run_stage(run)["passed"] is False and strict:
        sys.exit(1)


@click.command()
@stage
def variants(run: OpenCampaign) -> None:
    """Compare the variants of a finished campaign: one web page.

    The page shows the gates of all variants side by side. For each variant it shows the differences from the base, for
    the same objects: counts, magnitudes, positions, shapes and spectra.

    \b
    For example:
      csstsim variants campaign.yaml
    """
    from csstsim.stages.variants import variants as run_stage

    run_stage(run)


RULES = (
    truth, psf, select, render, readout, level0, masters, calibrate, measure, extract, merge, validate, report, variants
)  # fmt: skip
