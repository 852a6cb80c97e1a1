"""Checks of a campaign: it opens, and this machine has room for it."""

from __future__ import annotations

from typing import TYPE_CHECKING

from csstsim.base.plural import number_of
from csstsim.command_line.doctor import OK, PROBLEM, WARNING, Finding
from csstsim.command_line.doctor.machine import cores, free_disk, free_memory, gb, nearest_existing_parent, write_fault

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
    from csstsim.campaign.running.status import look, wanted

    run = OpenCampaign(file)
    run.open_truth()
    counts, _, costs = plan(run)
    need = sum(size for one in (run, *run.variants) for size in plan(one)[1].values())
    made = number_of(int(counts["Level-0 files"]), "Level-0 file"), number_of(int(counts["jobs"]), "job")
    yield Finding(OK, "campaign", f"{file}: {', '.join(made)}")
    yield from output(run.paths.output, need, look(run, wanted(run)))
    yield from memory(costs)


def output(folder: Path, need: float, status: Status) -> Iterator[Finding]:
    """The output folder can be written, and has room. need: bytes of all products; status: a status.Status."""
    if fault := write_fault(folder):
        place = nearest_existing_parent(folder)
        yield Finding(PROBLEM, "output", f"{place}: {fault}; give the campaign another `output`, or mend that folder")
        return
    free = free_disk(folder)
    left = 0 if status.done else max(need - status.disk, 0)
    text = f"{gb(left)} to be written to {folder}, {gb(free)} free"
    if left > free:
        yield Finding(PROBLEM, "disk", f"{text}: free some, give the campaign another `output`, or select less")
    else:
        yield Finding(WARNING if left > 0.9 * free else OK, "disk", text)


def memory(costs: Costs) -> Iterator[Finding]:
    """Free memory is enough for the largest job, and for one on each core. costs: {rule: {key: costs.Cost}}."""
    from csstsim.campaign.costs import each_once

    most, rule = max((max(c.memory_mb for c in jobs.values()) * 1e6, rule) for rule, jobs in each_once(costs).items())
    free = free_memory()
    have = cores()
    text = f"a job of `{rule}` takes up to {gb(most)}, {gb(free)} are free"
    if most > free:
        yield Finding(PROBLEM, "memory", f"{text}: end other programs, or give the campaign a window")
    elif most * have > free:
        together = int(free // most)
        yield Finding(WARNING, "memory", f"{text}: snakemake --cores {together}, not {have}")
    else:
        yield Finding(OK, "memory", f"{text}: enough for {have} at a time")
