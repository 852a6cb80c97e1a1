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
    """Make one brick of the embedded True Universe.

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
    """Make the PSF set of one chip.

    \b
    For example:
      csstsim psf campaign.yaml --chip 9
    """
    from csstsim.campaign.running.one_by_one import without_psf
    from csstsim.stages.psf import psf as run_stage

    try:
        run_stage(run, chip_id)
    except Exception as exc:
        without_psf(run, chip_id, exc)
        raise


@click.command()
@of_job
@scratch_opt
def select(run: OpenCampaign, job: Job) -> None:
    """Find the objects that reach a chip, and their electrons/s.

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
    """Draw the objects and the sky: expected electrons.

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
    """Turn electrons into DN: noise, overscan, bias, gain.

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
    """Make a chip's master frames from bias, dark and lamp exposures.

    \b
    For example:
      csstsim masters calibration.yaml --chip 9
    """
    from csstsim.stages.masters import masters as run_stage

    run_stage(run, chip_id)


@click.command()
@of_job
def calibrate(run: OpenCampaign, job: Job) -> None:
    """Write the calibrated image of a Level-0 file, in e-/s.

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
@click.option("--snr", type=Finite(0), help="Least S/N, in a resolution element or a line [default: 5].")
@click.option("--ids", help="Only these objects: numbers of the truth table, separated by commas.")
@click.option("--all", "everything", is_flag=True, help="Every object with light on the chip, however faint.")
@click.option(
    "--contamination",
    type=click.Choice(["truth", "catalogue", "kept"]),
    help="Neighbours' light by their true spectra or by a catalogue's magnitudes; kept: stated, not subtracted "
    "[default: the campaign's].",
)
@click.option("--image", is_flag=True, help="Write that light, of all objects, as an image, too.")
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
    """Extract the spectra of spectroscopic chips' Level-0 files.

    An emission line counts by itself: its object may have no other light. What is left out is counted, with the reason.
    A choice of yours goes to a file of its own, in chosen/.

    \b
    For example:
      csstsim extract campaign.yaml --obsid 10100000015 --chip 29
      csstsim extract campaign.yaml --obsid 10100000015 --chip 29 --ids 1,2 --snr 0
    Neighbours known by their magnitudes only, as a survey knows them; their light as an image:
      csstsim extract campaign.yaml --obsid 10100000015 --chip 29 --contamination catalogue --image
    """
    from csstsim.campaign.running.one_by_one import one_by_one
    from csstsim.stages.extract import SNR_MIN
    from csstsim.stages.extract import extract as run_stage

    if everything and (snr is not None or ids):
        raise click.UsageError("--all goes without --snr and --ids")
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
            least = 0.0 if everything else SNR_MIN if snr is None else snr
            run_stage(run, job, least, wanted, neighbours, image)


@click.command()
@of_bricks
def merge(run: OpenCampaign, pix: int) -> None:
    """Merge the measurements of a brick: one row for each source.

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

    The page shows the validation of every brick. A JSON file beside it has the verdict on the gates.

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

    The page has the gates side by side. For each variant it shows counts, magnitudes, places, shapes and spectra less
    those of the base, of the same objects.

    \b
    For example:
      csstsim variants campaign.yaml
    """
    from csstsim.stages.variants import variants as run_stage

    run_stage(run)


RULES = (
    truth, psf, select, render, readout, level0, masters, calibrate, measure, extract, merge, validate, report, variants
)  # fmt: skip
