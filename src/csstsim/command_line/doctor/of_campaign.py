"""Checks of a campaign: it opens without errors, and fits the disk and memory of this machine."""

from __future__ import annotations

from typing import TYPE_CHECKING

from csstsim.base.files.output_folder import nearest_existing_parent
from csstsim.base.plural import number_of
from csstsim.command_line.doctor.finding import OK, PROBLEM, WARNING, Finding
from csstsim.command_line.doctor.machine import cores, free_disk, free_memory, gb, write_fault

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from csstsim.base.types import PathLike
    from csstsim.campaign.costs import Costs
    from csstsim.campaign.running.status import Status


def of_campaign(file: PathLike) -> Iterator[Finding]:
    """Yield the Findings of a campaign. Raises InputError if it cannot be opened."""
    from csstsim.campaign.opened import OpenCampaign
    from csstsim.campaign.plan import plan
    from csstsim.campaign.running.status import read_status, wanted

    run = OpenCampaign(file)
    run.open_truth()
    plans = [plan(one) for one in (run, *run.variants)]
    counts = plans[0].counts
    jobs = number_of(int(counts["Level-0 files"]), "Level-0 file"), number_of(int(counts["jobs"]), "job")
    yield Finding(OK, "campaign", f"{file}: {', '.join(jobs)}")
    size = sum(size for one in plans for size in one.disk.values())
    yield from output(run.paths.output, size, read_status(run, wanted(run)))
    yield from memory(*(one.costs for one in plans))


def output(folder: Path, size: float, status: Status) -> Iterator[Finding]:
    """Check that the output folder can be written and has enough space. size: bytes of all products."""
    if fault := write_fault(folder):
        existing = nearest_existing_parent(folder)
        message = f"{existing}: {fault}; give the campaign another `output`, or repair that folder"
        yield Finding(PROBLEM, "output", message)
        return
    free = free_disk(folder)
    missing = 0 if status.done else max(size - status.disk, 0)
    text = f"{gb(missing)} to be written to {folder}, {gb(free)} free"
    if missing > free:
        message = f"{text}: free disk space, give the campaign another `output`, or select fewer exposures"
        yield Finding(PROBLEM, "disk", message)
    else:
        yield Finding(WARNING if missing > 0.9 * free else OK, "disk", text)


def memory(*costs: Costs) -> Iterator[Finding]:
    """Check that memory is enough for the largest job, and for one job on each core.

    costs: as of campaign.costs, of a campaign and of each of its variants.
    """
    from csstsim.campaign.costs import default_workflow

    largest, rule = max(
        (max(cost.memory_mb for cost in jobs.values()) * 1e6, rule)
        for one in costs
        for rule, jobs in default_workflow(one).items()
    )
    free = free_memory()
    available = cores()
    text = f"a job of `{rule}` takes up to {gb(largest)}, {gb(free)} are free"
    if largest > free:
        yield Finding(PROBLEM, "memory", f"{text}: end other programs, or give the campaign a window")
    elif largest * available > free:
        yield Finding(WARNING, "memory", f"{text}: snakemake --cores {int(free // largest)}, not {available}")
    else:
        yield Finding(OK, "memory", f"{text}: enough for {available} at a time")
