"""Chip: the four stages of a job in memory, without the workflow and without files between them."""

from __future__ import annotations

from typing import TYPE_CHECKING

from csstsim.base.process.one_thread import one_thread
from csstsim.io.output_owner import claim_output
from csstsim.stages.level0 import digitised, write_products
from csstsim.stages.parts.shared import copied
from csstsim.stages.parts.stage_frames import Timer
from csstsim.stages.psf import missing_psf
from csstsim.stages.readout import read_out, save_cosmic_rays
from csstsim.stages.render import rendered
from csstsim.stages.select import log_selected, selected
from csstsim.stages.truth import missing_bricks

if TYPE_CHECKING:
    from collections.abc import Callable
    from typing import Any

    from csstsim.campaign.job import Job
    from csstsim.campaign.opened import OpenCampaign
    from csstsim.simulation.state import State


@one_thread
def chip(run: OpenCampaign, job: Job, log: Callable[[str], object] = print) -> State | None:
    """Run one job in memory and write its Level-0 file and truth; return the State at the end.

    Returns None for a job of a variant whose Level-0 file is that of the base.

    Missing truth bricks and a missing PSF set are made first. The output folder is claimed for the campaign
    (io.output_owner). Raises InputError if it belongs to another campaign.
    """
    if copied(run.base_files(job, "level0"), log):
        claim_output(run)
        return None
    state, provenance = simulate(run, job, log)
    claim_output(run)
    timer = Timer("writing")
    save_cosmic_rays(run.paths.level0_cosmic(job), state, run.recipe(job, "readout"))
    write_products(run, job, state, provenance)
    state.header["timing"] = provenance["timing"]
    for name, wall, cpu in [*provenance["stages"], timer.entry()]:
        log(f"{name}: {wall:.1f} s, {cpu:.1f} CPU-s")
    log(f"{run.paths.level0(job)} and its truth table")
    return state


@one_thread
def simulate(run: OpenCampaign, job: Job, log: Callable[[str], object] = print) -> tuple[State, dict[str, Any]]:
    """Run one job in memory. Missing truth bricks and a missing PSF set are made first.

    Returns its State at the end (image: DN, uint16, the window's readout frame) and its provenance, from which
    io.level0_writing makes the header.
    """
    state = light(run, job, log)
    timer = Timer("readout")
    state = read_out(run, state, run.streams(job))
    state.header["stages"].append(timer.entry())
    return digitised(run, job, state, Timer("level0"))


@one_thread
def light(run: OpenCampaign, job: Job, log: Callable[[str], object] = print) -> State:
    """Return the State of a job after the render stage: expected and counted electrons of objects and sky, and truth.

    Missing truth bricks and a missing PSF set are made first.
    """
    from csstsim.catalog.table import ObjectTable

    header: dict[str, Any] = {"stages": []}
    objects = None
    if job.pointing.type == "SCIE":
        missing_bricks(run, run.truth_bricks(job), log)
        timer = Timer("select")
        objects = selected(run, job.exposure)
        header["stages"].append(timer.entry())
        log_selected(objects, log)
        missing_psf(run, job.chip, log)  # after opening the user's catalogue, which may fail
    timer = Timer("render")
    state = rendered(run, job.exposure, objects, run.streams(job))
    state.header |= header
    if run.has_stage(job.pointing, "render"):
        header["stages"].append(timer.entry())
    if state.truth is None:
        state.truth = ObjectTable.complete({}, run.camera.bands)
    return state


def missing(run: OpenCampaign, job: Job, log: Callable[[str], object]) -> None:
    """Make the missing inputs of a science job: bricks of the embedded universe, the chip's PSF set."""
    if job.pointing.type == "SCIE":
        missing_bricks(run, run.truth_bricks(job), log)
        missing_psf(run, job.chip, log)
