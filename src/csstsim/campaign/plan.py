"""Products and cost of a campaign before it runs (`csstsim plan`). The costs come from campaign.costs."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from csstsim.base.healpix import NSIDE, pixel_centre
from csstsim.base.plural import number_of
from csstsim.base.stages import flatten, levels
from csstsim.campaign.costs import ALTERNATIVES, MACHINE, default_workflow, expected, expected_objects, megapixels
from csstsim.campaign.notes import selection_notes
from csstsim.campaign.products import kinds
from csstsim.catalog.astrometry.reduction import apparent

if TYPE_CHECKING:
    from collections.abc import Collection

    from rich.table import Table

    from csstsim.base.types import PathLike
    from csstsim.campaign.costs import Costs
    from csstsim.campaign.opened import OpenCampaign

SNAKEMAKE_START = 3.0  # s, until the first job starts
KEPT_BYTES = {"imaging": 5, "slitless": 8}  # maximum per pixel: expected and sampled electrons, fraction of objects
BYTES_PER_NODE = 4 * (256 * 256 + 256 * 256 + 64 * 64) * 4  # images, and the tables for sampling photons


class CampaignPlan(NamedTuple):
    """counts {name: number or text}; disk {name: bytes}; costs of all jobs (campaign.costs)."""

    counts: dict[str, float | str]
    disk: dict[str, float]
    costs: Costs


def plan(run: OpenCampaign) -> CampaignPlan:
    """Return the CampaignPlan of an OpenCampaign."""
    jobs = run.jobs
    config = run.config
    costs = expected(run)
    science = run.imaging_jobs + run.slitless_jobs
    nodes = len(costs.get("psf", ())) * config.psf.grid**2
    detector = run.camera.detector
    frame = 2 * detector.channels * (detector.channel_nx + detector.prescan + detector.overscan)
    frame *= detector.channel_ny + detector.parallel_overscan
    objects = sum(expected_objects(run, science).values())
    counts: dict[str, float | str] = {
        "exposures": len({job.obsid for job in jobs}),
        "chips": len({job.chip.id for job in jobs}),
        "Level-0 files": len(jobs),
        "megapixels": round(sum(map(megapixels, jobs)), 1),
        "objects rendered, estimated": int(float(f"{objects:.2g}")) if run.embedded else "all in the catalogue",
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
    if rendered_chips := kinds(run)["render"].made_for:
        disk["light kept"] = sum(KEPT_BYTES[job.chip.kind] * 1e6 * megapixels(job) for job in rendered_chips)
    return CampaignPlan(counts, disk, costs)


def _shared(run: OpenCampaign) -> dict[str, int]:
    """Return {name: number of truth bricks and PSF sets in the shared folder}; {} without one."""
    if run.config.share is None:
        return {}
    files = [*map(run.paths.truth, run.sky_bricks), *map(run.paths.psf, run.sky_chips)]
    shared = [path for path in map(run.in_share, files) if path is not None and path.exists()]
    return {"truth bricks, PSF sets shared": len(shared)}


def _listed(bricks: Collection[int]) -> str | int:
    """Return the number of bricks; up to 8 bricks are listed, too."""
    return f"{len(bricks)}: {', '.join(map(str, sorted(bricks)))}" if 0 < len(bricks) <= 8 else len(bricks)


def _covered(run: OpenCampaign) -> list[int]:
    """Return the bricks that measured windows cover at every sampled point."""
    covered = []
    for pix, jobs in run.merge_bricks.items():
        ra, dec = pixel_centre(NSIDE * 32, np.arange(pix * 1024, (pix + 1) * 1024))
        observed = np.zeros(len(ra), bool)
        for job in jobs:
            x, y = job.wcs.world_to_pixel(*apparent(ra, dec, job.observer))
            observed |= job.window.contains(x, y)
        if observed.all():
            covered.append(pix)
    return covered


def print_plan(run: OpenCampaign, sky: PathLike | None = None) -> None:
    """Print the plan of an OpenCampaign: counts and disk, the costs by rule, notes, the variants, and the sky.

    sky: a new CSV file for the sky of each exposure (campaign.sky_ranges), or None. Raises InputError if the file
    exists, or if no exposure uses the stray-light model.
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
    walls = ", ".join(f"{duration(wall_time(costs, cores))} on {cores}" for cores in sorted({os.cpu_count() or 1, 64}))
    for line in (
        "(in brackets: alternatives to the rows above, with --config chips=whole or exposure)",
        f"CPU time, estimated for {MACHINE}: {duration(_cpu_time(costs))}",
        f"wall time, without other programs: {walls} cores (longest chain of jobs: {duration(_chain(costs))})",
    ):
        Console().print(line, soft_wrap=True, highlight=False)
    for line in selection_notes(run):
        Console().print(f"note: {line}", soft_wrap=True, highlight=False)
    if run.variants:
        Console().print(_variants_table(run))
        if count := _rendered_again(run):
            Console().print(
                f"{number_of(count, 'finished chip')} must be rendered again for the variants, because the rendered "
                "electrons were not kept. Their Level-0 files stay the same. `keep: light` from the start avoids this.",
                soft_wrap=True,
                highlight=False,
            )
    _print_sky(run, sky)


def print_exposures(run: OpenCampaign) -> None:
    """Print the exposures of an OpenCampaign in the order of its survey table: obsid, type, time, chips by filter."""
    from rich.console import Console
    from rich.table import Table

    chips: dict[str, dict[str, list[int]]] = {}
    for job in run.jobs:
        chips.setdefault(job.obsid, {}).setdefault(job.chip.filter, []).append(job.chip.id)
    table = Table(title="Exposures", box=None, pad_edge=False)
    for column in ("obsid", "type", "start, UTC", "s", "filter: chips"):
        table.add_column(column, overflow="fold")
    for obsid, by_filter in chips.items():
        pointing = run.exposures[obsid]
        names = "; ".join(f"{name}: {' '.join(map(str, sorted(numbers)))}" for name, numbers in by_filter.items())
        table.add_row(obsid, pointing.type, f"{pointing.start:%Y-%m-%d %H:%M:%S}", f"{pointing.exptime:g}", names)
    Console().print(table, highlight=False)


def _print_sky(run: OpenCampaign, file: PathLike | None) -> None:
    """Print the range of the sky by band, if layers use the stray-light model; write it by exposure as CSV."""
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


def _cpu_time(costs: Costs) -> float:
    """Return the CPU time [s] of all jobs of the default workflow."""
    return sum(cost.cpu_s for jobs in default_workflow(costs).values() for cost in jobs.values())


def wall_time(costs: Costs, cores: int) -> float:
    """Return the wall time [s] of a campaign on `cores`: the longest chain, and the other jobs in parallel.

    This is an upper limit for any order of jobs that leaves no core idle (Graham 1969, SIAM J. Appl. Math. 17, 416).
    """
    chain = _chain(costs)
    return SNAKEMAKE_START + chain + (_cpu_time(costs) - chain) / cores


def _chain(costs: Costs) -> float:
    """Return the CPU time [s] of the longest chain of jobs that wait for each other."""
    largest = {rule: max(cost.cpu_s for cost in jobs.values()) for rule, jobs in costs.items()}
    # rules of one level run in parallel
    return sum(max(largest.get(rule, 0.0) for rule in rules) for rules in levels())


def _cost_table(costs: Costs) -> Table:
    """Return the table of the rules: number of jobs, CPU time per job (mean) and in total, memory (maximum)."""
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
    """Return the table of the variants of a base: keys that differ, and the cost of products that are not shared."""
    from rich.table import Table

    table = Table(title="Variants, without the products shared with the campaign")
    for column in ("variant", "keys that differ", "jobs", "CPU h", "Level-0 GB"):
        table.add_column(column, justify="left" if column.startswith(("variant", "keys")) else "right")
    for one in run.variants:
        assert one.variant is not None
        counts, disk, costs = plan(one)
        keys = ", ".join(f"{key}: {value}" for key, value in flatten(run.config.variants[one.variant]).items())
        cpu_h = f"{_cpu_time(costs) / 3600:,.2f}"
        table.add_row(one.variant, keys, f"{counts['jobs']:,}", cpu_h, f"{disk['Level-0'] / 1e9:,.2f}")
    return table


def _rendered_again(run: OpenCampaign) -> int:
    """Return the number of chips of a base with a Level-0 file, but without the rendered electrons a variant needs."""
    needed = {
        job.key
        for one in run.variants
        for job in one.jobs
        if one.in_base(*job.key, "render") and not one.in_base(*job.key, "level0")
    }
    missing = (job for job in run.jobs if job.key in needed and not run.paths.stage(*job.key, "render.fits").exists())
    return sum(run.paths.level0(job).exists() for job in missing)


def duration(seconds: float) -> str:
    """Return a duration as text."""
    if seconds < 60:
        return f"{seconds:.0f} s"
    hours = seconds / 3600
    return f"{seconds / 60:.1f} min" if hours < 1 else f"{hours:.1f} h" if hours < 100 else f"{hours:,.0f} h"
