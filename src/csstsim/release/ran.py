"""What the logs of a campaign's jobs say of its run: when it began and ended, its jobs and their time."""

import re
from collections import Counter
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta

from csstsim.campaign.running.job_log import took

_FIRST = re.compile(r"csstsim (\S+) \w+: .* pid \d{1,9}, (\d{4}-\d\d-\d\dT\d\d:\d\d:\d\dZ)")


@dataclass(frozen=True)
class Ran:
    """A run of the workflow: first start and last end (UTC), jobs by rule, CPU s of all, versions of csstsim."""

    start: datetime
    end: datetime
    jobs: dict
    cpu_s: float
    versions: tuple


def ran(output):
    """Return the Ran of an output folder's logs; None without logs of finished jobs."""
    times, jobs, cpu, versions = [], Counter(), 0.0, set()
    for path in sorted((output / "logs").glob("*/*.log")):
        text = path.read_text(errors="replace")
        first, last = _FIRST.match(text), took(text)
        if first and last:
            start = datetime.strptime(first[2], "%Y-%m-%dT%H:%M:%SZ").replace(tzinfo=UTC)
            times.append((start, start + timedelta(seconds=round(last.wall_s))))
            jobs[path.parent.name] += 1
            cpu += last.cpu_s
            versions.add(first[1])
    if not times:
        return None
    starts, ends = zip(*times, strict=True)
    return Ran(min(starts), max(ends), dict(jobs), round(cpu, 1), tuple(sorted(versions)))
