"""What a campaign would make, and its cost, before anything runs (`csstsim plan`; costs: campaign.costs)."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING

import numpy as np

from csstsim.base.healpix import NSIDE, pixel_centre
from csstsim.base.plural import number_of
from csstsim.base.stages import flat, levels
from csstsim.campaign.costs import ALTERNATIVES, default_workflow, expected, expected_objects, megapixels
from csstsim.campaign.products import kinds
from csstsim.catalog.astrometry.reduction import apparent

if TYPE_CHECKING:
    from collections.abc import Collection

    from rich.table import Table

    from csstsim.base.types import PathLike
    from csstsim.campaign.costs import Costs
    from csstsim.campaign.opened import OpenCampaign

SNAKEMAKE = 3.0  # s, until the first job starts
KEPT_BYTES = {"imaging": 5, "slitless": 8}  # of a pixel: expected electrons, those counted, the objects' share; at most
BYTES_PER_NODE = 4 * (256 * 256 + 256 * 256 + 64 * 64) * 4  # images, and the tables photons are drawn from


def plan(run: OpenCampaign) -> tuple[dict[str, float | str], dict[str, float], Costs]:
    """Return the plan as (counts, disk, costs). run: campaign.opened.OpenCampaign.

    counts: {name: number or string}; disk: {name: bytes}; costs: those of csstsim.campaign.costs.
    """
    jobs = run.jobs
    config = run.config
    costs = expected(run)
    science = run.imaging_jobs + run.slitless_jobs
    nodes = len(costs.get("psf", ())) * config.psf.grid**2
    detector = run.camera.detector
    frame = 2 * detector.channels * (detector.channel_nx + detector.prescan + detector.overscan)
    frame *= detector.channel_ny + detector.parallel_overscan
    drawn = sum(expected_objects(run, science).values())
    counts: dict[str, float | str] = {
        "exposures": len({job.obsid for job in jobs}),
        "chips": len({job.chip.id for job in jobs}),
        "Level-0 files": len(jobs),
        "megapixels": round(sum(map(megapixels, jobs)), 1),
        "objects drawn": int(float(f"{drawn:.2g}")) if run.embedded else "as many as the catalogue has",
        "truth bricks": _listed(costs.get("truth", ())),
        **_shared(run),
        "bricks touched": len(run.merge_bricks),
        "bricks fully covered": len(_covered(run)),
        "jobs": sum(map(len, default_workflow(costs).values())),
    }
    disk: dict[str, float] = {
        "Level-0": len(jobs) * frame,
        "PSF tables": nodes * BYTES_PER_NODE,
        "largest intermediates (a job)": 8 * max(job.window.nx * job.window.ny for job in jobs),
    }
    if kept := kinds(run)["render"].made_for:
        disk["light kept"] = sum(KEPT_BYTES[job.chip.kind] * 1e6 * megapixels(job) for job in kept)
    return counts, disk, costs


def _shared(run: OpenCampaign) -> dict[str, int]:
    """Return {name: how many truth bricks and PSF sets lie in the shared folder}; {} without one."""
    if run.config.share is None:
        return {}
    files = [*map(run.paths.truth, run.sky_bricks), *map(run.paths.psf, run.sky_chips)]
    return {
        "truth bricks, PSF sets shared": sum(
            (there := run.in_share(path)) is not None and there.exists() for path in files
        )
    }


def _listed(bricks: Collection[int]) -> str | int:
    """Return the number of bricks as text, and which they are if they are few."""
    return f"{len(bricks)}: {', '.join(map(str, sorted(bricks)))}" if 0 < len(bricks) <= 8 else len(bricks)


def _covered(run: OpenCampaign) -> list[int]:
    """Return the bricks that measured windows cover at every sampled point."""
    covered = []
    for pix, jobs in run.merge_bricks.items():
        ra, dec = pixel_centre(NSIDE * 32, np.arange(pix * 1024, (pix + 1) * 1024))
        seen = np.zeros(len(ra), bool)
        for job in jobs:
            x, y = job.wcs.world_to_pixel(*apparent(ra, dec, job.observer))
            seen |= job.window.contains(x, y)
        if seen.all():
            covered.append(pix)
    return covered


def print_plan(run: OpenCampaign, sky: PathLike | None = None) -> None:
    """Print the plan of an open campaign: what it would do, what the jobs of each rule would take, and the sky.

    sky: the new CSV file for the sky by exposure (campaign.sky_ranges), or None. Raises InputError if it cannot be.
    """
    from rich.console import Console
    from rich.table import Table

    from csstsim.campaign.sky_ranges import check_file

    if sky is not None:
        check_file(run, sky)
    counts, disk, costs = plan(run)
    table = Table(title=f"{run.title} ({run.file})", show_header=False)
    for name, value in counts.items():
        table.add_row(name, value if isinstance(value, str) else f"{value:,}")
    for name, value in disk.items():
        table.add_row(f"disk: {name}", f"{value / 1e9:,.2f} GB")
    Console().print(table)
    Console().print(_cost_table(costs))
    cpu = sum(cost.cpu_s for jobs in default_workflow(costs).values() for cost in jobs.values())
    walls = ", ".join(f"{duration(wall_time(costs, cores))} on {cores}" for cores in sorted({os.cpu_count() or 1, 64}))
    for line in (
        "(in brackets: what makes the same with --config chips=whole or exposure)",
        f"CPU, an estimate (config/costs.yaml says of which machine): {duration(cpu)}",
        f"wall time, nothing else running: {walls} cores (jobs that await each other take {duration(_chain(costs))})",
    ):
        Console().print(line, soft_wrap=True, highlight=False)
    if run.variants:
        Console().print(_variants_table(run))
        if again := _drawn_again(run):
            Console().print(
                f"The light of {number_of(again, 'finished chip')} of the campaign was not kept: variants need it, and "
                "it is made again, with Level-0 files of the same bits. With `keep: light` from the start it is there.",
                soft_wrap=True,
                highlight=False,
            )
    _print_sky(run, sky)


def _print_sky(run: OpenCampaign, file: PathLike | None) -> None:
    """Print the sky's range by band, if the layers use the stray-light model; write it by exposure to a CSV file."""
    from rich.console import Console

    from csstsim.campaign.sky_ranges import skies, sky_lines, sky_table, write_skies

    levels, angles = skies(run)
    if not levels:
        return
    Console().print(sky_table(levels))
    for line in sky_lines(levels, angles):
        Console().print(line, highlight=False)
    if file is not None:
        write_skies(file, levels, angles)
        Console().print(f"{file}: the sky of each exposure and band", soft_wrap=True, highlight=False)


def wall_time(costs: Costs, cores: int) -> float:
    """Return the wall time [s] of a campaign on `cores`: the longest chain, and the other jobs beside it.

    Jobs never take longer than this in any order that leaves no core idle (Graham 1969, SIAM J. Appl. Math. 17, 416).
    """
    cpu = sum(cost.cpu_s for jobs in default_workflow(costs).values() for cost in jobs.values())
    chain = _chain(costs)
    return SNAKEMAKE + chain + (cpu - chain) / cores


def _chain(costs: Costs) -> float:
    """Return the CPU time [s] of the largest job of each rule that one product waits for, one after the other."""
    largest = {rule: max(cost.cpu_s for cost in jobs.values()) for rule, jobs in costs.items()}
    # of rules that run side by side, the longest counts
    return sum(max(largest.get(rule, 0.0) for rule in rules) for rules in levels())


def _cost_table(costs: Costs) -> Table:
    """Return the table of the rules: how many jobs, CPU of one (mean) and of all, memory of the largest."""
    from rich.table import Table

    table = Table(title="CPU and memory, estimated")
    for column in ("rule", "jobs", "CPU s a job", "CPU h", "memory MB a job"):
        table.add_column(column, justify="left" if column == "rule" else "right")
    for rule, jobs in costs.items():
        cpu = sum(cost.cpu_s for cost in jobs.values())
        memory = max(cost.memory_mb for cost in jobs.values())
        row = rule, f"{len(jobs):,}", f"{cpu / len(jobs):,.1f}", f"{cpu / 3600:,.2f}", f"{memory:,.0f}"
        if rule in ALTERNATIVES:
            row = f"({rule})", *row[1:]
        table.add_row(*row, style="dim" if rule in ALTERNATIVES else None)
    return table


def _variants_table(run: OpenCampaign) -> Table:
    """Return the table of the variants of a base: what each changes, and what it makes that the base does not."""
    from rich.table import Table

    table = Table(title="Variants, beside what they share with the campaign")
    for column in ("variant", "keys that differ", "jobs", "CPU h", "Level-0 GB"):
        table.add_column(column, justify="left" if column.startswith(("variant", "keys")) else "right")
    for one in run.variants:
        assert one.variant is not None
        counts, disk, costs = plan(one)
        cpu = sum(cost.cpu_s for jobs in default_workflow(costs).values() for cost in jobs.values()) / 3600
        keys = ", ".join(f"{key}: {value}" for key, value in flat(run.config.variants[one.variant]).items())
        table.add_row(one.variant, keys, f"{counts['jobs']:,}", f"{cpu:,.2f}", f"{disk['Level-0'] / 1e9:,.2f}")
    return table


def _drawn_again(run: OpenCampaign) -> int:
    """Return how many chips of a base have Level-0 files, but no more the light that a variant reads out."""
    wanted = {
        job.key
        for one in run.variants
        for job in one.jobs
        if one.in_base(*job.key, "render") and not one.in_base(*job.key, "level0")
    }
    gone = (job for job in run.jobs if job.key in wanted and not run.paths.stage(*job.key, "render.fits").exists())
    return sum(run.paths.level0(job).exists() for job in gone)


def duration(seconds: float) -> str:
    """Return a span of time as text."""
    if seconds < 60:
        return f"{seconds:.0f} s"
    hours = seconds / 3600
    return f"{seconds / 60:.1f} min" if hours < 1 else f"{hours:.1f} h" if hours < 100 else f"{hours:,.0f} h"
