"""The record of a campaign's run, from the logs of its jobs: first start, last end, jobs and CPU time."""

from __future__ import annotations

import re
from collections import Counter
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from typing import TYPE_CHECKING

from csstsim.campaign.running.job_log import read_usage

if TYPE_CHECKING:
    from pathlib import Path

_FIRST = re.compile(r"csstsim (?P<version>\S+) \w+: .* pid \d{1,9}, (?P<start>\d{4}-\d\d-\d\dT\d\d:\d\d:\d\dZ)")


@dataclass(frozen=True)
class RunRecord:
    """A run of the workflow: first start and last end (UTC), jobs by rule, total CPU s, versions of csstsim."""

    start: datetime
    end: datetime
    jobs: dict[str, int]
    cpu_s: float
    versions: tuple[str, ...]


def run_record(output: Path) -> RunRecord | None:
    """Return the RunRecord of an output folder's logs; None without logs of finished jobs."""
    times: list[tuple[datetime, datetime]] = []
    jobs: Counter[str] = Counter()
    versions: set[str] = set()
    cpu = 0.0
    for path in sorted((output / "logs").glob("*/*.log")):
        text = path.read_text(errors="replace")
        first = _FIRST.match(text)
        last = read_usage(text)
        if first and last:
            start = datetime.strptime(first["start"], "%Y-%m-%dT%H:%M:%SZ").replace(tzinfo=UTC)
            times.append((start, start + timedelta(seconds=round(last.wall_s))))
            jobs[path.parent.name] += 1
            cpu += last.cpu_s
            versions.add(first["version"])
    if not times:
        return None
    starts, ends = zip(*times, strict=True)
    return RunRecord(min(starts), max(ends), dict(jobs), round(cpu, 1), tuple(sorted(versions)))
