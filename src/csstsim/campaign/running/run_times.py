"""Time and memory of a campaign's jobs, measured and expected (csstsim.campaign.costs): a table by rule.

The figures are those of the last lines of the jobs' logs.
"""

from __future__ import annotations

from statistics import fmean
from typing import TYPE_CHECKING

from csstsim.campaign.costs import expected
from csstsim.campaign.running.job_log import read_usage

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Sequence
    from pathlib import Path

    from csstsim.campaign.costs import Cost
    from csstsim.campaign.opened import OpenCampaign
    from csstsim.campaign.running.job_log import JobUsage


def run_times(run: OpenCampaign) -> list[dict[str, str | float | None]]:
    """Return the rows of the table, {heading: value}: a rule each, all of them, and that for each Level-0 file.

    Empty if there are no logs with figures. run: campaign.opened.OpenCampaign.
    """
    found = measured(run.paths.output)
    costs = expected(run) if found else {}
    rows: list[dict[str, str | float | None]] = []
    sums = [0.0, 0.0, 0.0]
    for rule, jobs in found.items():
        known = costs.get(rule, {}).values()
        rows.append(_row(rule, jobs, known))
        wall, cpu = (sum(getattr(job, name) for job in jobs) for name in ("wall_s", "cpu_s"))
        should = len(jobs) * fmean(cost.cpu_s for cost in known) if known else 0.0
        sums = [total + part for total, part in zip(sums, (wall, cpu, should), strict=True)]
    return rows and [*rows, _total("all", 1, sums), _total("all, for a Level-0 file", len(run.jobs), sums)]


def measured(output: Path) -> dict[str, list[JobUsage]]:
    """Return {rule: [JobUsage of each job]} from the logs of an output folder that have a last line."""
    found: dict[str, list[JobUsage]] = {}
    for path in sorted((output / "logs").glob("*/*.log")):
        if said := read_usage(path.read_text(errors="replace")):
            found.setdefault(path.parent.name, []).append(said)
    return found


def _row(rule: str, jobs: Sequence[JobUsage], costs: Collection[Cost]) -> dict[str, str | float | None]:
    """Return a rule's row: sums, then CPU time and memory of a job, measured and expected."""
    wall, cpu, memory = ([getattr(job, name) for job in jobs] for name in ("wall_s", "cpu_s", "memory_mb"))
    cpu_mean = fmean(cpu)
    should = fmean(cost.cpu_s for cost in costs) if costs else None
    room = max((cost.memory_mb for cost in costs), default=None)
    return {
        "step": rule,
        "jobs": len(jobs),
        "wall [s]": _shown(sum(wall), 1),
        "CPU [s]": _shown(sum(cpu), 1),
        "CPU of a job: mean": _shown(cpu_mean, 1),
        "most": _shown(max(cpu), 1),
        "expected [s]": _shown(should, 1),
        "mean / expected": _ratio(cpu_mean, should),
        "memory of a job: mean": _shown(fmean(memory)),
        "largest": _shown(max(memory)),
        "expected [MB]": _shown(room),
        "largest / expected": _ratio(max(memory), room),
    }


def _total(name: str, count: int, sums: Iterable[float]) -> dict[str, str | float | None]:
    """Return a row of sums over all rules, divided by `count`."""
    wall, cpu, should = (total / count for total in sums)
    return {
        "step": name,
        "wall [s]": _shown(wall, 1),
        "CPU [s]": _shown(cpu, 1),
        "expected [s]": _shown(should, 1),
        "mean / expected": _ratio(cpu, should),
    }


def _shown(value: float | None, digits: int | None = None) -> float | None:
    return None if value is None else round(value, digits)


def _ratio(value: float, should: float | None) -> float | None:
    return round(value / should, 2) if should else None
