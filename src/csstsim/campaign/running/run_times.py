"""Time and memory of a campaign's jobs, measured and expected (csstsim.campaign.costs): a table by rule.

The measured values come from the last lines of the jobs' logs.
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
    """Return the rows of the table, {heading: value}: one per rule, the total, and the total per Level-0 file.

    Empty if no log has a last line. run: campaign.opened.OpenCampaign.
    """
    usage = measured(run.paths.output)
    costs = expected(run) if usage else {}
    rows: list[dict[str, str | float | None]] = []
    sums = [0.0, 0.0, 0.0]
    for rule, jobs in usage.items():
        rule_costs = costs.get(rule, {}).values()
        rows.append(_row(rule, jobs, rule_costs))
        wall, cpu = (sum(getattr(job, name) for job in jobs) for name in ("wall_s", "cpu_s"))
        expected_cpu = len(jobs) * fmean(cost.cpu_s for cost in rule_costs) if rule_costs else 0.0
        sums = [total + part for total, part in zip(sums, (wall, cpu, expected_cpu), strict=True)]
    return rows and [*rows, _total("all", 1, sums), _total("all, for a Level-0 file", len(run.jobs), sums)]


def measured(output: Path) -> dict[str, list[JobUsage]]:
    """Return {rule: [JobUsage of each job]} from the logs of an output folder that have a last line."""
    usage: dict[str, list[JobUsage]] = {}
    for path in sorted((output / "logs").glob("*/*.log")):
        if job := read_usage(path.read_text(errors="replace")):
            usage.setdefault(path.parent.name, []).append(job)
    return usage


def _row(rule: str, jobs: Sequence[JobUsage], costs: Collection[Cost]) -> dict[str, str | float | None]:
    """Return a rule's row: totals, then CPU time and memory per job, measured and expected."""
    wall, cpu, memory = ([getattr(job, name) for job in jobs] for name in ("wall_s", "cpu_s", "memory_mb"))
    cpu_mean = fmean(cpu)
    expected_cpu = fmean(cost.cpu_s for cost in costs) if costs else None
    expected_memory = max((cost.memory_mb for cost in costs), default=None)
    return {
        "step": rule,
        "jobs": len(jobs),
        "wall [s]": _rounded(sum(wall), 1),
        "CPU [s]": _rounded(sum(cpu), 1),
        "CPU of a job: mean": _rounded(cpu_mean, 1),
        "maximum": _rounded(max(cpu), 1),
        "expected [s]": _rounded(expected_cpu, 1),
        "mean / expected": _ratio(cpu_mean, expected_cpu),
        "memory of a job: mean": _rounded(fmean(memory)),
        "largest": _rounded(max(memory)),
        "expected [MB]": _rounded(expected_memory),
        "largest / expected": _ratio(max(memory), expected_memory),
    }


def _total(name: str, count: int, sums: Iterable[float]) -> dict[str, str | float | None]:
    """Return a row of sums over all rules, divided by `count`."""
    wall, cpu, expected_cpu = (total / count for total in sums)
    return {
        "step": name,
        "wall [s]": _rounded(wall, 1),
        "CPU [s]": _rounded(cpu, 1),
        "expected [s]": _rounded(expected_cpu, 1),
        "mean / expected": _ratio(cpu, expected_cpu),
    }


def _rounded(value: float | None, digits: int | None = None) -> float | None:
    return None if value is None else round(value, digits)


def _ratio(value: float, expected_value: float | None) -> float | None:
    return round(value / expected_value, 2) if expected_value else None
